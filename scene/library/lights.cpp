// Scenes whose difficulty is their light.

#include <array>
#include <cmath>
#include <vector>

#include "scene/library/recipes.h"

namespace gleaner::scene {
namespace {

constexpr Rgb plaster{0.72, 0.7, 0.66}, stone{0.55, 0.52, 0.47};

// The hall of many_lights(), m, and the power of all its lamps, W.
constexpr double kHalfX = 10, kHeight = 6, kHalfZ = 6, kWatts = 800;
// One material a level of radiance, so that a million lamps do not need a million of them.
constexpr std::uint32_t kLevels = 16;

struct Lamp {
  Vec centre, tangent, bitangent;  // half axes; tangent x bitangent is where it shines
  bool triangle;
};

// Of level 0: 1.
double relative_radiance(std::uint32_t level) { return std::exp2(5.0 * level / (kLevels - 1)); }

void add_hall(SceneBuilder& b) {
  const std::uint32_t wall = b.material("plaster", lambert(plaster));
  const std::uint32_t column = b.material("stone", lambert(stone));
  const std::uint32_t floor = b.material("floor", dielectric({0.35, 0.3, 0.26}, 0.35));
  b.mesh("floor");
  b.quad({-kHalfX, 0, kHalfZ}, {kHalfX, 0, kHalfZ}, {kHalfX, 0, -kHalfZ}, {-kHalfX, 0, -kHalfZ}, floor);
  b.mesh("walls");
  b.quad({-kHalfX, kHeight, -kHalfZ}, {kHalfX, kHeight, -kHalfZ}, {kHalfX, kHeight, kHalfZ}, {-kHalfX, kHeight, kHalfZ},
         wall);
  b.quad({-kHalfX, 0, -kHalfZ}, {kHalfX, 0, -kHalfZ}, {kHalfX, kHeight, -kHalfZ}, {-kHalfX, kHeight, -kHalfZ}, wall);
  b.quad({kHalfX, 0, kHalfZ}, {-kHalfX, 0, kHalfZ}, {-kHalfX, kHeight, kHalfZ}, {kHalfX, kHeight, kHalfZ}, wall);
  b.quad({-kHalfX, 0, kHalfZ}, {-kHalfX, 0, -kHalfZ}, {-kHalfX, kHeight, -kHalfZ}, {-kHalfX, kHeight, kHalfZ}, wall);
  b.quad({kHalfX, 0, -kHalfZ}, {kHalfX, 0, kHalfZ}, {kHalfX, kHeight, kHalfZ}, {kHalfX, kHeight, -kHalfZ}, wall);
  for (int row = 0; row < 2; ++row)
    for (int i = 0; i < 5; ++i) {
      b.mesh("column " + std::to_string(5 * row + i + 1));
      const double x = -8 + 4 * i, z = row == 0 ? -3 : 3;
      b.grid(32, 1,
             [&](std::uint32_t k, std::uint32_t j) {
               const double phi = 2 * pi * k / 32;
               return Vec{x + 0.35 * std::sin(phi), kHeight * j, z + 0.35 * std::cos(phi)};
             },
             column, {.closed_u = true});
    }
}

// Lamp number i of this half width, on the ceiling or a wall.
Lamp lamp_of(std::uint32_t i, double half) {
  const double u = hash_unit(i, 1), v = hash_unit(i, 2), turn = 2 * pi * hash_unit(i, 3);
  constexpr double margin = 0.2, away = 0.02;
  const auto across = [&](double extent, double t) { return (extent - margin) * (2 * t - 1); };
  const double up = 2.5 + (kHeight - margin - 2.5) * v;  // lamps hang above the heads
  Vec centre, normal, tangent;
  const double place = hash_unit(i, 5);
  if (place < 0.6) {
    centre = {across(kHalfX, u), kHeight - away, across(kHalfZ, v)};
    normal = {0, -1, 0};
    tangent = {1, 0, 0};
  } else if (place < 0.8) {
    const double side = place < 0.7 ? -1 : 1;
    centre = {across(kHalfX, u), up, side * (kHalfZ - away)};
    normal = {0, 0, -side};
    tangent = {1, 0, 0};
  } else {
    const double side = place < 0.9 ? -1 : 1;
    centre = {side * (kHalfX - away), up, across(kHalfZ, u)};
    normal = {-side, 0, 0};
    tangent = {0, 0, 1};
  }
  const Vec bitangent = cross(normal, tangent);
  return {centre, half * std::cos(turn) * tangent + half * std::sin(turn) * bitangent,
          half * std::cos(turn) * bitangent - half * std::sin(turn) * tangent, hash_unit(i, 6) < 0.5};
}

void add_lamp(SceneBuilder& b, const Lamp& lamp, std::uint32_t material) {
  const Vec t = lamp.tangent, s = lamp.bitangent;
  const std::uint32_t first = b.vertex(lamp.centre - t - s);
  b.vertex(lamp.centre + t - s);
  b.vertex(lamp.centre + t + s);
  b.triangle(first, first + 1, first + 2, material);
  if (lamp.triangle) return;
  b.vertex(lamp.centre - t + s);
  b.triangle(first, first + 2, first + 3, material);
}

// A hall of 20 x 6 x 12 m with columns, lit by lamps of 1 to 10 cm on ceiling and walls. Their radiances differ by a
// factor of 32, their areas by 100; together they emit 800 W whatever their number.
Scene many_lights(const std::string& name, const Values& values) {
  SceneBuilder b(name);
  add_hall(b);
  std::array<std::vector<Lamp>, kLevels> lamps;
  double power = 0;  // with the radiance of level 0 at 1
  const std::uint32_t count = values.count("lights");
  for (std::uint32_t i = 0; i < count; ++i) {
    const double half = 0.005 * std::pow(10, hash_unit(i, 0));
    const auto level = static_cast<std::uint32_t>(kLevels * hash_unit(i, 4));
    lamps[level].push_back(lamp_of(i, half));
    power += pi * relative_radiance(level) * 4 * half * half * (lamps[level].back().triangle ? 0.5 : 1);
  }
  b.mesh("lamps");
  for (std::uint32_t level = 0; level < kLevels; ++level) {
    // The brighter, the bluer.
    const double blue = static_cast<double>(level) / (kLevels - 1);
    const double radiance = kWatts / power * relative_radiance(level);
    if (lamps[level].empty()) continue;
    const std::uint32_t material = b.material("lamps of level " + std::to_string(level + 1),
                                              emitter(radiance * Rgb{1.25 - 0.4 * blue, 1, 0.75 + 0.4 * blue}));
    for (const Lamp& lamp : lamps[level]) add_lamp(b, lamp, material);
  }
  b.camera("camera", {-9.4, 2.2, 1.2}, {4, 2.4, -1.6}, 55, 960, 540);
  b.camera("aisle", {-9.5, 1.7, 0}, {10, 2.6, 0}, 60, 960, 540);
  return b.finish();
}

Scene punctual_lights(const std::string& name, const Values&) {
  SceneBuilder b(name);
  const std::uint32_t ground = b.material("ground", lambert(grey(0.6)));
  const std::uint32_t wall = b.material("wall", lambert({0.7, 0.65, 0.55}));
  b.mesh("ground");
  b.quad({-4, 0, 3}, {4, 0, 3}, {4, 0, -2}, {-4, 0, -2}, ground);
  b.mesh("wall");
  b.quad({-4, 0, -2}, {4, 0, -2}, {4, 3, -2}, {-4, 3, -2}, wall);
  b.mesh("red sphere");
  b.sphere({-1.6, 0.5, 0}, 0.5, 64, b.material("red", lambert({0.7, 0.15, 0.1})));
  b.mesh("glossy sphere");
  b.sphere({0, 0.5, 0.4}, 0.5, 64, b.material("glossy", dielectric({0.1, 0.25, 0.5}, 0.25)));
  b.mesh("metal box");
  b.box({1.6, 0.45, -0.2}, {0.45, 0.45, 0.45}, radians(30), b.material("rough metal", metal({0.9, 0.85, 0.8}, 0.35)));
  b.point_light({-2.4, 1.9, 0.9}, {9, 6, 3});
  b.spot_light({1.2, 2.8, 2}, {0.25, -2.6, -2.3}, {20, 24, 30}, radians(12), radians(22));
  b.directional_light({-0.5, -1, -0.35}, {0.9, 0.9, 1});
  b.camera("camera", {0.3, 1.7, 5.6}, {0, 0.8, 0}, 42, 960, 540);
  return b.finish();
}

Scene glass_caustic(const std::string& name, const Values&) {
  SceneBuilder b(name);
  const std::uint32_t floor = b.material("floor", lambert(grey(0.7)));
  const std::uint32_t wall = b.material("wall", lambert({0.5, 0.55, 0.6}));
  const std::uint32_t glass = b.material("glass", solid_glass(1.5));
  const std::uint32_t light = b.material("light", emitter({3000, 2850, 2500}));
  b.mesh("floor");
  b.quad({-3, 0, 2.5}, {3, 0, 2.5}, {3, 0, -2}, {-3, 0, -2}, floor);
  b.mesh("wall");
  b.quad({-3, 0, -2}, {3, 0, -2}, {3, 3, -2}, {-3, 3, -2}, wall);
  b.mesh("glass sphere");
  b.sphere({-1.05, 0.42, 0.1}, 0.4, 128, glass);
  b.mesh("glass ring");
  b.torus({0.25, 0.13, 0.55}, 0.42, 0.12, 128, glass);
  // A lying prism: an equilateral triangle along the z axis. It floats, so that no glass shares a plane with the floor.
  b.mesh("glass prism");
  const double side = 0.6, lift = 0.02, half_length = 0.5;
  const auto corner = [&](double x, double y, double z) {
    return b.vertex(Vec{1.35, lift, -0.1} + rotate_y({x, y, z}, radians(25)));
  };
  const std::uint32_t first = corner(-side / 2, 0, half_length);
  corner(side / 2, 0, half_length);
  corner(0, side * std::sqrt(0.75), half_length);
  corner(-side / 2, 0, -half_length);
  corner(side / 2, 0, -half_length);
  corner(0, side * std::sqrt(0.75), -half_length);
  b.triangle(first, first + 1, first + 2, glass);
  b.triangle(first + 3, first + 5, first + 4, glass);
  for (std::uint32_t i = 0; i < 3; ++i) {
    const std::uint32_t j = (i + 1) % 3;
    b.triangle(first + i, first + 3 + i, first + 3 + j, glass);
    b.triangle(first + i, first + 3 + j, first + j, glass);
  }
  b.mesh("light");
  const Vec centre{-1.6, 2.9, -1}, forward = normalize(Vec{0.3, 0, 0.3} - centre);
  const Vec across = 0.05 * normalize(cross(forward, {0, 1, 0})), up = cross(across, forward);
  b.quad(centre - across + up, centre + across + up, centre + across - up, centre - across - up, light);
  b.camera("camera", {0.2, 2.1, 4.4}, {0.1, 0.35, 0}, 38, 960, 540);
  return b.finish();
}

// A bright room between two dark ones. No light path leads into the dark rooms: whatever is seen there has leaked.
Scene thin_walls(const std::string& name, const Values&) {
  SceneBuilder b(name);
  const std::uint32_t wall = b.material("wall", lambert(grey(0.75)));
  const std::uint32_t light = b.material("light", emitter(grey(10)));
  constexpr double height = 2.5, half_z = 1.5, half_x = 1.5, thickness = 0.01;
  // The shell of one room, without its side walls.
  const auto shell = [&](const char* room, double left, double right) {
    b.mesh(room);
    b.quad({left, 0, half_z}, {right, 0, half_z}, {right, 0, -half_z}, {left, 0, -half_z}, wall);
    b.quad({left, height, -half_z}, {right, height, -half_z}, {right, height, half_z}, {left, height, half_z}, wall);
    b.quad({left, 0, -half_z}, {right, 0, -half_z}, {right, height, -half_z}, {left, height, -half_z}, wall);
    b.quad({right, 0, half_z}, {left, 0, half_z}, {left, height, half_z}, {right, height, half_z}, wall);
  };
  // A sheet that faces +x.
  const auto sheet = [&](double x) {
    b.quad({x, 0, half_z}, {x, 0, -half_z}, {x, height, -half_z}, {x, height, half_z}, wall);
  };
  const double box_room = half_x + thickness;  // where the right room begins
  shell("bright room", -half_x, half_x);
  shell("room behind a sheet", -half_x - 3, -half_x);
  shell("room behind a box", box_room, box_room + 3);
  b.mesh("outer walls");
  sheet(-half_x - 3);
  b.quad({box_room + 3, 0, -half_z}, {box_room + 3, 0, half_z}, {box_room + 3, height, half_z},
         {box_room + 3, height, -half_z}, wall);
  b.mesh("sheet wall");
  sheet(-half_x);
  b.mesh("box wall");
  b.box({half_x + thickness / 2, height / 2, 0}, {thickness / 2, height / 2, half_z}, 0, wall);
  // In both dark rooms thin screens stand before the wall: more edges for light to slip around.
  b.mesh("screens");
  b.box({-half_x - 0.3, 0.8, 0}, {thickness / 2, 0.8, 0.8}, 0, wall);
  b.box({box_room + 0.3, 0.8, 0}, {thickness / 2, 0.8, 0.8}, 0, wall);
  b.mesh("light");
  b.quad({-0.5, height - 0.02, -0.5}, {0.5, height - 0.02, -0.5}, {0.5, height - 0.02, 0.5}, {-0.5, height - 0.02, 0.5},
         light);
  b.camera("behind the sheet", {-half_x - 2.8, 1.5, 1.2}, {-half_x, 0.9, -0.4}, 65, 480, 360);
  b.camera("behind the box", {box_room + 2.8, 1.5, 1.2}, {box_room, 0.9, -0.4}, 65, 480, 360);
  b.camera("bright room", {0.9, 1.5, 1.4}, {-0.5, 1.1, -1.5}, 65, 480, 360);
  return b.finish();
}

Scene emissive_textured(const std::string& name, const Values&) {
  SceneBuilder b(name);
  constexpr std::uint32_t width = 256, height = 144;
  Material screen = emitter(grey(8));
  // Colour bars over a ramp of greys over black.
  screen.emission_texture = b.texture(width, height, true, [](std::uint32_t x, std::uint32_t y) {
    if (y < 96) {
      const std::uint32_t bar = 7 - x / 32;  // white, yellow, cyan, green, magenta, red, blue, black
      const auto level = [](bool on) { return on ? std::uint8_t{235} : std::uint8_t{0}; };
      return Texel{level(bar & 2), level(bar & 4), level(bar & 1), 255};
    }
    if (y < 128)
      return Texel{static_cast<std::uint8_t>(x), static_cast<std::uint8_t>(x), static_cast<std::uint8_t>(x), 255};
    return Texel{0, 0, 0, 255};
  });
  const std::uint32_t screen_material = b.material("screen", screen);
  const std::uint32_t wall = b.material("wall", lambert(grey(0.6)));
  const std::uint32_t floor = b.material("floor", dielectric({0.3, 0.25, 0.2}, 0.25));
  b.mesh("room");
  b.quad({-2, 2.4, -2}, {2, 2.4, -2}, {2, 2.4, 2}, {-2, 2.4, 2}, wall);
  b.quad({-2, 0, -2}, {2, 0, -2}, {2, 2.4, -2}, {-2, 2.4, -2}, wall);
  b.quad({-2, 0, 2}, {-2, 0, -2}, {-2, 2.4, -2}, {-2, 2.4, 2}, wall);
  b.quad({2, 0, -2}, {2, 0, 2}, {2, 2.4, 2}, {2, 2.4, -2}, wall);
  b.quad({2, 0, 2}, {-2, 0, 2}, {-2, 2.4, 2}, {2, 2.4, 2}, wall);
  b.mesh("floor");
  b.quad({-2, 0, 2}, {2, 0, 2}, {2, 0, -2}, {-2, 0, -2}, floor);
  b.mesh("screen");
  b.quad({-0.96, 0.7, -1.95}, {0.96, 0.7, -1.95}, {0.96, 1.78, -1.95}, {-0.96, 1.78, -1.95}, screen_material);
  b.mesh("sphere");
  b.sphere({-0.9, 0.35, -0.6}, 0.35, 64, b.material("white", lambert(grey(0.8))));
  b.mesh("box");
  b.box({0.9, 0.3, -0.7}, {0.3, 0.3, 0.3}, radians(25), b.material("rough metal", metal(grey(0.9), 0.3)));
  b.camera("camera", {0, 1.3, 1.9}, {0, 0.95, -2}, 55, 960, 540);
  return b.finish();
}

}  // namespace

std::vector<Recipe> light_recipes() {
  return {
      {"many-lights",
       "a hall with columns and many small lamps, triangles and quads of unlike power",
       {{"lights", 1000, 1, 1000000, true}},
       many_lights},
      {"punctual-lights", "a point, a spot and a directional light over simple objects", {}, punctual_lights},
      {"glass-caustic", "a glass sphere, ring and prism over a floor under a small area light", {}, glass_caustic},
      {"thin-walls",
       "a bright room between two dark ones, behind a sheet and behind a box of 1 cm: the dark ones are black",
       {},
       thin_walls},
      {"emissive-textured", "a room lit by a screen with an emission texture", {}, emissive_textured},
  };
}

}  // namespace gleaner::scene

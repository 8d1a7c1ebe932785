// The Cornell box: a room of 2 m with a red and a green wall, open towards the camera. The proportions are the classic
// ones, the measures are our own.

#include <cmath>

#include "scene/library/recipes.h"

namespace gleaner::scene {
namespace {

constexpr Rgb white{0.725, 0.71, 0.68}, red{0.63, 0.065, 0.05}, green{0.14, 0.45, 0.091};
constexpr Rgb light_radiance{17, 12, 4};

struct Box {
  Vec centre, half;
  double yaw;
};
const Box short_box{{0.36, 0.3, 0.38}, {0.3, 0.3, 0.3}, radians(-17)};
const Box tall_box{{-0.34, 0.6, -0.3}, {0.3, 0.6, 0.3}, radians(18)};

// x from -1 to 1, y from 0 to 2, z from -1 to 1.
void add_room(SceneBuilder& b, std::uint32_t floor, std::uint32_t back) {
  const std::uint32_t white_wall = b.material("white", lambert(white));
  const std::uint32_t red_wall = b.material("red", lambert(red));
  const std::uint32_t green_wall = b.material("green", lambert(green));
  const std::uint32_t light = b.material("light", emitter(light_radiance));
  const auto or_white = [&](std::uint32_t m) { return m == GLEANER_NONE ? white_wall : m; };
  b.mesh("floor");
  b.quad({-1, 0, 1}, {1, 0, 1}, {1, 0, -1}, {-1, 0, -1}, or_white(floor));
  b.mesh("ceiling");
  b.quad({-1, 2, -1}, {1, 2, -1}, {1, 2, 1}, {-1, 2, 1}, white_wall);
  b.mesh("back wall");
  b.quad({-1, 0, -1}, {1, 0, -1}, {1, 2, -1}, {-1, 2, -1}, or_white(back));
  b.mesh("left wall");
  b.quad({-1, 0, 1}, {-1, 0, -1}, {-1, 2, -1}, {-1, 2, 1}, red_wall);
  b.mesh("right wall");
  b.quad({1, 0, -1}, {1, 0, 1}, {1, 2, 1}, {1, 2, -1}, green_wall);
  b.mesh("light");
  b.quad({-0.24, 1.99, -0.19}, {0.24, 1.99, -0.19}, {0.24, 1.99, 0.19}, {-0.24, 1.99, 0.19}, light);
  // The opening fills the picture.
  b.camera("camera", {0, 1, 3.8}, {0, 1, 0}, 2 * std::atan(1 / 2.8) * 180 / pi, 512, 512);
}

void add_box(SceneBuilder& b, const char* name, const Box& box, std::uint32_t material) {
  b.mesh(name);
  b.box(box.centre, box.half, box.yaw, material);
}

Scene cornell_box(const std::string& name, const Values&) {
  SceneBuilder b(name);
  add_room(b, GLEANER_NONE, GLEANER_NONE);
  const std::uint32_t boxes = b.material("boxes", lambert(white));
  add_box(b, "short box", short_box, boxes);
  add_box(b, "tall box", tall_box, boxes);
  return b.finish();
}

Scene cornell_mirror(const std::string& name, const Values&) {
  SceneBuilder b(name);
  add_room(b, GLEANER_NONE, GLEANER_NONE);
  add_box(b, "short box", short_box, b.material("short box", lambert(white)));
  add_box(b, "tall box", tall_box, b.material("mirror", metal(grey(0.95), 0)));
  return b.finish();
}

Scene cornell_glass(const std::string& name, const Values&) {
  SceneBuilder b(name);
  add_room(b, GLEANER_NONE, GLEANER_NONE);
  add_box(b, "tall box", tall_box, b.material("tall box", lambert(white)));
  b.mesh("glass sphere");
  b.sphere({0.38, 0.42, 0.35}, 0.4, 96, b.material("glass", solid_glass(1.5)));
  return b.finish();
}

Scene cornell_glossy(const std::string& name, const Values& values) {
  SceneBuilder b(name);
  add_room(b, GLEANER_NONE, GLEANER_NONE);
  add_box(b, "short box", short_box,
          b.material("rough dielectric", dielectric({0.1, 0.2, 0.5}, values.number("short"))));
  add_box(b, "tall box", tall_box, b.material("rough metal", metal({0.95, 0.76, 0.45}, values.number("tall"))));
  return b.finish();
}

std::uint8_t byte(double value) { return static_cast<std::uint8_t>(std::lround(255 * value)); }

// A unit vector as a normal map stores it.
Texel encode_normal(Vec n) {
  n = normalize(n);
  return {byte(0.5 + 0.5 * n.x), byte(0.5 + 0.5 * n.y), byte(0.5 + 0.5 * n.z), 255};
}

Scene cornell_textured(const std::string& name, const Values&) {
  SceneBuilder b(name);
  constexpr std::uint32_t size = 256;

  Material floor = lambert(grey(1));
  floor.base_color_texture = b.texture(size, size, true, [](std::uint32_t x, std::uint32_t y) {
    return (x / 32 + y / 32) % 2 == 0 ? Texel{225, 220, 210, 255} : Texel{60, 75, 95, 255};
  });
  Material back = lambert(grey(0.9));
  back.base_color_texture = b.texture(size, size, true, [](std::uint32_t x, std::uint32_t y) {
    const double u = (x + 0.5) / size, v = (y + 0.5) / size;
    return Texel{byte(0.9 - 0.5 * v), byte(0.45 + 0.4 * u), byte(0.4 + 0.5 * v), 255};
  });
  // Half of its squares are metal; the roughness grows towards the bottom.
  Material tiles = dielectric({0.8, 0.6, 0.4}, 1);
  tiles.metallic = 1;
  tiles.metallic_roughness_texture = b.texture(size, size, false, [](std::uint32_t x, std::uint32_t y) {
    return Texel{0, byte(0.15 + 0.6 * (y + 0.5) / size), byte((x / 64 + y / 64) % 2), 255};
  });
  // Round studs, eight to a side.
  Material studs = dielectric({0.25, 0.35, 0.2}, 0.35);
  studs.normal_texture = b.texture(size, size, false, [](std::uint32_t x, std::uint32_t y) {
    const double u = (x % 32 + 0.5) / 16 - 1, v = 1 - (y % 32 + 0.5) / 16, r2 = (u * u + v * v) / 0.64;
    return r2 < 1 ? encode_normal({u, v, 1.2}) : encode_normal({0, 0, 1});
  });
  Material screen = lambert({0.9, 0.8, 0.2});
  screen.flags |= GLEANER_MATERIAL_ALPHA_MASK;
  screen.base_color_texture = b.texture(size, size, true, [](std::uint32_t x, std::uint32_t y) {
    const double u = (x % 64 + 0.5) / 32 - 1, v = (y % 64 + 0.5) / 32 - 1;
    return Texel{255, 255, 255, u * u + v * v < 0.55 ? std::uint8_t{0} : std::uint8_t{255}};
  });

  const std::uint32_t floor_material = b.material("checker floor", floor);
  const std::uint32_t back_material = b.material("gradient wall", back);
  const std::uint32_t tiles_material = b.material("metallic-roughness tiles", tiles);
  const std::uint32_t studs_material = b.material("studs", studs);
  const std::uint32_t screen_material = b.material("cut-out screen", screen);
  add_room(b, floor_material, back_material);
  add_box(b, "short box", short_box, studs_material);
  add_box(b, "tall box", tall_box, tiles_material);
  b.mesh("screen");
  b.quad({0.15, 0.75, -0.6}, {0.85, 0.75, -0.35}, {0.85, 1.45, -0.35}, {0.15, 1.45, -0.6}, screen_material);
  return b.finish();
}

}  // namespace

std::vector<Recipe> cornell_recipes() {
  return {
      {"cornell-box",
       "white, red and green walls, two boxes, a ceiling light of radiance 17 12 4; pure Lambert",
       {},
       cornell_box},
      {"cornell-mirror", "the Cornell box with a perfect mirror for the tall box", {}, cornell_mirror},
      {"cornell-glass",
       "the Cornell box with a solid, smooth glass sphere of ior 1.5 for the short box",
       {},
       cornell_glass},
      {"cornell-glossy",
       "the Cornell box with a rough dielectric short box and a rough metal tall box, of these roughnesses",
       {{"short", 0.3, 0, 1}, {"tall", 0.25, 0, 1}},
       cornell_glossy},
      {"cornell-textured",
       "the Cornell box with base colour, metallic-roughness and normal textures and a cut-out (alpha mask)",
       {},
       cornell_textured},
  };
}

}  // namespace gleaner::scene

// Geometry that is hard on acceleration structures and on floating point.

#include <algorithm>
#include <cmath>
#include <string>

#include "scene/library/recipes.h"

namespace gleaner::scene {
namespace {

void add_stage(SceneBuilder& b, double half, double floor, double height) {
  const std::uint32_t wall = b.material("stage", lambert(grey(0.65)));
  b.mesh("stage");
  b.quad({-half, floor, half}, {half, floor, half}, {half, floor, -half}, {-half, floor, -half}, wall);
  b.quad({-half, floor, -half}, {half, floor, -half}, {half, height, -half}, {-half, height, -half}, wall);
  b.mesh("light");
  const double x = 0.4 * half;
  b.quad({-x, height, -x}, {x, height, -x}, {x, height, x}, {-x, height, x}, b.material("light", emitter(grey(6))));
}

// A row of teeth towards a corner, each so much smaller than the one before that a split by surface area always takes
// one tooth off: cutting one of n costs about (n - 1) r^2, with r the ratio of their sizes, and two together about 1.7,
// so that r = sqrt(1.3 / n) keeps a builder from sparing levels. 35 of them span 18 orders of magnitude; areas of
// smaller ones would leave the range of float.
Scene comb(const std::string& name, const Values& values) {
  SceneBuilder b(name);
  // Well below the teeth, so that a builder parts it from them first.
  add_stage(b, 2, -1, 3);
  const std::uint32_t tooth = b.material("tooth", lambert({0.2, 0.45, 0.65}));
  b.mesh("comb");
  double size = 1;
  for (std::uint32_t left = values.count("depth"); left > 0; --left) {
    const std::uint32_t first = b.vertex({0.9 * size, 0, 0});
    b.vertex({size, 0, 0});
    b.vertex({0.95 * size, 0.8 * size, 0});
    b.triangle(first, first + 1, first + 2, tooth);
    size *= std::min(0.8, std::sqrt(1.3 / left));
  }
  b.camera("camera", {1.2, 1.2, 3.2}, {0.45, 0.4, 0}, 36, 512, 512);
  return b.finish();
}

// Straws of 1 m: one long edge, and an opposite corner `aspect` times closer to it than the edge is long.
Scene needles(const std::string& name, const Values& values) {
  SceneBuilder b(name);
  add_stage(b, 2, 0, 3);
  const std::uint32_t needle = b.material("needle", lambert({0.7, 0.5, 0.2}));
  b.mesh("needles");
  const double width = 1 / values.number("aspect");
  for (std::uint32_t i = 0; i < values.count("count"); ++i) {
    const double z = 2 * hash_unit(i, 0) - 1, phi = 2 * pi * hash_unit(i, 1), r = std::sqrt(1 - z * z);
    const Vec along{r * std::cos(phi), z, r * std::sin(phi)};
    const Vec side = normalize(cross(along, std::fabs(z) < 0.9 ? Vec{0, 1, 0} : Vec{1, 0, 0}));
    const Vec centre{1.2 * (2 * hash_unit(i, 2) - 1), 0.6 + 1.2 * hash_unit(i, 3), 1.2 * (2 * hash_unit(i, 4) - 1)};
    const std::uint32_t first = b.vertex(centre - 0.5 * along);
    b.vertex(centre + 0.5 * along);
    b.vertex(centre + (hash_unit(i, 5) - 0.5) * along + width * side);
    b.triangle(first, first + 1, first + 2, needle);
  }
  b.camera("camera", {0, 1.4, 5.4}, {0, 1.2, 0}, 36, 512, 512);
  return b.finish();
}

// A room of 2 m far from the origin. Everything stands on a grid of 1/64 m, the spacing of floats out there, so that
// the room is the same to the bit wherever it stands.
Scene far(const std::string& name, const Values& values) {
  const Vec centre{values.number("x"), values.number("y"), values.number("z")};
  SceneBuilder b(name);
  const auto at = [&](double x, double y, double z) {
    const auto on_grid = [](double v) { return std::round(64 * v) / 64; };
    return centre + Vec{on_grid(x), on_grid(y), on_grid(z)};
  };
  const std::uint32_t white = b.material("white", lambert({0.725, 0.71, 0.68}));
  const std::uint32_t red = b.material("red", lambert({0.63, 0.065, 0.05}));
  const std::uint32_t green = b.material("green", lambert({0.14, 0.45, 0.091}));
  const std::uint32_t light = b.material("light", emitter({17, 12, 4}));
  b.mesh("white walls");
  b.quad(at(-1, -1, 1), at(1, -1, 1), at(1, -1, -1), at(-1, -1, -1), white);
  b.quad(at(-1, 1, -1), at(1, 1, -1), at(1, 1, 1), at(-1, 1, 1), white);
  b.quad(at(-1, -1, -1), at(1, -1, -1), at(1, 1, -1), at(-1, 1, -1), white);
  b.mesh("left wall");
  b.quad(at(-1, -1, 1), at(-1, -1, -1), at(-1, 1, -1), at(-1, 1, 1), red);
  b.mesh("right wall");
  b.quad(at(1, -1, -1), at(1, -1, 1), at(1, 1, 1), at(1, 1, -1), green);
  b.mesh("light");
  b.quad(at(-0.25, 0.984375, -0.1875), at(0.25, 0.984375, -0.1875), at(0.25, 0.984375, 0.1875),
         at(-0.25, 0.984375, 0.1875), light);
  const auto box = [&](double x, double z, double half, double tall, double yaw) {
    const auto corner = [&](double i, double y, double j) {
      const Vec turned = rotate_y({i * half, 0, j * half}, yaw);
      return at(x + turned.x, y - 1, z + turned.z);
    };
    const double ring[5][2] = {{-1, 1}, {1, 1}, {1, -1}, {-1, -1}, {-1, 1}};
    for (int i = 0; i < 4; ++i)
      b.quad(corner(ring[i][0], 0, ring[i][1]), corner(ring[i + 1][0], 0, ring[i + 1][1]),
             corner(ring[i + 1][0], tall, ring[i + 1][1]), corner(ring[i][0], tall, ring[i][1]), white);
    b.quad(corner(-1, tall, 1), corner(1, tall, 1), corner(1, tall, -1), corner(-1, tall, -1), white);
    b.quad(corner(-1, 0, -1), corner(1, 0, -1), corner(1, 0, 1), corner(-1, 0, 1), white);
  };
  b.mesh("short box");
  box(0.36, 0.38, 0.3, 0.6, radians(-17));
  b.mesh("tall box");
  box(-0.34, -0.3, 0.3, 1.2, radians(18));
  b.camera("camera", at(0, 0, 3.796875), at(0, 0, 0), 2 * std::atan(1 / 2.796875) * 180 / pi, 512, 512);
  return b.finish();
}

// Rings in columns, each turned, tilted and stretched its own way, every fifth mirrored. All are one mesh.
Scene stack(const std::string& name, const Values& values) {
  constexpr std::uint32_t storeys = 20;
  const std::uint32_t count = values.count("count");
  const auto side =
      static_cast<std::uint32_t>(std::ceil(std::sqrt(static_cast<double>((count + storeys - 1) / storeys))));
  SceneBuilder b(name);
  const double half = 0.15 * side + 0.5;
  add_stage(b, half, 0, std::max(2 * half, 2.2));
  const std::uint32_t glaze = b.material("glaze", dielectric({0.2, 0.45, 0.65}, 0.3));
  b.instanced_mesh("ring");
  b.torus({}, 0.1, 0.03, values.count("segments"), glaze);
  for (std::uint32_t i = 0; i < count; ++i) {
    const std::uint32_t column = i / storeys, storey = i % storeys;
    const double turn = 2 * pi * hash_unit(i, 0), tilt = radians(6) * (2 * hash_unit(i, 1) - 1);
    const double width = 0.9 + 0.3 * hash_unit(i, 2), height = 0.8 + 0.2 * hash_unit(i, 3);
    const auto turned = [&](Vec v) {
      return rotate_y({v.x * std::cos(tilt) - v.y * std::sin(tilt), v.x * std::sin(tilt) + v.y * std::cos(tilt), v.z},
                      turn);
    };
    const double x = i % 5 == 4 ? -width : width;
    b.instance(
        x * turned({1, 0, 0}), height * turned({0, 1, 0}), turned({0, 0, 1}),
        {0.3 * (column % side - 0.5 * (side - 1)), 0.06 + 0.07 * storey, 0.3 * (column / side - 0.5 * (side - 1))});
  }
  b.camera("camera", {0.3 * half, 1.1 * half + 0.6, 2.6 * half + 1}, {0, 0.6, 0}, 40, 512, 512);
  return b.finish();
}

}  // namespace

std::vector<Recipe> stress_recipes() {
  return {
      {"comb",
       "nested teeth, each scale half the one before: a very deep hierarchy",
       {{"depth", 60, 1, 60, true}},
       comb},
      {"needles",
       "triangles of 1 m with an aspect of a million",
       {{"count", 2000, 1, 1000000, true}, {"aspect", 1e6, 1, 1e6}},
       needles},
      {"far",
       "a Cornell box of 2 m, hundreds of kilometres from the origin; the same to the bit wherever it stands",
       {{"x", 148376, -250000, 250000, true},
        {"y", 1234, -250000, 250000, true},
        {"z", -223423, -250000, 250000, true}},
       far},
      {"stack",
       "rings in columns, each turned, tilted and stretched its own way: one mesh in many places",
       {{"count", 2000, 1, 1000000, true}, {"segments", 100, 8, 2000, true}},
       stack},
  };
}

}  // namespace gleaner::scene

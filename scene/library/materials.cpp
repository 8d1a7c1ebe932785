// Scenes that show how materials answer light.

#include <cmath>
#include <string>

#include "scene/library/recipes.h"

namespace gleaner::scene {
namespace {

// A clear sky with a sun of 1.5 degrees' radius that lights level ground about as much as the sky does.
Rgb sky(Vec d) {
  static const Vec sun = normalize({0.45, 0.62, 0.64});
  static const double cos_radius = std::cos(radians(1.5));
  if (dot(d, sun) > cos_radius) return {1300, 1180, 980};
  const double glow = std::pow(std::max(dot(d, sun), 0.0), 40);
  if (d.y < 0) return {0.18, 0.17, 0.16};
  const double t = std::sqrt(d.y);  // horizon to zenith
  const Rgb horizon{0.9, 0.95, 1.05}, zenith{0.25, 0.45, 0.95};
  return {horizon.r + t * (zenith.r - horizon.r) + 1.5 * glow, horizon.g + t * (zenith.g - horizon.g) + 1.3 * glow,
          horizon.b + t * (zenith.b - horizon.b) + glow};
}

Scene environment_objects(const std::string& name, const Values& values) {
  SceneBuilder b(name);
  b.mesh("ground");
  b.quad({-8, 0, 6}, {8, 0, 6}, {8, 0, -8}, {-8, 0, -8}, b.material("ground", lambert({0.45, 0.42, 0.38})));
  const struct {
    const char* name;
    Material material;
  } objects[] = {{"diffuse", lambert({0.7, 0.3, 0.2})},
                 {"glossy dielectric", dielectric({0.05, 0.3, 0.15}, 0.2)},
                 {"rough metal", metal({0.95, 0.75, 0.4}, 0.35)},
                 {"mirror", metal(grey(0.95), 0)},
                 {"glass", solid_glass(1.5)}};
  for (int i = 0; i < 5; ++i) {
    b.mesh(objects[i].name);
    b.sphere({1.2 * (i - 2), 0.5, i % 2 == 0 ? 0 : 0.35}, 0.5, 128, b.material(objects[i].name, objects[i].material));
  }
  b.environment(values.count("width"), sky);
  b.camera("camera", {0, 1.5, 6.2}, {0, 0.55, 0}, 38, 960, 540);
  return b.finish();
}

Scene glossy_range(const std::string& name, const Values&) {
  SceneBuilder b(name);
  const std::uint32_t wall = b.material("wall", lambert(grey(0.5)));
  b.mesh("floor");
  b.quad({-5, 0, 4}, {5, 0, 4}, {5, 0, -3}, {-5, 0, -3}, b.material("floor", lambert(grey(0.35))));
  b.mesh("wall");
  b.quad({-5, 0, -3}, {5, 0, -3}, {5, 5, -3}, {-5, 5, -3}, wall);
  constexpr int steps = 9;
  for (int row = 0; row < 2; ++row)
    for (int i = 0; i < steps; ++i) {
      const double roughness = static_cast<double>(i) / (steps - 1);
      const std::string label =
          std::string(row == 0 ? "dielectric" : "metal") + " of roughness " + std::to_string(roughness).substr(0, 5);
      b.mesh(label);
      b.sphere({0.85 * (i - (steps - 1) / 2), row == 0 ? 0.4 : 1.3, row == 0 ? 0.6 : -0.6}, 0.38, 96,
               b.material(label,
                          row == 0 ? dielectric({0.25, 0.04, 0.03}, roughness) : metal({0.95, 0.76, 0.45}, roughness)));
    }
  // One broad light above and, behind the camera, three strips that grow narrow: highlights to blur.
  b.mesh("lights");
  const std::uint32_t broad = b.material("broad light", emitter(grey(4)));
  b.quad({-3, 4.5, -1}, {3, 4.5, -1}, {3, 4.5, 1}, {-3, 4.5, 1}, broad);
  for (int i = 0; i < 3; ++i) {
    const double half = 0.32 / (1 << (2 * i)), x = 4 * (i - 1);
    const std::uint32_t strip = b.material("strip " + std::to_string(i + 1), emitter(grey(10 << (2 * i))));
    b.quad({x + half, 1, 9.5}, {x - half, 1, 9.5}, {x - half, 6, 9.5}, {x + half, 6, 9.5}, strip);
  }
  b.camera("camera", {0, 2, 8.5}, {0, 0.85, 0}, 32, 1280, 480);
  return b.finish();
}

}  // namespace

std::vector<Recipe> material_recipes() {
  return {
      {"environment-objects",
       "spheres of five materials on a plane under a sky with a small bright sun (needs --environment)",
       {{"width", 512, 64, 8192, true}},
       environment_objects},
      {"glossy-range", "dielectric and metal spheres of roughness 0 to 1", {}, glossy_range},
  };
}

}  // namespace gleaner::scene

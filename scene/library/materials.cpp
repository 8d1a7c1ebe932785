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

// Rows of five spheres: coats, sheen, grains, films.
Scene layered_range(const std::string& name, const Values&) {
  SceneBuilder b(name);
  b.mesh("room");
  b.quad({-4, 0, 4}, {4, 0, 4}, {4, 0, -3}, {-4, 0, -3}, b.material("floor", lambert(grey(0.4))));
  b.quad({-4, 0, -3}, {4, 0, -3}, {4, 5, -3}, {-4, 5, -3}, b.material("wall", lambert({0.55, 0.5, 0.45})));
  b.quad({-4, 0, 4}, {-4, 0, -3}, {-4, 5, -3}, {-4, 5, 4}, b.material("left", lambert({0.6, 0.15, 0.1})));
  b.quad({4, 0, -3}, {4, 0, 4}, {4, 5, 4}, {4, 5, -3}, b.material("right", lambert({0.12, 0.3, 0.6})));
  constexpr int kinds = 4, steps = 5;
  constexpr const char* names[kinds] = {"coat", "sheen", "grain", "film"};
  for (int kind = 0; kind < kinds; ++kind)
    for (int i = 0; i < steps; ++i) {
      const float t = static_cast<float>(i) / (steps - 1);
      Material m = kind == 0   ? (i % 2 ? metal({0.7, 0.2, 0.1}, 0.5) : dielectric({0.5, 0.05, 0.04}, 0.6))
                   : kind == 1 ? lambert({0.08, 0.03, 0.15})
                   : kind == 2 ? metal({0.9, 0.8, 0.7}, 0.25)
                               : (i % 2 ? metal(grey(0.6), 0.15) : dielectric(grey(0.03), 0.1));
      if (kind == 0) m.clearcoat = 1, m.clearcoat_roughness = 0.5f * t;
      if (kind == 1) {
        m.sheen_color[0] = 0.8f, m.sheen_color[1] = m.sheen_color[2] = 0.6f;
        m.sheen_roughness = 0.2f + 0.8f * t;
      }
      if (kind == 2) m.anisotropy = 0.8f, m.anisotropy_rotation = 1.5707963f * t;
      if (kind == 3) m.iridescence = 1, m.iridescence_maximum = 200 + 500 * t;
      const std::string label = std::string(names[kind]) + " " + std::to_string(i + 1);
      b.mesh(label);
      b.sphere({1.2 * (i - 2), 0.5 + 0.75 * kind, 1.2 - 0.9 * kind}, 0.45, 96, b.material(label, m));
    }
  b.mesh("lights");
  b.quad({-2, 4.9, -1}, {2, 4.9, -1}, {2, 4.9, 2}, {-2, 4.9, 2}, b.material("ceiling light", emitter(grey(5))));
  b.quad({1.5, 2, 9.5}, {0.5, 2, 9.5}, {0.5, 5, 9.5}, {1.5, 5, 9.5}, b.material("strip", emitter(grey(14))));
  b.camera("camera", {0, 2.4, 8.6}, {0, 1.6, 0}, 34, 800, 640);
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
      {"layered-range", "spheres under coats, sheen and thin films, and of lobes with a grain", {}, layered_range},
  };
}

}  // namespace gleaner::scene

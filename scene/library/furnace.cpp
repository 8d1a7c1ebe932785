// Scenes whose radiance is known in closed form.

#include "scene/library/recipes.h"

namespace gleaner::scene {
namespace {

Material glowing(double albedo, double emission) {
  Material m = lambert(grey(albedo));
  for (float& e : m.emission) e = static_cast<float>(emission);
  return m;
}

void add_inside_cameras(SceneBuilder& b) {
  b.camera("camera", {0.1, 0.05, 0.2}, {0.1, 0.05, -1}, 75, 256, 256);
  b.camera("corner", {0.3, 0.2, 0.1}, {-1, -1, -1}, 90, 256, 256);
}

// Radiance emission / (1 - albedo) everywhere; after n >= 1 bounces emission (1 - albedo^(n + 1)) / (1 - albedo).
Scene furnace(const std::string& name, const Values& values) {
  SceneBuilder b(name);
  const std::uint32_t wall = b.material("wall", glowing(values.number("albedo"), values.number("emission")));
  b.mesh("walls");
  b.box({}, {1, 1, 1}, 0, wall, true);
  add_inside_cameras(b);
  return b.finish();
}

// A closed polyhedron of uniform albedo and emission is as exact a furnace as the sphere it stands for.
Scene furnace_sphere(const std::string& name, const Values& values) {
  SceneBuilder b(name);
  const std::uint32_t wall = b.material("wall", glowing(values.number("albedo"), values.number("emission")));
  b.mesh("sphere");
  b.sphere({}, 1, values.count("segments"), wall, true);
  add_inside_cameras(b);
  return b.finish();
}

// Radiance albedo / (1 - albedo) everywhere on a true sphere: the light brings an irradiance of pi. All of its power is
// absorbed in the end, so that on the polyhedron of area A the mean over the surface is 4 pi / A times that.
Scene furnace_point(const std::string& name, const Values& values) {
  SceneBuilder b(name);
  const std::uint32_t wall = b.material("wall", lambert(grey(values.number("albedo"))));
  b.mesh("sphere");
  b.sphere({}, 1, values.count("segments"), wall, true);
  b.point_light({}, grey(pi));
  add_inside_cameras(b);
  return b.finish();
}

// A white sphere that absorbs nothing vanishes before the environment: every pixel is 1.
Scene white_furnace(const std::string& name, const Values& values) {
  SceneBuilder b(name);
  Material m = dielectric(grey(values.number("albedo")), values.number("roughness"), values.number("ior"));
  m.metallic = static_cast<float>(values.number("metallic"));
  m.specular = static_cast<float>(values.number("specular"));
  m.transmission = static_cast<float>(values.number("transmission"));
  if (m.transmission > 0) m.flags |= GLEANER_MATERIAL_SOLID;
  b.mesh("sphere");
  b.sphere({}, 1, 128, b.material("chosen", m));
  b.environment(16, [](Vec) { return grey(1); });
  b.camera("camera", {0, 0.6, 4}, {}, 36, 256, 256);
  return b.finish();
}

}  // namespace

std::vector<Recipe> furnace_recipes() {
  const Parameter albedo{"albedo", 0.5, 0, 0.99}, emission{"emission", 0.5, 0.001, 1000};
  const Parameter segments{"segments", 128, 8, 4096, true};
  return {
      {"furnace",
       "the inside of a closed box that glows: radiance emission / (1 - albedo) everywhere",
       {albedo, emission},
       furnace},
      {"furnace-sphere",
       "the inside of a unit sphere that glows: radiance emission / (1 - albedo) everywhere",
       {albedo, emission, segments},
       furnace_sphere},
      {"furnace-point",
       "the inside of a unit sphere with a point light of intensity pi at its centre: radiance albedo / (1 - albedo)",
       {albedo, segments},
       furnace_point},
      {"white-furnace",
       "a sphere of a chosen material in an environment of radiance 1",
       {{"roughness", 0.5, 0, 1},
        {"metallic", 0, 0, 1},
        {"specular", 1, 0, 1},
        {"ior", 1.5, 1, 3},
        {"albedo", 1, 0, 1},
        {"transmission", 0, 0, 1}},
       white_furnace},
  };
}

}  // namespace gleaner::scene

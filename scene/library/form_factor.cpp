// Two unit squares, one emitting radiance 1: the picture is exactly the other one, so that the mean pixel is
// albedo * F with the form factor F known in closed form (no light returns: the emitter is black).

#include "scene/library/recipes.h"

namespace gleaner::scene {
namespace {

void add_receiver(SceneBuilder& b, double albedo) {
  b.mesh("receiver");
  b.quad({-0.5, 0, 0.5}, {0.5, 0, 0.5}, {0.5, 0, -0.5}, {-0.5, 0, -0.5}, b.material("receiver", lambert(grey(albedo))));
}

// F = 2 / (pi c^2) * [ln((1 + c^2) / sqrt(1 + 2 c^2)) + 2 c sqrt(1 + c^2) atan(c / sqrt(1 + c^2)) - 2 c atan(c)], c = 1
// / distance: 0.199825 at 1 m.
Scene parallel_squares(const std::string& name, const Values& values) {
  const double y = values.number("distance");
  SceneBuilder b(name);
  add_receiver(b, values.number("albedo"));
  b.mesh("emitter");
  b.quad({-0.5, y, -0.5}, {0.5, y, -0.5}, {0.5, y, 0.5}, {-0.5, y, 0.5}, b.material("emitter", emitter(grey(1))));
  b.orthographic_camera("receiver", {0, y / 2, 0}, {0, -1, 0}, {0, 0, -1}, 0.5, 0.5, 128, 128);
  return b.finish();
}

// The squares share an edge: F = 0.200044.
Scene perpendicular_squares(const std::string& name, const Values& values) {
  SceneBuilder b(name);
  add_receiver(b, values.number("albedo"));
  b.mesh("emitter");
  b.quad({-0.5, 0, 0.5}, {-0.5, 0, -0.5}, {-0.5, 1, -0.5}, {-0.5, 1, 0.5}, b.material("emitter", emitter(grey(1))));
  b.orthographic_camera("receiver", {0, 0.5, 0}, {0, -1, 0}, {0, 0, -1}, 0.5, 0.5, 128, 128);
  return b.finish();
}

}  // namespace

std::vector<Recipe> form_factor_recipes() {
  const Parameter albedo{"albedo", 0.5, 0, 1};
  return {
      {"parallel-squares",
       "a unit square under an emitting one: mean radiance albedo * F (F = 0.199825 at 1 m)",
       {{"distance", 1, 0.01, 100}, albedo},
       parallel_squares},
      {"perpendicular-squares",
       "a unit square with an emitting one on its edge, at a right angle: mean radiance albedo * 0.200044",
       {albedo},
       perpendicular_squares},
  };
}

}  // namespace gleaner::scene

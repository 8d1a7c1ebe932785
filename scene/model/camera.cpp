#include <algorithm>
#include <cmath>
#include <numbers>

#include "scene/model/error.h"
#include "scene/model/instances.h"
#include "scene/model/scene.h"
#include "scene/model/transform.h"

namespace gleaner::scene {
namespace {

double length(const Vector& a) { return std::hypot(a[0], a[1], a[2]); }

Vector scaled(const Vector& a, double s) { return {a[0] * s, a[1] * s, a[2] * s}; }

void store(const Vector& from, gl_float to[3]) {
  for (int c = 0; c < 3; ++c) to[c] = static_cast<gl_float>(from[c]);
}

// Of the boxes about all meshes, in the world.
Bounds bounds_with_instances(const Scene& scene) {
  Bounds bounds;
  bool first = true;
  const auto enclose = [&](int c, float lower, float upper) {
    bounds.lower[c] = first ? lower : std::min(bounds.lower[c], lower);
    bounds.upper[c] = first ? upper : std::max(bounds.upper[c], upper);
  };
  std::vector<Bounds> boxes;
  for (const Mesh& mesh : scene.meshes) {
    boxes.push_back(bounds_of(scene, mesh));
    if (mesh.instanced || mesh.triangle_count == 0) continue;
    for (int c = 0; c < 3; ++c) enclose(c, boxes.back().lower[c], boxes.back().upper[c]);
    first = false;
  }
  for (const Instance& instance : scene.instances) {
    const DerivedInstance d = derived(instance.transform, boxes[instance.mesh]);
    for (int c = 0; c < 3; ++c) enclose(c, static_cast<float>(d.lower[c]), static_cast<float>(d.upper[c]));
    first = false;
  }
  return bounds;
}

}  // namespace

Bounds bounds_of(const Scene& scene) {
  if (!scene.instances.empty()) return bounds_with_instances(scene);
  Bounds bounds;
  if (scene.positions.empty()) return bounds;
  for (int c = 0; c < 3; ++c) bounds.lower[c] = bounds.upper[c] = scene.positions[c];
  for (std::size_t i = 0; i + 2 < scene.positions.size(); i += 3) {
    for (int c = 0; c < 3; ++c) {
      bounds.lower[c] = std::min(bounds.lower[c], scene.positions[i + c]);
      bounds.upper[c] = std::max(bounds.upper[c], scene.positions[i + c]);
    }
  }
  return bounds;
}

NamedCamera look_at(const std::array<float, 3>& eye, const std::array<float, 3>& target, float yfov_radians) {
  const Vector to{double(target[0]) - eye[0], double(target[1]) - eye[1], double(target[2]) - eye[2]};
  const double distance = length(to);
  if (!(distance > 0) || !std::isfinite(distance))
    throw Error::usage("the camera's eye and target must be two finite points that differ");
  if (!(yfov_radians > 0) || !(yfov_radians < std::numbers::pi_v<float>))
    throw Error::usage("the camera's field of view must lie between 0 and 180 degrees");
  const Vector forward = scaled(to, 1 / distance);
  // +y is up, except for a camera that looks straight up or down: there the top of the image points to -z or +z.
  Vector side = cross(forward, {0, 1, 0});
  if (length(side) < 1e-6) side = cross(forward, {0, 0, forward[1] > 0 ? 1.0 : -1.0});
  const Vector right = scaled(side, 1 / length(side));
  NamedCamera named;
  named.name = "look-at";
  for (int c = 0; c < 3; ++c) named.camera.origin[c] = eye[c];
  named.camera.type = GLEANER_CAMERA_PERSPECTIVE;
  store(right, named.camera.right);
  store(cross(right, forward), named.camera.up);
  store(forward, named.camera.forward);
  named.camera.half_height = static_cast<gl_float>(std::tan(yfov_radians / 2.0));
  named.camera.half_width = named.camera.half_height;
  return named;
}

NamedCamera framing_camera(const Scene& scene) {
  constexpr double yfov = 40 * std::numbers::pi / 180;
  const Bounds bounds = bounds_of(scene);
  std::array<float, 3> target{};
  Vector half{};
  for (int c = 0; c < 3; ++c) {
    target[c] = static_cast<float>((double(bounds.lower[c]) + bounds.upper[c]) / 2);
    half[c] = (double(bounds.upper[c]) - bounds.lower[c]) / 2;
  }
  // The face of the bounds that looks to +z fills a square film but for a margin of 2 %.
  double distance = 1.02 * std::max(half[0], half[1]) / std::tan(yfov / 2) + half[2];
  const double magnitude = std::max({std::abs(target[0]), std::abs(target[1]), std::abs(target[2])});
  distance = std::max({distance, 1e-3, 1e-5 * magnitude});
  const std::array<float, 3> eye{target[0], target[1], static_cast<float>(target[2] + distance)};
  NamedCamera named = look_at(eye, target, static_cast<float>(yfov));
  named.name = "framing";
  return named;
}

}  // namespace gleaner::scene

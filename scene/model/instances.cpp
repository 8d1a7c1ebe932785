#include "scene/model/instances.h"

#include <algorithm>
#include <cmath>
#include <cstdio>

#include "scene/model/limits.h"
#include "scene/model/media.h"

namespace gleaner::scene {
namespace {

// The linear part of a transform and its inverse, [row][column].
struct Linear {
  double m[3][3], adjugate[3][3];
  double determinant;

  explicit Linear(const gl_float (&transform)[12]) {
    for (int r = 0; r < 3; ++r)
      for (int c = 0; c < 3; ++c) m[r][c] = double{transform[4 * r + c]};
    for (int r = 0; r < 3; ++r)
      for (int c = 0; c < 3; ++c) {
        const int r1 = (r + 1) % 3, r2 = (r + 2) % 3, c1 = (c + 1) % 3, c2 = (c + 2) % 3;
        adjugate[r][c] = m[c1][r1] * m[c2][r2] - m[c1][r2] * m[c2][r1];
      }
    determinant = m[0][0] * adjugate[0][0] + m[0][1] * adjugate[1][0] + m[0][2] * adjugate[2][0];
  }
  double inverse(int r, int c) const { return adjugate[r][c] / determinant; }
  // Sum of the absolute values of the products that an entry of the adjugate is made of.
  double products(int r, int c) const {
    const int r1 = (r + 1) % 3, r2 = (r + 2) % 3, c1 = (c + 1) % 3, c2 = (c + 2) % 3;
    return std::abs(m[c1][r1] * m[c2][r2]) + std::abs(m[c1][r2] * m[c2][r1]);
  }
};

std::string number(double value) {
  char text[32];
  std::snprintf(text, sizeof text, "%g", value);
  return text;
}

// Bound, an axis of the mesh's own space, of how far the origin that a tracer gives a ray lies off the point of the
// mesh that the ray leaves. Tracers multiply by the inverse. Embree computes that in single precision, as adjugate over
// determinant; entry by entry its error is bounded by the products that were added and by the determinant's own error.
// Let W be the inverse and E its error. Of a point M p + t the tracer makes W (M p + t) - W t, so that p is missed by
// E M p and by the roundings of both products and of the sum.
std::array<double, 3> missed_by(const Linear& linear, const std::array<double, 3>& reach,
                                const std::array<double, 3>& translation) {
  constexpr double unit = 1.0 / (1 << 24);
  double terms = 0;
  for (int k = 0; k < 3; ++k) terms += std::abs(linear.m[0][k]) * linear.products(k, 0);
  std::array<double, 3> missed{};
  for (int r = 0; r < 3; ++r)
    for (int c = 0; c < 3; ++c) {
      const double error =
          unit *
          (4 * linear.products(r, c) + 10 * terms / std::abs(linear.determinant) * std::abs(linear.adjugate[r][c])) /
          std::abs(linear.determinant);
      missed[r] += error * reach[c] + unit * std::abs(linear.inverse(r, c)) * (4 * reach[c] + 12 * translation[c]);
    }
  return missed;
}

}  // namespace

std::uint64_t Scene::effective_triangle_count() const {
  std::uint64_t count = triangle_count();
  for (const Mesh& mesh : meshes)
    if (mesh.instanced) count -= mesh.triangle_count;
  for (const Instance& instance : instances) count += meshes[instance.mesh].triangle_count;
  return count;
}

bool may_be_instanced(const Material& m) {
  return !(m.emission[0] > 0 || m.emission[1] > 0 || m.emission[2] > 0) && !is_solid(m);
}

std::optional<std::string> refused_transform(const gl_float (&transform)[12]) {
  for (int i = 0; i < 12; ++i) {
    const double most = i % 4 == 3 ? double{kMaxCoordinate} : kMaxInstanceScale;
    if (!(std::abs(double{transform[i]}) <= most))
      return number(transform[i]) + " at place " + std::to_string(i) + ", beyond " + number(most);
  }
  const Linear linear(transform);
  double norm = 0, inverse_norm = 0;
  for (int r = 0; r < 3; ++r)
    for (int c = 0; c < 3; ++c) {
      norm += linear.m[r][c] * linear.m[r][c];
      inverse_norm += linear.inverse(r, c) * linear.inverse(r, c);
    }
  norm = std::sqrt(norm / 3), inverse_norm = std::sqrt(inverse_norm / 3);
  if (!(norm * inverse_norm <= kMaxInstanceStretch)) return "one that flattens";
  if (!(inverse_norm <= kMaxInstanceScale)) return "one that shrinks to a scale of " + number(1 / inverse_norm);
  return std::nullopt;
}

void place_instance(const double* rows, gl_float (&transform)[12]) {
  for (int i = 0; i < 12; ++i) transform[i] = static_cast<float>(rows[i]);
}

std::vector<std::uint32_t> meshes_with_own_bvh(const Scene& scene) {
  std::vector<std::uint32_t> meshes;
  for (std::uint32_t m = 0; m < scene.meshes.size(); ++m)
    if ((scene.meshes[m].instanced || scene.meshes[m].deforming) && scene.meshes[m].triangle_count > 0)
      meshes.push_back(m);
  return meshes;
}

std::vector<TriangleRun> still_triangles(const Scene& scene) {
  std::vector<TriangleRun> runs;
  std::uint32_t next = 0;
  const auto add_until = [&](std::uint32_t end) {
    if (end > next) runs.push_back({next, end - next});
  };
  for (const std::uint32_t m : meshes_with_own_bvh(scene)) {
    add_until(scene.meshes[m].first_triangle);
    next = scene.meshes[m].first_triangle + scene.meshes[m].triangle_count;
  }
  add_until(static_cast<std::uint32_t>(scene.triangle_count()));
  return runs;
}

Bounds bounds_of(const Scene& scene, const Mesh& mesh) {
  Bounds bounds;
  const std::size_t end = 3 * (std::size_t{mesh.first_triangle} + mesh.triangle_count);
  for (std::size_t i = 3 * std::size_t{mesh.first_triangle}; i < end; ++i) {
    const float* p = &scene.positions[3 * std::size_t{scene.indices[i]}];
    const bool first = i == 3 * std::size_t{mesh.first_triangle};
    for (int c = 0; c < 3; ++c) {
      bounds.lower[c] = first ? p[c] : std::min(bounds.lower[c], p[c]);
      bounds.upper[c] = first ? p[c] : std::max(bounds.upper[c], p[c]);
    }
  }
  return bounds;
}

std::vector<Bounds> boxes_of_instanced(const Scene& scene) {
  std::vector<Bounds> boxes(scene.meshes.size());
  for (std::size_t m = 0; m < boxes.size(); ++m)
    if (scene.meshes[m].instanced) boxes[m] = bounds_of(scene, scene.meshes[m]);
  return boxes;
}

DerivedInstance derived(const gl_float (&transform)[12], const Bounds& mesh) {
  constexpr double unit = 1.0 / (1 << 24);
  const Linear linear(transform);
  DerivedInstance d;
  d.mirrored = linear.determinant < 0;
  std::array<double, 3> most{}, reach{}, translation{};  // of a point in its own space; of its turned place; of t
  for (int c = 0; c < 3; ++c) most[c] = std::max(std::abs(double{mesh.lower[c]}), std::abs(double{mesh.upper[c]}));
  for (int r = 0; r < 3; ++r) {
    translation[r] = std::abs(double{transform[4 * r + 3]});
    d.lower[r] = d.upper[r] = double{transform[4 * r + 3]};
    for (int c = 0; c < 3; ++c) {
      d.inverse[3 * r + c] = linear.inverse(r, c);
      reach[r] += std::abs(linear.m[r][c]) * most[c];
      const double a = linear.m[r][c] * mesh.lower[c], b = linear.m[r][c] * mesh.upper[c];
      d.lower[r] += std::min(a, b);
      d.upper[r] += std::max(a, b);
    }
  }
  const std::array<double, 3> missed = missed_by(linear, reach, translation);
  for (int r = 0; r < 3; ++r) {
    // The place in the world is rounded, too, and so is the one in the mesh's own space that it is computed from.
    double error = 4 * unit * (reach[r] + translation[r]);
    for (int c = 0; c < 3; ++c) error += std::abs(linear.m[r][c]) * (missed[c] + unit * most[c]);
    d.error[r] = 1.01 * error;
    d.lower[r] -= 2 * d.error[r];
    d.upper[r] += 2 * d.error[r];
  }
  return d;
}

}  // namespace gleaner::scene

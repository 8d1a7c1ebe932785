#include "scene/import/placement.h"

#include <algorithm>
#include <cstdio>

namespace gleaner::scene {

double Box::extent() const {
  return empty() ? 0 : std::max({upper[0] - lower[0], upper[1] - lower[1], upper[2] - lower[2]});
}

double Box::magnitude() const {
  if (empty()) return 0;
  double most = 0;
  for (int c = 0; c < 3; ++c) most = std::max({most, std::abs(lower[c]), std::abs(upper[c])});
  return most;
}

Point3 origin_for(const Box& bounds) {
  Point3 origin{};
  if (bounds.empty()) return origin;
  Point3 centre;
  double distance = 0;
  for (int c = 0; c < 3; ++c) {
    centre[c] = (bounds.lower[c] + bounds.upper[c]) / 2;
    distance = std::max(distance, std::abs(centre[c]));
  }
  if (!(distance > kFarAway * bounds.extent() / 2) || !std::isfinite(distance)) return origin;
  // A multiple of a power of two near the scene's size: coordinates that the file holds exactly stay exact.
  const double size = std::max(bounds.extent(), distance * 1e-9);
  const double step = std::exp2(std::floor(std::log2(size)));
  for (int c = 0; c < 3; ++c) origin[c] = std::round(centre[c] / step) * step;
  return origin;
}

void warn_of_coarse_floats(const Box& box, const std::string& where, const std::string& what, Warnings& warnings) {
  const double extent = box.extent(), most = box.magnitude();
  if (!(extent > 0) || !(most > 0)) return;
  const double spacing = std::exp2(std::floor(std::log2(most)) - 23);
  if (!(spacing * kFewSteps > extent)) return;
  char text[160];
  std::snprintf(text, sizeof text, ": single precision is %.2g m there, %.2g %% of the size: shapes are rounded",
                spacing, 100 * spacing / extent);
  warnings.add(where, what + " lie far from the origin" + text);
}

void warn_of_coarse_meshes(const Scene& scene, Warnings& warnings) {
  for (const Mesh& mesh : scene.meshes) {
    Box box;
    const std::size_t end = 3 * (std::size_t(mesh.first_triangle) + mesh.triangle_count);
    for (std::size_t i = 3 * std::size_t(mesh.first_triangle); i < end; ++i) {
      const float* p = &scene.positions[3 * std::size_t(scene.indices[i])];
      box.add({p[0], p[1], p[2]});
    }
    warn_of_coarse_floats(box, "mesh " + mesh.name, "parts of the scene", warnings);
  }
}

}  // namespace gleaner::scene

#include "scene/model/media.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

namespace gleaner::scene {
namespace {

using Vec = std::array<double, 3>;

struct Box {
  Vec lower, upper;
  Box() {
    lower.fill(std::numeric_limits<double>::infinity());
    upper.fill(-std::numeric_limits<double>::infinity());
  }
  double diagonal() const { return std::hypot(upper[0] - lower[0], upper[1] - lower[1], upper[2] - lower[2]); }
  bool overlaps(const Box& other) const {
    for (int k = 0; k < 3; ++k)
      if (!(lower[k] < other.upper[k] && other.lower[k] < upper[k])) return false;
    return true;
  }
};

Vec corner(const Scene& scene, std::size_t triangle, int k) {
  const float* p = &scene.positions[3 * std::size_t{scene.indices[3 * triangle + k]}];
  return {p[0], p[1], p[2]};
}

// The boxes about the triangles of each solid material; others' stay empty.
std::vector<Box> solid_boxes(const Scene& scene) {
  std::vector<Box> boxes(scene.materials.size());
  for (std::size_t t = 0; t < scene.triangle_count(); ++t) {
    const std::uint32_t m = scene.triangle_material[t];
    if (!is_solid(scene.materials[m])) continue;
    for (int k = 0; k < 3; ++k) {
      const Vec p = corner(scene, t, k);
      for (int c = 0; c < 3; ++c) {
        boxes[m].lower[c] = std::min(boxes[m].lower[c], p[c]);
        boxes[m].upper[c] = std::max(boxes[m].upper[c], p[c]);
      }
    }
  }
  return boxes;
}

// The solid angle of a triangle seen from a point, above 0 where the point sees its back (Van Oosterom & Strackee
// 1983).
double signed_solid_angle(const Vec& p, const Vec& a, const Vec& b, const Vec& c) {
  Vec r[3];
  double length[3];
  for (int k = 0; k < 3; ++k) {
    const Vec& q = k == 0 ? a : k == 1 ? b : c;
    for (int i = 0; i < 3; ++i) r[k][i] = q[i] - p[i];
    length[k] = std::hypot(r[k][0], r[k][1], r[k][2]);
  }
  const auto dot = [](const Vec& x, const Vec& y) { return x[0] * y[0] + x[1] * y[1] + x[2] * y[2]; };
  const double volume = r[0][0] * (r[1][1] * r[2][2] - r[1][2] * r[2][1]) +
                        r[0][1] * (r[1][2] * r[2][0] - r[1][0] * r[2][2]) +
                        r[0][2] * (r[1][0] * r[2][1] - r[1][1] * r[2][0]);
  return 2 * std::atan2(volume, length[0] * length[1] * length[2] + dot(r[0], r[1]) * length[2] +
                                    dot(r[1], r[2]) * length[0] + dot(r[2], r[0]) * length[1]);
}

}  // namespace

bool is_transmissive(const Material& m) {
  return !(m.flags & GLEANER_MATERIAL_UNLIT) && m.transmission > 0 &&
         (m.metallic < 1 || m.metallic_roughness_texture != GLEANER_NONE);
}

bool transmits_diffusely(const Material& m) {
  return !(m.flags & GLEANER_MATERIAL_UNLIT) && m.diffuse_transmission > 0 &&
         (m.transmission < 1 || m.transmission_texture != GLEANER_NONE) &&
         (m.metallic < 1 || m.metallic_roughness_texture != GLEANER_NONE);
}

bool is_solid(const Material& m) { return (m.flags & GLEANER_MATERIAL_SOLID) && is_transmissive(m); }

std::vector<std::uint32_t> media_by_rank(const Scene& scene) {
  const std::vector<Box> boxes = solid_boxes(scene);
  std::vector<std::uint32_t> media;
  for (std::uint32_t m = 0; m < boxes.size(); ++m)
    if (boxes[m].lower[0] <= boxes[m].upper[0]) media.push_back(m);
  std::ranges::stable_sort(media,
                           [&](std::uint32_t a, std::uint32_t b) { return boxes[a].diagonal() > boxes[b].diagonal(); });
  return media;
}

bool media_may_overlap(const Scene& scene, const std::vector<std::uint32_t>& by_rank) {
  const std::vector<Box> boxes = solid_boxes(scene);
  for (std::size_t i = 0; i < by_rank.size(); ++i)
    for (std::size_t j = i + 1; j < by_rank.size(); ++j)
      if (boxes[by_rank[i]].overlaps(boxes[by_rank[j]])) return true;
  return false;
}

MediumFinder::MediumFinder(std::shared_ptr<const Scene> held, std::vector<std::uint32_t> by_rank)
    : scene_(std::move(held)), by_rank_(std::move(by_rank)), triangles_(by_rank_.size()) {
  const Scene& scene = *scene_;
  std::vector<std::uint32_t> rank(scene.materials.size(), GLEANER_NONE);
  for (std::uint32_t r = 0; r < by_rank_.size(); ++r) rank[by_rank_[r]] = r;
  for (std::uint32_t t = 0; t < scene.triangle_count(); ++t)
    if (const std::uint32_t r = rank[scene.triangle_material[t]]; r != GLEANER_NONE) triangles_[r].push_back(t);
  const std::vector<Box> boxes = solid_boxes(scene);
  for (const std::uint32_t material : by_rank_) {
    lower_.push_back(boxes[material].lower);
    upper_.push_back(boxes[material].upper);
  }
}

std::size_t MediumFinder::triangles() const {
  std::size_t sum = 0;
  for (const auto& list : triangles_) sum += list.size();
  return sum;
}

std::vector<std::uint32_t> MediumFinder::at(const std::array<double, 3>& point) const {
  std::vector<std::uint32_t> found;
  for (std::size_t r = triangles_.size(); r-- > 0;) {
    bool within = true;
    for (int k = 0; k < 3; ++k) within = within && point[k] >= lower_[r][k] && point[k] <= upper_[r][k];
    if (!within) continue;
    double angle = 0;
    for (const std::uint32_t t : triangles_[r])
      angle += signed_solid_angle(point, corner(*scene_, t, 0), corner(*scene_, t, 1), corner(*scene_, t, 2));
    const double winding = std::round(angle / (4 * std::numbers::pi));
    for (int k = 0; k < std::min(winding, 4.0); ++k) found.push_back(static_cast<std::uint32_t>(r + 1));
  }
  return found;
}

}  // namespace gleaner::scene

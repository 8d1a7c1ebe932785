#include "scene/library/bake.h"

#include <algorithm>
#include <cmath>
#include <span>
#include <vector>

#include "scene/model/instances.h"

namespace gleaner::scene {
namespace {

class Baker {
 public:
  explicit Baker(const Scene& scene) : from_(scene), to_(scene) {
    to_.meshes.clear();
    to_.instances.clear();
    to_.positions.clear();
    to_.normals.clear();
    to_.uvs.clear();
    to_.second_uvs.clear();
    to_.colors.clear();
    to_.indices.clear();
    to_.triangle_material.clear();
  }

  Scene bake() {
    for (const Mesh& mesh : from_.meshes)
      if (!mesh.instanced) add(mesh, nullptr);
    for (const Instance& instance : from_.instances) add(from_.meshes[instance.mesh], &instance);
    return std::move(to_);
  }

 private:
  void add(const Mesh& mesh, const Instance* instance) {
    to_.meshes.push_back({mesh.name, static_cast<std::uint32_t>(to_.triangle_count()), mesh.triangle_count});
    to_.meshes.back().deforming = mesh.deforming;
    DerivedInstance d{};
    if (instance) d = derived(instance->transform, {});
    const auto corners =
        std::span(from_.indices).subspan(std::size_t{3} * mesh.first_triangle, std::size_t{3} * mesh.triangle_count);
    if (corners.empty()) return;
    const auto [least, most] = std::minmax_element(corners.begin(), corners.end());
    std::vector<std::uint32_t> added(*most - *least + 1, GLEANER_NONE);
    for (std::size_t t = mesh.first_triangle; t < std::size_t{mesh.first_triangle} + mesh.triangle_count; ++t) {
      // Swapping two corners keeps the front of a mirrored triangle in front.
      for (const int k : {0, d.mirrored ? 2 : 1, d.mirrored ? 1 : 2}) {
        const std::uint32_t vertex = from_.indices[3 * t + k];
        std::uint32_t& number = added[vertex - *least];
        if (number == GLEANER_NONE) {
          number = static_cast<std::uint32_t>(to_.vertex_count());
          add_vertex(vertex, instance, d);
        }
        to_.indices.push_back(number);
      }
      to_.triangle_material.push_back(from_.triangle_material[t]);
    }
  }

  void add_vertex(std::size_t vertex, const Instance* instance, const DerivedInstance& d) {
    const float* p = &from_.positions[3 * vertex];
    const float* n = &from_.normals[3 * vertex];
    if (instance) {
      double normal[3];
      for (int r = 0; r < 3; ++r) {
        const gl_float* row = instance->transform + 4 * r;
        to_.positions.push_back(
            static_cast<float>(double{row[0]} * p[0] + double{row[1]} * p[1] + double{row[2]} * p[2] + row[3]));
        normal[r] = d.inverse[r] * n[0] + d.inverse[3 + r] * n[1] + d.inverse[6 + r] * n[2];
      }
      const double length = std::hypot(normal[0], normal[1], normal[2]);
      for (const double c : normal) to_.normals.push_back(length > 0 ? static_cast<float>(c / length) : 0.0f);
    } else {
      to_.positions.insert(to_.positions.end(), p, p + 3);
      to_.normals.insert(to_.normals.end(), n, n + 3);
    }
    const auto copy = [&](const auto& from, auto& to, std::size_t width) {
      if (!from.empty())
        to.insert(to.end(), from.begin() + static_cast<std::ptrdiff_t>(width * vertex),
                  from.begin() + static_cast<std::ptrdiff_t>(width * (vertex + 1)));
    };
    copy(from_.uvs, to_.uvs, 2);
    copy(from_.second_uvs, to_.second_uvs, 2);
    copy(from_.colors, to_.colors, 4);
  }

  const Scene& from_;
  Scene to_;
};

}  // namespace

Scene baked(const Scene& scene) { return Baker(scene).bake(); }

}  // namespace gleaner::scene

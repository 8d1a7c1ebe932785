#include "scene/model/rig.h"

#include <algorithm>
#include <cmath>
#include <string>

#include "scene/model/error.h"
#include "scene/model/limits.h"
#include "scene/model/scene.h"

namespace gleaner::scene {
namespace {

class RigChecker {
 public:
  RigChecker(const Scene& scene, const std::string& file) : scene_(scene), rig_(scene.rig), file_(file) {}

  void run() const {
    if (rig_.positions.size() % 3)
      fail("rig.positions", "three values a vertex", std::to_string(rig_.positions.size()));
    if (rig_.normals.size() != rig_.positions.size())
      fail("rig.normals", std::to_string(rig_.positions.size()) + " values", std::to_string(rig_.normals.size()));
    if (rig_.joint_weights.size() != rig_.joints.size())
      fail("rig.joint_weights", std::to_string(rig_.joints.size()) + " values",
           std::to_string(rig_.joint_weights.size()));
    if (rig_.matrices > kMostPoseValues) fail("rig.matrices", "fewer", std::to_string(rig_.matrices));
    if (rig_.morph_weights > kMostPoseValues) fail("rig.morph_weights", "fewer", std::to_string(rig_.morph_weights));
    finite(rig_.positions, "rig.positions");
    finite(rig_.normals, "rig.normals");
    finite(rig_.deltas, "rig.deltas");
    for (std::size_t i = 0; i < rig_.joint_weights.size(); ++i)
      if (!(rig_.joint_weights[i] >= 0 && std::isfinite(rig_.joint_weights[i])))
        fail(item("rig.joint_weights", i), "a finite value of at least 0", std::to_string(rig_.joint_weights[i]));
    std::uint64_t vertices = 0, triangles = 0;
    for (std::size_t i = 0; i < rig_.meshes.size(); ++i) {
      mesh(i, vertices, triangles);
      vertices = std::uint64_t{rig_.meshes[i].first_vertex} + rig_.meshes[i].vertex_count;
      triangles = std::uint64_t{rig_.meshes[i].first_triangle} + rig_.meshes[i].triangle_count;
    }
    corners();
    instances();
  }

 private:
  [[noreturn]] void fail(const std::string& element, const std::string& expected, const std::string& found) const {
    throw Error::bad_input(file_, element, expected, found);
  }

  void finite(const std::vector<float>& values, const char* name) const {
    for (std::size_t i = 0; i < values.size(); ++i)
      if (!std::isfinite(values[i])) fail(item(name, i), "a finite value", std::to_string(values[i]));
  }

  void within(const std::string& mesh, const char* what, std::uint64_t first, std::uint64_t count, std::uint64_t least,
              std::uint64_t most) const {
    if (first < least || first > most || count > most - first)
      fail(mesh + "." + what, "a range from " + std::to_string(least) + " to " + std::to_string(most),
           std::to_string(count) + " from " + std::to_string(first));
  }

  void mesh(std::size_t index, std::uint64_t first_vertex, std::uint64_t first_triangle) const {
    const PosedMesh& m = rig_.meshes[index];
    const std::string name = item("rig.meshes", index);
    if (m.vertex_count == 0) fail(name, "vertices", "none");
    within(name, "vertices", m.first_vertex, m.vertex_count, first_vertex, scene_.vertex_count());
    within(name, "triangles", m.first_triangle, m.triangle_count, first_triangle, scene_.triangle_count());
    within(name, "rest", m.first_rest, m.vertex_count, 0, rig_.positions.size() / 3);
    within(name, "targets", m.first_target, m.target_count, 0, rig_.targets.size());
    within(name, "weights", m.first_weight, m.target_count, 0, rig_.morph_weights);
    within(name, "matrices", m.first_matrix, m.matrix_count, 0, rig_.matrices);
    if (m.matrix_count == 0) fail(name + ".matrices", "at least one", "none");
    const std::uint64_t influences = std::uint64_t{m.influences} * m.vertex_count;
    within(name, "joints", m.first_influence, influences, 0, rig_.joints.size());
    for (std::size_t i = m.first_influence; i < m.first_influence + influences; ++i)
      if (rig_.joints[i] >= m.matrix_count)
        fail(item("rig.joints", i), "a joint below " + std::to_string(m.matrix_count), std::to_string(rig_.joints[i]));
    for (const std::uint32_t k : meshes_of(scene_, m))
      if (!scene_.meshes[k].deforming)
        fail(name + ".triangles", "triangles of meshes that deform", item("meshes", k) + ", which does not");
    for (std::size_t t = m.first_target; t < m.first_target + m.target_count; ++t)
      for (const gl_uint first : {rig_.targets[t].positions, rig_.targets[t].normals})
        if (first != GLEANER_NONE)
          within(item("rig.targets", t), "deltas", first, 3 * std::uint64_t{m.vertex_count}, 0, rig_.deltas.size());
  }

  // Posed triangles have posed corners, and no others do: who makes vertices anew knows which triangles change.
  void corners() const {
    std::size_t triangle = 0;
    const auto each_corner = [&](std::size_t end, std::uint64_t lower, std::uint64_t upper, bool inside) {
      for (; triangle < end; ++triangle)
        for (std::size_t k = 0; k < 3; ++k) {
          const std::uint32_t vertex = scene_.indices[3 * triangle + k];
          if (inside ? vertex < lower || vertex >= upper : is_posed(vertex))
            fail(item("indices", 3 * triangle + k),
                 inside ? "a vertex of the triangle's posed mesh" : "a vertex that is not posed",
                 std::to_string(vertex));
        }
    };
    for (const PosedMesh& m : rig_.meshes) {
      each_corner(m.first_triangle, 0, 0, false);
      each_corner(m.first_triangle + m.triangle_count, m.first_vertex, std::uint64_t{m.first_vertex} + m.vertex_count,
                  true);
    }
    if (!rig_.meshes.empty()) each_corner(scene_.triangle_count(), 0, 0, false);
  }

  void instances() const {
    for (std::size_t i = 0; i < rig_.instances.size(); ++i) {
      const PosedInstance& posed = rig_.instances[i];
      const std::uint32_t least = i == 0 ? 0 : rig_.instances[i - 1].instance + 1;
      if (posed.instance < least || posed.instance >= scene_.instances.size())
        fail(item("rig.instances", i) + ".instance",
             "an instance from " + std::to_string(least) + " on, below " + std::to_string(scene_.instances.size()),
             std::to_string(posed.instance));
      if (posed.matrix >= rig_.matrices)
        fail(item("rig.instances", i) + ".matrix", "a matrix below " + std::to_string(rig_.matrices),
             std::to_string(posed.matrix));
    }
  }

  bool is_posed(std::uint32_t vertex) const {
    auto after = std::upper_bound(rig_.meshes.begin(), rig_.meshes.end(), vertex,
                                  [](std::uint32_t v, const PosedMesh& m) { return v < m.first_vertex; });
    return after != rig_.meshes.begin() && vertex - (after - 1)->first_vertex < (after - 1)->vertex_count;
  }

  const Scene& scene_;
  const Rig& rig_;
  const std::string& file_;
};

}  // namespace

std::vector<std::uint32_t> meshes_of(const Scene& scene, const PosedMesh& posed) {
  std::vector<std::uint32_t> found;
  if (posed.triangle_count == 0) return found;
  const auto after = std::upper_bound(scene.meshes.begin(), scene.meshes.end(), posed.first_triangle,
                                      [](std::uint32_t t, const Mesh& mesh) { return t < mesh.first_triangle; });
  // Of meshes that begin at one triangle, all but the last are empty.
  auto m = after == scene.meshes.begin() ? 0 : static_cast<std::uint32_t>(after - scene.meshes.begin() - 1);
  const std::uint32_t end = posed.first_triangle + posed.triangle_count;
  for (; m < scene.meshes.size() && scene.meshes[m].first_triangle < end; ++m) found.push_back(m);
  return found;
}

void mark_deforming(Scene& scene) {
  for (const PosedMesh& posed : scene.rig.meshes)
    for (const std::uint32_t m : meshes_of(scene, posed)) scene.meshes[m].deforming = true;
}

void validate_rig(const Scene& scene, const std::string& file) { RigChecker(scene, file).run(); }

}  // namespace gleaner::scene

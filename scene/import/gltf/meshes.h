#pragma once
// Meshes where nodes place them: flat arrays in the scene's space.

#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "scene/import/gltf/document.h"
#include "scene/import/gltf/materials.h"
#include "scene/import/gltf/nodes.h"
#include "scene/import/gltf/primitive.h"
#include "scene/import/gltf/rigging.h"
#include "scene/import/placement.h"

namespace gleaner::scene::gltf {

// Meshes are instanced, stored once and placed by transforms, under nodes that move, and wherever that pays: with so
// many triangles, and where one copy for each place would add so many. Fewer are traced faster, and shaded as fast, as
// copies.
inline constexpr std::size_t kLeastInstancedTriangles = 256;
inline constexpr std::size_t kLeastSparedTriangles = 50'000;

class Meshes {
 public:
  // `variant`: see Materials::material_of. `instances`: see ImportOptions.
  Meshes(Document& document, Scene& scene, Materials& materials, Nodes& nodes, Rigging& rigging, Warnings& warnings,
         std::optional<std::size_t> variant, bool instances)
      : document_(document),
        scene_(scene),
        materials_(materials),
        nodes_(nodes),
        rigging_(rigging),
        warnings_(warnings),
        variant_(variant),
        may_instance_(instances) {}

  // Finds what stands where, and the box around all of it in the file's coordinates.
  Box place();
  // Adds it all, relative to the scene's origin.
  void add();

 private:
  void choose_instanced();
  bool may_be_instanced(const Element& mesh);
  bool pays(const std::vector<Instance*>& nodes) const;
  void place_node(std::size_t index);
  std::vector<Matrix> repeated(const Element& instancing) const;
  Skin skin_of(const Element& reference) const;
  Element mesh_of(const Instance& instance) const;
  PrimitiveSize counted(const Instance& instance, PrimitiveSize total) const;
  Box box_of(const Primitive& primitive, const Instance& instance);

  void add_instance(const Instance& instance);
  // In the mesh's own space, or as the placements say. `is_last`: the node reads the mesh's primitives no more.
  void add_mesh(const Instance& instance, bool in_own_space, bool is_last);
  // By the instance's placement `local`, or its skin. `origin` comes off the placed positions. `is_last`: the node
  // reads the primitive no more.
  void add_primitive(const Primitive& primitive, std::uint32_t material, const Instance& instance, std::size_t local,
                     const Point3& origin, bool is_last);
  void add_triangles(const Primitive& primitive, const std::vector<std::uint32_t>& kept, std::uint32_t first,
                     bool mirrored);
  void count_uses(const Element& primitive);
  void release(const Element& primitive, bool corners);
  void add_vertices(const Primitive& primitive, const std::vector<std::uint32_t>& kept, std::size_t count,
                    const Instance& instance, const Matrix& placement, const Point3& origin);
  void add_colors(const Primitive& primitive, const std::vector<std::uint32_t>& kept, std::size_t count);
  void add_uvs(const Primitive& primitive, const std::vector<std::uint32_t>& kept, std::size_t count,
               std::uint32_t material, std::size_t channel, std::vector<float>& to);
  Matrix skinned(const Primitive& primitive, const Instance& instance, std::size_t vertex) const;

  Document& document_;
  Scene& scene_;
  Materials& materials_;
  Nodes& nodes_;
  Rigging& rigging_;
  Warnings& warnings_;
  std::optional<std::size_t> variant_;
  bool may_instance_;
  std::map<std::string, std::uint32_t> stored_meshes_;  // the file's name of an instanced mesh -> the scene's number
  std::vector<Instance> instances_;
  std::vector<std::uint32_t> uses_of_view_;      // by primitives that are still to be added
  PrimitiveSize total_;                          // of all instances
  std::map<std::string, Box> box_of_primitive_;  // in the mesh's space
  DracoMeshes draco_meshes_;
};

}  // namespace gleaner::scene::gltf

#pragma once
// Meshes where nodes place them: flat arrays in the scene's space.

#include <cstdint>
#include <map>
#include <optional>
#include <vector>

#include "scene/import/gltf/document.h"
#include "scene/import/gltf/materials.h"
#include "scene/import/gltf/nodes.h"
#include "scene/import/gltf/primitive.h"
#include "scene/import/gltf/rigging.h"
#include "scene/import/placement.h"

namespace gleaner::scene::gltf {

class Meshes {
 public:
  Meshes(Document& document, Scene& scene, Materials& materials, Nodes& nodes, Rigging& rigging, Warnings& warnings)
      : document_(document),
        scene_(scene),
        materials_(materials),
        nodes_(nodes),
        rigging_(rigging),
        warnings_(warnings) {}

  // Finds what stands where, and the box around all of it in the file's coordinates.
  Box place();
  // Adds it all, relative to the scene's origin. `variant`: see Materials::material_of.
  void add(std::optional<std::size_t> variant);

 private:
  void place_node(std::size_t index);
  std::vector<Matrix> repeated(const Element& instancing, const Element& mesh) const;
  Skin skin_of(const Element& reference) const;
  Element mesh_of(const Instance& instance) const;
  PrimitiveSize counted(const Instance& instance, PrimitiveSize total) const;
  Box box_of(const Primitive& primitive, const Instance& instance);

  void add_instance(const Instance& instance, std::optional<std::size_t> variant);
  // `is_last`: the primitive's vertices are not read after this.
  // `local`: which of the instance's.
  void add_primitive(const Primitive& primitive, std::uint32_t material, const Instance& instance, std::size_t local,
                     bool is_last);
  void add_triangles(const Primitive& primitive, const std::vector<std::uint32_t>& kept, std::uint32_t first,
                     bool mirrored);
  void count_uses(const Element& primitive);
  void release(const Element& primitive, bool corners);
  void add_vertices(const Primitive& primitive, const std::vector<std::uint32_t>& kept, std::size_t count,
                    const Instance& instance, const Matrix& placement);
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
  std::vector<Instance> instances_;
  std::vector<std::uint32_t> uses_of_view_;      // by primitives that are still to be added
  PrimitiveSize total_;                          // of all instances
  std::map<std::string, Box> box_of_primitive_;  // in the mesh's space
  DracoMeshes draco_meshes_;
};

}  // namespace gleaner::scene::gltf

#pragma once
// Compressed geometry: EXT_meshopt_compression of buffer views, KHR_draco_mesh_compression of primitives.

#include <cstddef>
#include <cstdint>
#include <map>
#include <span>
#include <string>
#include <vector>

#include "scene/import/gltf/element.h"

namespace gleaner::scene::gltf {

// The bytes that a buffer view's EXT_meshopt_compression (`compression`) describes, from its `encoded` ones.
std::vector<std::byte> meshopt_decoded(const Element& compression, std::span<const std::byte> encoded);

// A primitive as Draco holds it. Values are as an accessor of floats would give them.
struct DracoMesh {
  std::vector<std::uint32_t> indices;  // three a triangle
  std::size_t vertices = 0;
  struct Attribute {
    std::size_t components = 0;
    std::vector<float> values;
  };
  std::map<std::string, Attribute> attributes;  // by their names in the primitive
};

// `compression`: the primitive's KHR_draco_mesh_compression. At most `most_vertices` and `most_triangles`: what the
// primitive's accessors promise.
DracoMesh draco_decoded(const Element& compression, std::span<const std::byte> encoded, std::size_t most_vertices,
                        std::size_t most_triangles);

}  // namespace gleaner::scene::gltf

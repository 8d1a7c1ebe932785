#pragma once
// The scene's blob: one run of bytes with a table of 64-byte aligned sections, the same on disk, on the wire and in
// memory. The BVH of the OpenCL tracer travels in a blob of its own (kind `bvh`), so that who traces with Embree never
// fetches it.

#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "scene/model/scene.h"

namespace gleaner::scene {

using Bytes = std::vector<std::byte>;

// A tree within a BVH: nodes [first_node, first_node + nodes), the root first and each before its children, whose
// leaves name slots [first_slot, first_slot + slots).
struct BvhPart {
  std::uint32_t mesh;  // an instanced one, in its own space, or one that deforms; GLEANER_NONE: all other meshes
  std::uint32_t first_node, nodes, first_slot, slots;
};

// Binary BVHs for the OpenCL tracer: one of all meshes that stand still in the world, then one for each mesh that is
// instanced or deforms, in their order. The top level over them is built where they are loaded.
struct Bvh {
  std::vector<BvhNode> nodes;
  std::vector<std::uint32_t> triangles;  // slot -> triangle
  std::vector<BvhPart> parts;            // consecutive ranges of nodes and slots that cover all
  std::uint32_t max_depth = 0;           // deepest leaf; a traversal stack needs as many entries
};

Bytes serialize(const Scene& scene);
Bytes serialize(const Bvh& bvh);

// Throw Error::bad_input (named `origin`) on truncated, oversized, misaligned or inconsistent bytes; the result passed
// validate().
Scene parse_scene(std::span<const std::byte> bytes, const std::string& origin);
Bvh parse_bvh(std::span<const std::byte> bytes, std::size_t triangle_count, const std::string& origin);

}  // namespace gleaner::scene

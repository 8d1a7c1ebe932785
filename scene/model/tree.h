#pragma once
// Binary trees of boxes, in the records that the OpenCL tracer walks: built by the surface area heuristic, refitted,
// and measured. Workers build the top level with it, and the trees of meshes that have deformed too far for refitting;
// it needs no Embree, which machines without a CPU device to trace on may lack. (scene/bvh builds what blobs carry.)

#include <algorithm>
#include <array>
#include <cfloat>
#include <cstdint>
#include <span>
#include <vector>

#include "scene/model/scene.h"

namespace gleaner::scene {

struct TreeBox {
  std::array<float, 3> lower{FLT_MAX, FLT_MAX, FLT_MAX};
  std::array<float, 3> upper{-FLT_MAX, -FLT_MAX, -FLT_MAX};

  void extend(const float* point) {
    for (std::size_t k = 0; k < 3; ++k) {
      lower[k] = std::min(lower[k], point[k]);
      upper[k] = std::max(upper[k], point[k]);
    }
  }
  void extend(const TreeBox& other) {
    extend(other.lower.data());
    extend(other.upper.data());
  }
  double half_area() const;  // 0 where empty
};

// A node or a leaf as its parent's record names it (BvhNode::child), and the box about it.
struct TreeChild {
  std::uint32_t reference;
  TreeBox box;
};

// A record whose two children are empty leaves.
BvhNode empty_node();
void set_child(BvhNode& parent, int side, const TreeChild& child);

struct Tree {
  std::vector<BvhNode> nodes;        // the root first, each before its children
  std::vector<std::uint32_t> slots;  // of leaves: numbers of boxes
  std::uint32_t depth = 0;           // edges from the root to the deepest leaf, at least 1
};

// A leaf holds at most `most` boxes (1 to 15). depth is at most kMaxBvhDepth, whatever the boxes. There is always a
// root with two children; missing ones are empty leaves. Splits minimize the surface area heuristic over 16 bins an
// axis (Wald 2007, "On fast Construction of SAH-based Bounding Volume Hierarchies"). The result depends on the boxes
// alone.
Tree build_tree(std::span<const TreeBox> boxes, std::uint32_t most);

// A run of nodes of a larger table, whose children and slots are numbered within that table.
struct TreeNodes {
  std::span<BvhNode> nodes;  // each before its children
  std::uint32_t first;       // number of the first of them
};

// Boxes fitted anew to what the leaves hold: box_of(slot) gives that of a slot.
template <typename BoxOf>
void refit(const TreeNodes& tree, const BoxOf& box_of) {
  const auto box_of_child = [&](std::uint32_t child) {
    TreeBox box;
    if (child & GLEANER_BVH_LEAF) {
      const std::uint32_t first = child & 0x07ffffffu, count = child >> 27 & 15u;
      for (std::uint32_t k = 0; k < count; ++k) box.extend(box_of(first + k));
    } else {
      const BvhNode& node = tree.nodes[child - tree.first];
      for (int c = 0; c < 3; ++c) {
        box.lower[c] = std::min(node.lower0[c], node.lower1[c]);
        box.upper[c] = std::max(node.upper0[c], node.upper1[c]);
      }
    }
    return box;
  };
  for (std::size_t i = tree.nodes.size(); i-- > 0;) {
    BvhNode& node = tree.nodes[i];
    const TreeBox box0 = box_of_child(node.child[0]), box1 = box_of_child(node.child[1]);
    std::copy(box0.lower.begin(), box0.lower.end(), node.lower0);
    std::copy(box0.upper.begin(), box0.upper.end(), node.upper0);
    std::copy(box1.lower.begin(), box1.lower.end(), node.lower1);
    std::copy(box1.upper.begin(), box1.upper.end(), node.upper1);
  }
}

// The SAH cost of tracing a random ray that meets the root's box: one for each node that it meets, and one for each box
// in a leaf that it meets.
double sah_cost(std::span<const BvhNode> nodes);

}  // namespace gleaner::scene

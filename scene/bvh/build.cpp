#include "scene/bvh/build.h"

#include <embree3/rtcore.h>

#include <algorithm>
#include <array>
#include <bit>
#include <cfloat>
#include <cmath>
#include <memory>
#include <span>
#include <string>
#include <type_traits>
#include <utility>

#include "scene/model/error.h"
#include "scene/model/instances.h"
#include "scene/model/limits.h"
#include "scene/model/tree.h"

namespace gleaner::scene {
namespace {

// Embree ends the SAH splits 8 levels above maxDepth, its root has depth 1, and what then still holds too many
// triangles is halved here: 39 levels of SAH and 25 of halving 2^27 triangles make 64.
constexpr unsigned kEmbreeMaxDepth = 48;
constexpr std::uint32_t kSahLevels = kEmbreeMaxDepth - 8 - 1;
static_assert(kSahLevels + std::bit_width((1u << 27) / kMaxLeafTriangles - 1) == kMaxBvhDepth);

// What Embree's callbacks leave behind. A leaf is a range of the primitive array, which Embree sorts in place.
struct BuildNode {
  BuildNode* child[2];
  const RTCBuildPrimitive* primitives;
  std::size_t count;  // 0 = inner node
};

bool can_be_hit(const Scene& scene, std::uint32_t triangle) {
  double p[3][3];
  for (int corner = 0; corner < 3; ++corner)
    for (int k = 0; k < 3; ++k) {
      const float x = scene.positions[3 * std::size_t{scene.indices[3 * std::size_t{triangle} + corner]} + k];
      if (!(std::fabs(x) <= kMaxCoordinate)) return false;  // in this form it refuses NaN too
      p[corner][k] = x;
    }
  for (int k = 0; k < 3; ++k) {
    const int i = (k + 1) % 3, j = (k + 2) % 3;
    if ((p[1][i] - p[0][i]) * (p[2][j] - p[0][j]) != (p[1][j] - p[0][j]) * (p[2][i] - p[0][i])) return true;
  }
  return false;
}

TreeBox box_of(const Scene& scene, std::uint32_t triangle) {
  TreeBox box;
  for (int corner = 0; corner < 3; ++corner)
    box.extend(&scene.positions[3 * std::size_t{scene.indices[3 * std::size_t{triangle} + corner]}]);
  return box;
}

std::vector<RTCBuildPrimitive> primitives_of(const Scene& scene, const std::vector<TriangleRun>& runs) {
  std::vector<RTCBuildPrimitive> primitives;
  const auto add = [&](std::uint32_t triangle) {
    if (!can_be_hit(scene, triangle)) return;
    const TreeBox box = box_of(scene, triangle);
    RTCBuildPrimitive primitive{};
    primitive.lower_x = box.lower[0];
    primitive.lower_y = box.lower[1];
    primitive.lower_z = box.lower[2];
    primitive.upper_x = box.upper[0];
    primitive.upper_y = box.upper[1];
    primitive.upper_z = box.upper[2];
    primitive.primID = triangle;
    primitives.push_back(primitive);
  };
  for (const TriangleRun& run : runs) {
    primitives.reserve(primitives.size() + run.count);
    for (std::uint32_t t = 0; t < run.count; ++t) add(run.first + t);
  }
  return primitives;
}

// Turns Embree's trees into records, depth first, and halves the leaves that are too large for one.
class Flattener {
 public:
  Flattener(const Scene& scene, Bvh& bvh) : scene_(scene), bvh_(bvh) {}

  // Adds a part. No root: a part of no triangles.
  void flatten(const BuildNode* root, std::uint32_t mesh) {
    BvhPart part{mesh, static_cast<std::uint32_t>(bvh_.nodes.size()), 0,
                 static_cast<std::uint32_t>(bvh_.triangles.size()), 0};
    if (root != nullptr && root->count == 0) {
      add(*root, 0);
    } else if (root != nullptr && root->count > kMaxLeafTriangles) {
      halve(triangles_of(*root), 0);
    } else {
      // No inner node to stand at the root: it gets one leaf, or none, and empty ones.
      bvh_.nodes.push_back(empty_node());
      bvh_.max_depth = std::max(bvh_.max_depth, 1u);
      if (root != nullptr) set_child(bvh_.nodes[part.first_node], 0, leaf(triangles_of(*root), 1));
    }
    part.nodes = static_cast<std::uint32_t>(bvh_.nodes.size()) - part.first_node;
    part.slots = static_cast<std::uint32_t>(bvh_.triangles.size()) - part.first_slot;
    bvh_.parts.push_back(part);
  }

 private:
  using Child = TreeChild;

  // In the order of their numbers, in which Embree leaves them.
  static std::vector<std::uint32_t> triangles_of(const BuildNode& node) {
    std::vector<std::uint32_t> triangles(node.count);
    for (std::size_t i = 0; i < node.count; ++i) triangles[i] = node.primitives[i].primID;
    return triangles;
  }

  Child leaf(std::span<const std::uint32_t> triangles, std::uint32_t depth) {
    Child child{GLEANER_BVH_LEAF | static_cast<std::uint32_t>(triangles.size()) << 27 |
                    static_cast<std::uint32_t>(bvh_.triangles.size()),
                {}};
    for (std::uint32_t triangle : triangles) {
      child.box.extend(box_of(scene_, triangle));
      bvh_.triangles.push_back(triangle);
    }
    bvh_.max_depth = std::max(bvh_.max_depth, depth);
    return child;
  }

  // Returns the record's number and box; `depth` is the number of edges above it.
  Child add(const BuildNode& node, std::uint32_t depth) {
    if (node.count != 0) return add_triangles(triangles_of(node), depth);
    const auto index = static_cast<std::uint32_t>(bvh_.nodes.size());
    bvh_.nodes.push_back(empty_node());
    Child here{index, {}};
    for (int side = 0; side < 2; ++side) {
      const Child child = add(*node.child[side], depth + 1);
      set_child(bvh_.nodes[index], side, child);
      here.box.extend(child.box);
    }
    return here;
  }

  Child add_triangles(std::vector<std::uint32_t> triangles, std::uint32_t depth) {
    return triangles.size() <= kMaxLeafTriangles ? leaf(triangles, depth) : halve(triangles, depth);
  }

  // Splits at the median of the boxes' centres along their longest axis, into halves that differ by less than a leaf,
  // so that n triangles take ceil(log2(n / kMaxLeafTriangles)) levels.
  Child halve(std::vector<std::uint32_t> triangles, std::uint32_t depth) {
    TreeBox centres;
    const auto centre = [&](std::uint32_t triangle, int k) {
      const TreeBox box = box_of(scene_, triangle);
      return 0.5f * box.lower[k] + 0.5f * box.upper[k];
    };
    for (std::uint32_t triangle : triangles) {
      const std::array<float, 3> point{centre(triangle, 0), centre(triangle, 1), centre(triangle, 2)};
      centres.extend(point.data());
    }
    int axis = 0;
    for (int k = 1; k < 3; ++k)
      if (centres.upper[k] - centres.lower[k] > centres.upper[axis] - centres.lower[axis]) axis = k;
    const std::size_t leaves = (triangles.size() + kMaxLeafTriangles - 1) / kMaxLeafTriangles;
    const std::size_t middle = (leaves + 1) / 2 * kMaxLeafTriangles;
    std::nth_element(triangles.begin(), triangles.begin() + static_cast<std::ptrdiff_t>(middle), triangles.end(),
                     [&](std::uint32_t a, std::uint32_t b) {
                       return std::pair(centre(a, axis), a) < std::pair(centre(b, axis), b);
                     });
    std::vector<std::uint32_t> upper(triangles.begin() + static_cast<std::ptrdiff_t>(middle), triangles.end());
    triangles.resize(middle);
    // nth_element leaves an order within the halves that belongs to the standard library, not to the scene.
    std::sort(triangles.begin(), triangles.end());
    std::sort(upper.begin(), upper.end());

    const auto index = static_cast<std::uint32_t>(bvh_.nodes.size());
    bvh_.nodes.push_back(empty_node());
    Child here{index, {}};
    int side = 0;
    for (std::vector<std::uint32_t>* half : {&triangles, &upper}) {
      const Child child = add_triangles(std::move(*half), depth + 1);
      set_child(bvh_.nodes[index], side++, child);
      here.box.extend(child.box);
    }
    return here;
  }

  const Scene& scene_;
  Bvh& bvh_;
};

void* create_node(RTCThreadLocalAllocator allocator, unsigned, void*) {
  return new (rtcThreadLocalAlloc(allocator, sizeof(BuildNode), alignof(BuildNode))) BuildNode{};
}

void set_children(void* node, void** children, unsigned count, void*) {
  for (unsigned i = 0; i < count; ++i) static_cast<BuildNode*>(node)->child[i] = static_cast<BuildNode*>(children[i]);
}

// The boxes are made again from the triangles, so that they are exact whatever Embree rounds.
void ignore_bounds(void*, const RTCBounds**, unsigned, void*) {}

void* create_leaf(RTCThreadLocalAllocator allocator, const RTCBuildPrimitive* primitives, std::size_t count, void*) {
  return new (rtcThreadLocalAlloc(allocator, sizeof(BuildNode), alignof(BuildNode)))
      BuildNode{{nullptr, nullptr}, primitives, count};
}

void build_part(const Scene& scene, std::uint32_t mesh, const std::vector<TriangleRun>& runs, RTCDevice device,
                Bvh& bvh) {
  std::vector<RTCBuildPrimitive> primitives = primitives_of(scene, runs);
  if (primitives.empty()) return Flattener(scene, bvh).flatten(nullptr, mesh);
  const std::unique_ptr<std::remove_pointer_t<RTCBVH>, decltype(&rtcReleaseBVH)> tree(rtcNewBVH(device),
                                                                                      &rtcReleaseBVH);
  RTCBuildArguments arguments = rtcDefaultBuildArguments();
  arguments.buildQuality = RTC_BUILD_QUALITY_MEDIUM;
  arguments.maxBranchingFactor = 2;
  arguments.maxDepth = kEmbreeMaxDepth;
  arguments.minLeafSize = 1;
  // Embree fails where it meets its depth limit with more triangles than it may put into leaves; with no limit on those
  // it hands over what is left, and Flattener halves it.
  arguments.maxLeafSize = static_cast<unsigned>(primitives.size());
  arguments.bvh = tree.get();
  arguments.primitives = primitives.data();
  arguments.primitiveCount = primitives.size();
  arguments.primitiveArrayCapacity = primitives.size();
  arguments.createNode = create_node;
  arguments.setNodeChildren = set_children;
  arguments.setNodeBounds = ignore_bounds;
  arguments.createLeaf = create_leaf;
  const void* root = rtcBuildBVH(&arguments);
  if (root == nullptr)
    throw Error::failed("BVH of " + std::to_string(primitives.size()) +
                        " triangles: Embree could not build it (error " + std::to_string(rtcGetDeviceError(device)) +
                        ")");
  Flattener(scene, bvh).flatten(static_cast<const BuildNode*>(root), mesh);
}

}  // namespace

Bvh build_bvh(const Scene& scene) {
  const std::unique_ptr<std::remove_pointer_t<RTCDevice>, decltype(&rtcReleaseDevice)> device(rtcNewDevice(nullptr),
                                                                                              &rtcReleaseDevice);
  if (!device)
    throw Error::failed("BVH: Embree made no device (error " + std::to_string(rtcGetDeviceError(nullptr)) + ")");
  Bvh bvh;
  build_part(scene, GLEANER_NONE, still_triangles(scene), device.get(), bvh);
  for (const std::uint32_t m : meshes_with_own_bvh(scene))
    build_part(scene, m, {{scene.meshes[m].first_triangle, scene.meshes[m].triangle_count}}, device.get(), bvh);
  return bvh;
}

}  // namespace gleaner::scene

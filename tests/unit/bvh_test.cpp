#include <gtest/gtest.h>
#include <tbb/global_control.h>

#include <algorithm>
#include <array>
#include <bit>
#include <cfloat>
#include <cmath>
#include <functional>
#include <limits>
#include <optional>
#include <random>

#include "scene/bvh/build.h"
#include "scene/library/library.h"
#include "scene/model/limits.h"

namespace gleaner::scene {
namespace {

constexpr float kInfinity = std::numeric_limits<float>::infinity();

struct Leaf {
  std::uint32_t first, count;
};

std::optional<Leaf> leaf_of(std::uint32_t child) {
  if (!(child & GLEANER_BVH_LEAF)) return {};
  return Leaf{child & 0x07ffffffu, child >> 27 & 15u};
}

struct Box {
  std::array<float, 3> lower{FLT_MAX, FLT_MAX, FLT_MAX}, upper{-FLT_MAX, -FLT_MAX, -FLT_MAX};
  bool operator==(const Box&) const = default;
  void extend(const Box& other) {
    for (int k = 0; k < 3; ++k) {
      lower[k] = std::min(lower[k], other.lower[k]);
      upper[k] = std::max(upper[k], other.upper[k]);
    }
  }
};

const float* corner_of(const Scene& scene, std::uint32_t triangle, int corner) {
  return &scene.positions[3 * std::size_t{scene.indices[3 * std::size_t{triangle} + corner]}];
}

Box box_of(const Scene& scene, std::uint32_t triangle) {
  Box box;
  for (int corner = 0; corner < 3; ++corner) {
    const float* p = corner_of(scene, triangle, corner);
    box.extend({{p[0], p[1], p[2]}, {p[0], p[1], p[2]}});
  }
  return box;
}

Box child_box(const BvhNode& node, int side) {
  Box box;
  std::copy_n(side == 0 ? node.lower0 : node.lower1, 3, box.lower.begin());
  std::copy_n(side == 0 ? node.upper0 : node.upper1, 3, box.upper.begin());
  return box;
}

std::uint32_t add_triangle(Scene& scene, const std::array<std::array<float, 3>, 3>& corners) {
  for (const auto& corner : corners) {
    scene.indices.push_back(static_cast<std::uint32_t>(scene.vertex_count()));
    scene.positions.insert(scene.positions.end(), corner.begin(), corner.end());
  }
  return static_cast<std::uint32_t>(scene.triangle_count() - 1);
}

// Small triangles all over the unit cube.
Scene soup(std::size_t count, unsigned seed) {
  std::mt19937 random(seed);
  const auto unit = [&] { return static_cast<float>(random()) * 0x1p-32f; };
  Scene scene;
  for (std::size_t i = 0; i < count; ++i) {
    const std::array<float, 3> at{unit(), unit(), unit()};
    std::array<std::array<float, 3>, 3> corners;
    for (auto& corner : corners)
      for (int k = 0; k < 3; ++k) corner[k] = at[k] + 0.1f * unit();
    add_triangle(scene, corners);
  }
  return scene;
}

struct Shape {
  std::size_t leaves = 0, empty_leaves = 0;
  std::uint32_t depth = 0, largest_leaf = 0;
};

// Checks every promise of build.h and returns the tree's shape. `expected` are the triangles that must be in it.
Shape check(const Scene& scene, const Bvh& bvh, const std::vector<std::uint32_t>& expected) {
  Shape shape;
  std::vector<std::uint32_t> found;
  std::vector<bool> slot_seen(bvh.triangles.size()), node_seen(bvh.nodes.size());
  std::uint32_t next = 0;  // depth-first numbering
  const std::function<Box(std::uint32_t, std::uint32_t)> visit = [&](std::uint32_t index, std::uint32_t depth) {
    Box here;
    if (index >= bvh.nodes.size() || node_seen[index]) {
      ADD_FAILURE() << "node " << index << " does not exist or is reached twice";
      return here;
    }
    EXPECT_EQ(index, next++) << "nodes are not depth first";
    node_seen[index] = true;
    const BvhNode& node = bvh.nodes[index];
    for (int side = 0; side < 2; ++side) {
      Box box;
      if (const auto leaf = leaf_of(node.child[side])) {
        shape.depth = std::max(shape.depth, depth + 1);
        shape.largest_leaf = std::max(shape.largest_leaf, leaf->count);
        ++(leaf->count == 0 ? shape.empty_leaves : shape.leaves);
        for (std::uint32_t slot = leaf->first; slot < leaf->first + leaf->count; ++slot) {
          if (slot >= bvh.triangles.size() || slot_seen[slot]) {
            ADD_FAILURE() << "slot " << slot << " does not exist or is in two leaves";
            continue;
          }
          slot_seen[slot] = true;
          found.push_back(bvh.triangles[slot]);
          box.extend(box_of(scene, bvh.triangles[slot]));
        }
      } else {
        box = visit(node.child[side], depth + 1);
      }
      EXPECT_EQ(child_box(node, side), box) << "box " << side << " of node " << index;
      here.extend(box);
    }
    return here;
  };
  visit(0, 0);
  EXPECT_EQ(next, bvh.nodes.size()) << "nodes that nothing reaches";
  std::sort(found.begin(), found.end());
  EXPECT_EQ(found, expected);
  EXPECT_EQ(shape.depth, bvh.max_depth);
  EXPECT_LE(bvh.max_depth, scene::kMaxBvhDepth);
  EXPECT_LE(shape.largest_leaf, kMaxLeafTriangles);
  return shape;
}

std::vector<std::uint32_t> all_triangles(const Scene& scene) {
  std::vector<std::uint32_t> all(scene.triangle_count());
  for (std::uint32_t i = 0; i < all.size(); ++i) all[i] = i;
  return all;
}

TEST(Bvh, HoldsEveryTriangleOnceInBoxesThatFit) {
  for (const char* name : {"cornell-box", "hall", "many-lights", "needles", "glass-caustic", "far", "thin-walls"}) {
    SCOPED_TRACE(name);
    const Scene scene = make_scene(name);
    const Shape shape = check(scene, build_bvh(scene), all_triangles(scene));
    EXPECT_EQ(shape.empty_leaves, 0u);
    EXPECT_GE(shape.leaves, scene.triangle_count() / kMaxLeafTriangles);
  }
}

TEST(Bvh, IsTheSameForAnyNumberOfThreads) {
  const Scene scene = make_scene("hall", {{"triangles", "400000"}});
  const auto built_with = [&](std::size_t threads) {
    const tbb::global_control limit(tbb::global_control::max_allowed_parallelism, threads);
    return serialize(build_bvh(scene));
  };
  const Bytes single = built_with(1);
  for (int repetition = 0; repetition < 3; ++repetition) EXPECT_TRUE(built_with(2) == single);
}

TEST(Bvh, OfNothingHasAnEmptyRoot) {
  const Scene scene;
  const Bvh bvh = build_bvh(scene);
  const Shape shape = check(scene, bvh, {});
  EXPECT_EQ(bvh.nodes.size(), 1u);
  EXPECT_EQ(shape.empty_leaves, 2u);
  EXPECT_EQ(bvh.max_depth, 1u);
  EXPECT_EQ(bvh.nodes[0].lower0[0], FLT_MAX);
  EXPECT_EQ(bvh.nodes[0].upper1[2], -FLT_MAX);
}

TEST(Bvh, OfFewTrianglesHasARoot) {
  for (std::size_t count = 1; count <= 9; ++count) {
    SCOPED_TRACE(count);
    const Scene scene = soup(count, 7);
    const Shape shape = check(scene, build_bvh(scene), all_triangles(scene));
    EXPECT_LE(shape.empty_leaves, 1u);
  }
}

TEST(Bvh, LeavesOutWhatNoRayCanHit) {
  const float nan = std::numeric_limits<float>::quiet_NaN();
  Scene scene = soup(20, 3);
  std::vector<std::uint32_t> expected = all_triangles(scene);
  add_triangle(scene, {{{0, 0, 0}, {0, 0, 0}, {1, 1, 1}}});           // two corners in one place
  add_triangle(scene, {{{0, 0, 0}, {0.5f, 0.5f, 0.5f}, {1, 1, 1}}});  // in a line
  add_triangle(scene, {{{nan, 0, 0}, {1, 0, 0}, {0, 1, 0}}});
  add_triangle(scene, {{{0, 0, 0}, {1, kInfinity, 0}, {0, 1, 0}}});
  add_triangle(scene, {{{0, 0, 0}, {1, 0, -kInfinity}, {0, 1, 0}}});
  add_triangle(scene, {{{0, 0, 0}, {2e9f, 0, 0}, {0, 2e9f, 0}}});  // farther than any valid scene
  // Thin, tiny and large ones stay.
  expected.push_back(add_triangle(scene, {{{0, 0, 0}, {1, 0, 0}, {0.5f, 1e-30f, 0}}}));
  expected.push_back(add_triangle(scene, {{{0, 0, 0}, {1e-38f, 0, 0}, {0, 1e-38f, 0}}}));
  expected.push_back(add_triangle(scene, {{{0, 0, 0}, {1e9f, 0, 0}, {0, 1e9f, 0}}}));
  check(scene, build_bvh(scene), expected);
}

TEST(Bvh, HalvesWhatNoSplitSeparates) {
  Scene scene;
  for (int i = 0; i < 10000; ++i) add_triangle(scene, {{{0, 0, 0}, {1, 0, 0}, {0, 1, 0}}});
  const Shape shape = check(scene, build_bvh(scene), all_triangles(scene));
  EXPECT_EQ(shape.leaves, 2500u);
  EXPECT_EQ(shape.depth, 12u);  // 2^12 > 2500
}

// A tree that spares a level would make the comb useless as a test of traversal stacks.
TEST(Bvh, OfACombIsDeep) {
  const Scene scene = make_scene("comb");
  const Shape shape = check(scene, build_bvh(scene), all_triangles(scene));
  EXPECT_GE(shape.depth, 30u);
}

// The comb's law over all that validate() lets pass and float can express: more teeth than Embree gets levels. It cuts
// 39 off one by one; the nine that are left take two halvings.
TEST(Bvh, NeverExceedsItsDepth) {
  Scene scene;
  double size = 1e9;
  for (int left = 48; left > 0; --left) {
    const auto s = static_cast<float>(size);
    add_triangle(scene, {{{0.9f * s, 0, 0}, {s, 0, 0}, {0.95f * s, 0.8f * s, 0}}});
    size *= std::sqrt(1.3 / left);
  }
  const Shape shape = check(scene, build_bvh(scene), all_triangles(scene));
  EXPECT_EQ(shape.depth, 41u);
}

struct Ray {
  std::array<double, 3> origin, direction;
};

// Moeller and Trumbore 1997, in double precision: the distance, or nothing.
std::optional<double> intersect(const Scene& scene, std::uint32_t triangle, const Ray& ray) {
  using V = std::array<double, 3>;
  const auto minus = [](const V& a, const V& b) { return V{a[0] - b[0], a[1] - b[1], a[2] - b[2]}; };
  const auto cross = [](const V& a, const V& b) {
    return V{a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
  };
  const auto dot = [](const V& a, const V& b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; };
  V p[3];
  for (int c = 0; c < 3; ++c) std::copy_n(corner_of(scene, triangle, c), 3, p[c].begin());
  const V e1 = minus(p[1], p[0]), e2 = minus(p[2], p[0]), n = cross(ray.direction, e2), s = minus(ray.origin, p[0]);
  const double determinant = dot(e1, n);
  const double u = dot(s, n) / determinant;
  if (!(u >= 0 && u <= 1)) return {};
  const V q = cross(s, e1);
  const double v = dot(ray.direction, q) / determinant;
  if (!(v >= 0 && u + v <= 1)) return {};
  const double t = dot(e2, q) / determinant;
  if (!(t > 0)) return {};
  return t;
}

bool meets(const Box& box, const Ray& ray) {
  double near = 0, far = std::numeric_limits<double>::infinity();
  for (int k = 0; k < 3; ++k) {
    double a = (box.lower[k] - ray.origin[k]) / ray.direction[k], b = (box.upper[k] - ray.origin[k]) / ray.direction[k];
    if (a > b) std::swap(a, b);
    near = std::max(near, a);
    far = std::min(far, b * (1 + 1e-12));  // double's own rounding
  }
  return near <= far;
}

double nearest(const Scene& scene, const Bvh& bvh, const Ray& ray) {
  double best = std::numeric_limits<double>::infinity();
  std::vector<std::uint32_t> stack{0};
  while (!stack.empty()) {
    const BvhNode& node = bvh.nodes[stack.back()];
    stack.pop_back();
    for (int side = 0; side < 2; ++side) {
      const auto leaf = leaf_of(node.child[side]);
      if (!meets(child_box(node, side), ray)) continue;
      if (!leaf) {
        stack.push_back(node.child[side]);
        EXPECT_LE(stack.size(), bvh.max_depth) << "a stack of max_depth entries overflows";
        continue;
      }
      for (std::uint32_t slot = leaf->first; slot < leaf->first + leaf->count; ++slot)
        if (const auto t = intersect(scene, bvh.triangles[slot], ray)) best = std::min(best, *t);
    }
  }
  return best;
}

TEST(Bvh, FindsWhatBruteForceFinds) {
  for (const char* name : {"cornell-box", "comb", "many-lights", "needles"}) {
    SCOPED_TRACE(name);
    const Scene scene = make_scene(name);
    const Bvh bvh = build_bvh(scene);
    const Bounds bounds = bounds_of(scene);
    std::mt19937 random(5);
    std::uniform_real_distribution<double> unit(0, 1);
    int hits = 0;
    for (int i = 0; i < 2000; ++i) {
      Ray ray;
      for (int k = 0; k < 3; ++k) {
        ray.origin[k] = bounds.lower[k] + (bounds.upper[k] - bounds.lower[k]) * unit(random);
        ray.direction[k] = 2 * unit(random) - 1;
      }
      double expected = std::numeric_limits<double>::infinity();
      for (std::uint32_t triangle = 0; triangle < scene.triangle_count(); ++triangle)
        if (const auto t = intersect(scene, triangle, ray)) expected = std::min(expected, *t);
      EXPECT_EQ(nearest(scene, bvh, ray), expected) << "ray " << i;
      hits += std::isfinite(expected);
    }
    EXPECT_GT(hits, 200) << "too few rays hit anything to prove anything";
  }
}

TEST(Bvh, SurvivesItsBlob) {
  for (const char* name : {"cornell-box", "comb"}) {
    const Scene scene = make_scene(name);
    const Bytes bytes = serialize(build_bvh(scene));
    const Bvh read = parse_bvh(bytes, scene.triangle_count(), name);
    check(scene, read, all_triangles(scene));
    EXPECT_TRUE(serialize(read) == bytes);
  }
  const Bytes empty = serialize(build_bvh(Scene{}));
  EXPECT_EQ(parse_bvh(empty, 0, "empty").nodes.size(), 1u);
}

}  // namespace
}  // namespace gleaner::scene

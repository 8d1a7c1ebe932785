#include "scene/model/tree.h"

#include <algorithm>
#include <bit>

#include "scene/model/limits.h"

namespace gleaner::scene {
namespace {

constexpr int kBins = 16;
// Below so many levels of SAH splits boxes are halved by number, which takes at most 27 more.
constexpr std::uint32_t kSahLevels = kMaxBvhDepth - 28;

class Builder {
 public:
  Builder(std::span<const TreeBox> boxes, std::uint32_t most) : boxes_(boxes), most_(most) {
    tree_.slots.resize(boxes.size());
    for (std::uint32_t i = 0; i < boxes.size(); ++i) tree_.slots[i] = i;
    tree_.nodes.reserve(boxes.size() + 1);
  }

  Tree build() {
    const std::size_t count = boxes_.size();
    tree_.nodes.push_back(empty_node());
    tree_.depth = 1;
    if (count == 0) return std::move(tree_);
    if (count == 1) {
      const Child all = subtree(0, 1, 1);
      set_child(tree_.nodes[0], 0, all);
      return std::move(tree_);
    }
    const std::size_t middle = split(0, count, 0);
    // Subtrees add nodes, so that the root's place is taken after them.
    const Child lower = subtree(0, middle, 1), upper = subtree(middle, count, 1);
    set_child(tree_.nodes[0], 0, lower);
    set_child(tree_.nodes[0], 1, upper);
    return std::move(tree_);
  }

 private:
  using Child = TreeChild;
  struct Bin {
    TreeBox box;
    std::size_t count = 0;
  };

  // Of slots [first, end), `depth` edges below the root.
  Child subtree(std::size_t first, std::size_t end, std::uint32_t depth) {
    if (end - first <= most_) return leaf(first, end, depth);
    const std::size_t index = tree_.nodes.size();
    tree_.nodes.push_back(empty_node());
    const std::size_t middle = split(first, end, depth);
    Child here{static_cast<std::uint32_t>(index), {}};
    int side = 0;
    for (const Child& child : {subtree(first, middle, depth + 1), subtree(middle, end, depth + 1)}) {
      set_child(tree_.nodes[index], side++, child);
      here.box.extend(child.box);
    }
    return here;
  }

  Child leaf(std::size_t first, std::size_t end, std::uint32_t depth) {
    std::sort(tree_.slots.begin() + static_cast<std::ptrdiff_t>(first),
              tree_.slots.begin() + static_cast<std::ptrdiff_t>(end));
    Child child{GLEANER_BVH_LEAF | static_cast<std::uint32_t>(end - first) << 27 | static_cast<std::uint32_t>(first),
                {}};
    for (std::size_t i = first; i < end; ++i) child.box.extend(boxes_[tree_.slots[i]]);
    tree_.depth = std::max(tree_.depth, depth);
    return child;
  }

  float centre(std::uint32_t box, int axis) const {
    return 0.5f * boxes_[box].lower[axis] + 0.5f * boxes_[box].upper[axis];
  }

  // Sorts slots [first, end), at least two, into two parts, neither of them empty; gives where the second begins.
  std::size_t split(std::size_t first, std::size_t end, std::uint32_t depth) {
    TreeBox centres;
    for (std::size_t i = first; i < end; ++i) {
      const std::uint32_t box = tree_.slots[i];
      const std::array<float, 3> point{centre(box, 0), centre(box, 1), centre(box, 2)};
      centres.extend(point.data());
    }
    std::size_t middle = first;
    if (depth < kSahLevels) middle = split_by_area(first, end, centres);
    if (middle == first || middle == end) middle = halve(first, end, centres);
    return middle;
  }

  // The bin of a centre; `scale`: bins a metre.
  static int bin_of(float centre, float lower, float scale) {
    return std::clamp(static_cast<int>((centre - lower) * scale), 0, kBins - 1);
  }

  std::size_t split_by_area(std::size_t first, std::size_t end, const TreeBox& centres) {
    double least = DBL_MAX;
    int best_axis = -1, best_bin = 0;
    for (int axis = 0; axis < 3; ++axis) {
      const float extent = centres.upper[axis] - centres.lower[axis];
      if (!(extent > 0)) continue;
      const float scale = kBins / extent;
      std::array<Bin, kBins> bins;
      for (std::size_t i = first; i < end; ++i) {
        const std::uint32_t box = tree_.slots[i];
        Bin& bin = bins[bin_of(centre(box, axis), centres.lower[axis], scale)];
        bin.box.extend(boxes_[box]);
        ++bin.count;
      }
      std::array<double, kBins> above{};  // cost of bins k and up
      TreeBox box;
      std::size_t count = 0;
      for (int k = kBins - 1; k > 0; --k) {
        box.extend(bins[k].box);
        count += bins[k].count;
        above[k] = box.half_area() * static_cast<double>(count);
      }
      box = {};
      count = 0;
      for (int k = 0; k + 1 < kBins; ++k) {
        box.extend(bins[k].box);
        count += bins[k].count;
        const double cost = box.half_area() * static_cast<double>(count) + above[k + 1];
        if (count == 0 || count == end - first || !(cost < least)) continue;
        least = cost, best_axis = axis, best_bin = k;
      }
    }
    if (best_axis < 0) return first;
    const float lower = centres.lower[best_axis], scale = kBins / (centres.upper[best_axis] - lower);
    const auto begin = tree_.slots.begin();
    return static_cast<std::size_t>(
        std::partition(begin + static_cast<std::ptrdiff_t>(first), begin + static_cast<std::ptrdiff_t>(end),
                       [&](std::uint32_t box) { return bin_of(centre(box, best_axis), lower, scale) <= best_bin; }) -
        begin);
  }

  // At the median along the longest axis.
  std::size_t halve(std::size_t first, std::size_t end, const TreeBox& centres) {
    int axis = 0;
    for (int k = 1; k < 3; ++k)
      if (centres.upper[k] - centres.lower[k] > centres.upper[axis] - centres.lower[axis]) axis = k;
    const std::size_t middle = first + (end - first) / 2;
    const auto begin = tree_.slots.begin();
    std::nth_element(begin + static_cast<std::ptrdiff_t>(first), begin + static_cast<std::ptrdiff_t>(middle),
                     begin + static_cast<std::ptrdiff_t>(end), [&](std::uint32_t a, std::uint32_t b) {
                       return std::pair(centre(a, axis), a) < std::pair(centre(b, axis), b);
                     });
    return middle;
  }

  std::span<const TreeBox> boxes_;
  std::size_t most_;
  Tree tree_;
};

}  // namespace

BvhNode empty_node() {
  BvhNode node{};
  const TreeBox nothing;
  for (int side = 0; side < 2; ++side) set_child(node, side, {GLEANER_BVH_LEAF, nothing});
  return node;
}

void set_child(BvhNode& parent, int side, const TreeChild& child) {
  parent.child[side] = child.reference;
  std::copy(child.box.lower.begin(), child.box.lower.end(), side == 0 ? parent.lower0 : parent.lower1);
  std::copy(child.box.upper.begin(), child.box.upper.end(), side == 0 ? parent.upper0 : parent.upper1);
}

double TreeBox::half_area() const {
  double side[3];
  for (int c = 0; c < 3; ++c) side[c] = double{upper[c]} - lower[c];
  if (!(side[0] >= 0 && side[1] >= 0 && side[2] >= 0)) return 0;
  return side[0] * side[1] + side[1] * side[2] + side[2] * side[0];
}

Tree build_tree(std::span<const TreeBox> boxes, std::uint32_t most) { return Builder(boxes, most).build(); }

double sah_cost(std::span<const BvhNode> nodes) {
  double cost = 0, all = 0;
  for (std::size_t i = 0; i < nodes.size(); ++i) {
    TreeBox box[2];
    for (int c = 0; c < 3; ++c) {
      box[0].lower[c] = nodes[i].lower0[c], box[0].upper[c] = nodes[i].upper0[c];
      box[1].lower[c] = nodes[i].lower1[c], box[1].upper[c] = nodes[i].upper1[c];
    }
    for (int side = 0; side < 2; ++side) {
      const std::uint32_t child = nodes[i].child[side];
      cost += box[side].half_area() * (child & GLEANER_BVH_LEAF ? child >> 27 & 15u : 1u);
    }
    if (i == 0) {
      box[0].extend(box[1]);
      all = box[0].half_area();
    }
  }
  return all > 0 ? 1 + cost / all : 1;
}

}  // namespace gleaner::scene

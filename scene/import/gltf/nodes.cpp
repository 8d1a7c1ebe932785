#include "scene/import/gltf/nodes.h"

#include <algorithm>

namespace gleaner::scene::gltf {
namespace {

constexpr std::size_t kNone = ~std::size_t{0};
constexpr double kMost = 1e30;  // of a transform's numbers

// What exporters' rounding leaves in a last row of 0 0 0 1.
constexpr double kAffineTolerance = 1e-3;

Matrix matrix_of(const Element& matrix, Warnings& warnings) {
  const std::vector<double> numbers = matrix.numbers(16, -kMost, kMost);
  Matrix m;
  std::copy(numbers.begin(), numbers.end(), m.begin());
  double error = std::abs(m[15] - 1);
  for (const int i : {3, 7, 11}) error = std::max(error, std::abs(m[i]));
  if (error > kAffineTolerance) matrix.fail("an affine matrix (last row 0 0 0 1)", "another");
  if (error > 0) warnings.add(matrix.name(), "the last row is almost 0 0 0 1 and was taken so");
  m[3] = m[7] = m[11] = 0;
  m[15] = 1;
  return m;
}

template <std::size_t N>
void read_vector(const Element& node, const char* key, double (&to)[N]) {
  const auto value = node.find(key);
  if (!value) return;
  const std::vector<double> numbers = value->numbers(N, -kMost, kMost);
  std::copy(numbers.begin(), numbers.end(), to);
}

}  // namespace

Matrix composed(const double t[3], const double r[4], const double s[3]) {
  const double length = std::sqrt(r[0] * r[0] + r[1] * r[1] + r[2] * r[2] + r[3] * r[3]);
  const double x = r[0] / length, y = r[1] / length, z = r[2] / length, w = r[3] / length;
  return {s[0] * (1 - 2 * (y * y + z * z)),
          s[0] * 2 * (x * y + z * w),
          s[0] * 2 * (x * z - y * w),
          0,
          s[1] * 2 * (x * y - z * w),
          s[1] * (1 - 2 * (x * x + z * z)),
          s[1] * 2 * (y * z + x * w),
          0,
          s[2] * 2 * (x * z + y * w),
          s[2] * 2 * (y * z - x * w),
          s[2] * (1 - 2 * (x * x + y * y)),
          0,
          t[0],
          t[1],
          t[2],
          1};
}

Nodes::Nodes(const Document& document, Warnings& warnings) : document_(document), warnings_(warnings) {
  const std::size_t count = document_.size("nodes");
  to_world_.resize(count);
  has_world_.resize(count);
  find_parents();
  walk();
}

Matrix Nodes::local(std::size_t index) const {
  const Element element = node(index);
  if (const auto matrix = element.find("matrix")) return matrix_of(*matrix, warnings_);
  double r[4] = {0, 0, 0, 1}, s[3] = {1, 1, 1}, t[3] = {0, 0, 0};
  read_vector(element, "rotation", r);
  read_vector(element, "scale", s);
  read_vector(element, "translation", t);
  const double squared = r[0] * r[0] + r[1] * r[1] + r[2] * r[2] + r[3] * r[3];
  if (!(squared > 0 && std::isfinite(squared))) element.at("rotation").fail("a unit quaternion");
  return composed(t, r, s);
}

void Nodes::find_parents() {
  const std::size_t count = document_.size("nodes");
  parent_.assign(count, kNone);
  for (std::size_t i = 0; i < count; ++i) {
    const auto children = node(i).find("children");
    for (std::size_t c = 0; children && c < children->size(); ++c) {
      const std::size_t child = (*children)[c].index(count);
      if (parent_[child] != kNone || child == i) node(child).fail("a node with one parent", "a second way to it");
      parent_[child] = i;
    }
  }
}

std::vector<std::size_t> Nodes::roots() const {
  const Element root = document_.root();
  const std::size_t count = document_.size("nodes");
  std::vector<std::size_t> roots;
  if (document_.size("scenes") > 0) {
    const auto chosen = root.find("scene");
    const Element scene = chosen ? document_.item("scenes", *chosen) : document_.item("scenes", std::size_t{0});
    const auto nodes = scene.find("nodes");
    for (std::size_t i = 0; nodes && i < nodes->size(); ++i) roots.push_back((*nodes)[i].index(count));
    return roots;
  }
  for (std::size_t i = 0; i < count; ++i)
    if (parent_[i] == kNone) roots.push_back(i);
  return roots;
}

void Nodes::walk() {
  const std::size_t count = document_.size("nodes");
  std::vector<bool> visited(count);
  std::vector<std::size_t> open = roots();
  std::reverse(open.begin(), open.end());
  while (!open.empty()) {
    const std::size_t index = open.back();
    open.pop_back();
    // A cycle, too, comes by a node a second time.
    if (visited[index]) node(index).fail("a node with one parent", "a second way to it");
    visited[index] = true;
    in_scene_.push_back(index);
    if (const auto children = node(index).find("children"))
      for (std::size_t c = children->size(); c-- > 0;) open.push_back((*children)[c].index(count));
  }
}

std::optional<std::size_t> Nodes::parent(std::size_t index) const {
  return parent_[index] == kNone ? std::nullopt : std::optional(parent_[index]);
}

const Matrix& Nodes::to_world(std::size_t index) {
  // Up to the first ancestor whose matrix is known, then down again.
  std::vector<std::size_t> path;
  for (std::size_t i = index; i != kNone && !has_world_[i]; i = parent_[i]) {
    if (path.size() > parent_.size()) node(index).fail("a node with one parent", "itself among its ancestors");
    path.push_back(i);
  }
  for (; !path.empty(); path.pop_back()) {
    const std::size_t i = path.back();
    const Matrix mine = local(i);
    to_world_[i] = product(parent_[i] == kNone ? kIdentity : to_world_[parent_[i]], mine);
    if (!is_finite(to_world_[i])) node(i).fail("a finite transform", "an overflow");
    has_world_[i] = true;
  }
  return to_world_[index];
}

}  // namespace gleaner::scene::gltf

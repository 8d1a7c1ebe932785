#include "scene/import/polygon.h"

#include <cmath>
#include <cstddef>
#include <numeric>

namespace gleaner::scene {
namespace {

// Ear clipping takes time with the square of the number of corners; a larger polygon becomes a fan.
constexpr std::size_t kMaxClipped = 2048;

using Point = std::array<double, 2>;

// Twice the signed area of a, b, c.
double turn(const Point& a, const Point& b, const Point& c) {
  return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
}

// The polygon seen against its (Newell) normal, along the axis that changes it least; counter-clockwise.
std::vector<Point> flattened(const std::vector<std::array<double, 3>>& points) {
  std::array<double, 3> normal{};
  for (std::size_t i = 0; i < points.size(); ++i) {
    const auto &p = points[i], &q = points[(i + 1) % points.size()];
    for (int c = 0; c < 3; ++c) {
      const int u = (c + 1) % 3, v = (c + 2) % 3;
      normal[c] += (p[u] - q[u]) * (p[v] + q[v]);
    }
  }
  int axis = 0;
  for (int c = 1; c < 3; ++c)
    if (std::abs(normal[c]) > std::abs(normal[axis])) axis = c;
  std::vector<Point> flat;
  for (const auto& p : points) {
    Point q{p[(axis + 1) % 3], p[(axis + 2) % 3]};
    if (normal[axis] < 0) q[0] = -q[0];
    flat.push_back(q);
  }
  return flat;
}

}  // namespace

std::vector<std::array<std::uint32_t, 3>> triangulated(const std::vector<std::array<double, 3>>& points) {
  const std::size_t count = points.size();
  std::vector<std::array<std::uint32_t, 3>> triangles;
  const std::vector<Point> flat = count > 3 && count <= kMaxClipped ? flattened(points) : std::vector<Point>();
  bool is_convex = true;
  for (std::size_t i = 0; i < flat.size() && is_convex; ++i)
    is_convex = turn(flat[i], flat[(i + 1) % count], flat[(i + 2) % count]) >= 0;
  if (is_convex) {
    for (std::uint32_t i = 1; i + 1 < count; ++i) triangles.push_back({0, i, i + 1});
    return triangles;
  }
  std::vector<std::uint32_t> left(count);
  std::iota(left.begin(), left.end(), 0u);
  std::size_t next = 0;
  while (left.size() > 3) {
    const std::size_t n = left.size();
    std::size_t ear = n;
    for (std::size_t tried = 0; tried < n && ear == n; ++tried) {
      const std::size_t at = (next + tried) % n, before = (at + n - 1) % n, after = (at + 1) % n;
      const Point &a = flat[left[before]], &b = flat[left[at]], &c = flat[left[after]];
      if (!(turn(a, b, c) > 0)) continue;
      bool is_empty = true;
      for (std::size_t k = 0; k < n && is_empty; ++k) {
        if (k == before || k == at || k == after) continue;
        const Point& p = flat[left[k]];
        const bool is_corner = p == a || p == b || p == c;
        is_empty = is_corner || turn(a, b, p) < 0 || turn(b, c, p) < 0 || turn(c, a, p) < 0;
      }
      if (is_empty) ear = at;
    }
    // A polygon that crosses itself may have none: any corner will do.
    if (ear == n) ear = next % n;
    triangles.push_back({left[(ear + n - 1) % n], left[ear], left[(ear + 1) % n]});
    left.erase(left.begin() + static_cast<std::ptrdiff_t>(ear));
    next = ear == 0 ? left.size() - 1 : ear - 1;
  }
  triangles.push_back({left[0], left[1], left[2]});
  return triangles;
}

}  // namespace gleaner::scene

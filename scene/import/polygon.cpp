// A convex polygon becomes a fan, a small one is clipped ear by ear. A large one is cut into monotone pieces by a sweep
// (de Berg et al., Computational Geometry, 3.2), and those into triangles (3.3): n log n, whatever its shape.
//
// The triangulating libraries of Debian 12 that a permissive licence allows take time with the square of the corners on
// some outlines: 10^5 corners of a star keep GLU's tessellator, GEOS and earcut busy for 14 s and more.

#include "scene/import/polygon.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <numeric>
#include <set>

namespace gleaner::scene {
namespace {

using Point = std::array<double, 2>;
using Outline = std::vector<Point>;

// Ear clipping takes time with the square of the corners: it is for the small ones, and for those that touch
// themselves.
constexpr std::size_t kSmall = 32;
constexpr std::size_t kMaxClipped = 2048;

// Twice the signed area of a, b, c; positive where they turn to the left. Differences of coordinates from a file fit
// into 64 bits, so that the sign is right.
long double turn(const Point& a, const Point& b, const Point& c) {
  return (static_cast<long double>(b[0]) - a[0]) * (static_cast<long double>(c[1]) - a[1]) -
         (static_cast<long double>(b[1]) - a[1]) * (static_cast<long double>(c[0]) - a[0]);
}

// The polygon seen against its (Newell) normal, along the axis that changes it least; counter-clockwise.
Outline flattened(const std::vector<std::array<double, 3>>& points) {
  std::array<double, 3> normal{};
  const auto& origin = points[0];
  for (std::size_t i = 0; i < points.size(); ++i) {
    const auto &p = points[i], &q = points[(i + 1) % points.size()];
    for (int c = 0; c < 3; ++c) {
      const int u = (c + 1) % 3, v = (c + 2) % 3;
      normal[c] += (p[u] - q[u]) * ((p[v] - origin[v]) + (q[v] - origin[v]));
    }
  }
  int axis = 0;
  for (int c = 1; c < 3; ++c)
    if (std::abs(normal[c]) > std::abs(normal[axis])) axis = c;
  Outline flat;
  flat.reserve(points.size());
  for (const auto& p : points) {
    const int u = (axis + 1) % 3, v = (axis + 2) % 3;
    Point q{p[u] - origin[u], p[v] - origin[v]};
    if (normal[axis] < 0) q[0] = -q[0];
    flat.push_back(q);
  }
  return flat;
}

long double doubled_area(const Outline& flat) {
  long double sum = 0;
  for (std::size_t i = 0; i < flat.size(); ++i) {
    const Point &a = flat[i], &b = flat[(i + 1) % flat.size()];
    sum += static_cast<long double>(a[0]) * b[1] - static_cast<long double>(a[1]) * b[0];
  }
  return sum;
}

// Whether the triangles have the outline's area: then they neither overlap nor stick out.
bool covers(const Triangles& triangles, const Outline& flat) {
  constexpr long double tolerance = 1e-6L;
  long double sum = 0;
  for (const auto& t : triangles) sum += std::abs(turn(flat[t[0]], flat[t[1]], flat[t[2]]));
  const long double area = doubled_area(flat);
  return std::abs(sum - area) <= tolerance * std::abs(area);
}

bool is_convex(const Outline& flat) {
  const std::size_t count = flat.size();
  std::size_t turns = 0;  // of the direction's sign in x: a convex outline has two
  for (std::size_t i = 0; i < count; ++i) {
    const Point &a = flat[i], &b = flat[(i + 1) % count], &c = flat[(i + 2) % count];
    if (turn(a, b, c) < 0) return false;
    if ((b[0] >= a[0]) != (c[0] >= b[0])) ++turns;
  }
  return turns <= 2;
}

Triangles fan(std::size_t count) {
  Triangles triangles;
  for (std::uint32_t i = 1; i + 1 < count; ++i) triangles.push_back({0, i, i + 1});
  return triangles;
}

Triangles clipped(const Outline& flat) {
  Triangles triangles;
  std::vector<std::uint32_t> left(flat.size());
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

// Cuts a counter-clockwise outline into pieces that a vertical line meets at most twice, sweeping from left to right.
// Corners are linked nodes; a cut doubles its two ends.
class Sweep {
 public:
  explicit Sweep(const Outline& flat) : flat_(flat), helper_(flat.size()), below_(Above{this}) {
    const auto count = static_cast<std::uint32_t>(flat.size());
    for (std::uint32_t i = 0; i < count; ++i) nodes_.push_back({i, (i + count - 1) % count, (i + 1) % count, kNone});
    place_.resize(count);
    in_status_.resize(count);
    std::vector<std::uint32_t> order(count);
    std::iota(order.begin(), order.end(), 0u);
    std::sort(order.begin(), order.end(), [&](auto a, auto b) { return before(a, b); });
    for (const std::uint32_t v : order) visit(v);
  }

  Triangles triangles() {
    Triangles all;
    std::vector<bool> done(nodes_.size());
    for (std::uint32_t first = 0; first < nodes_.size(); ++first) {
      if (done[first]) continue;
      std::vector<std::uint32_t> piece;
      for (std::uint32_t n = first; !done[n]; n = nodes_[n].next) {
        done[n] = true;
        piece.push_back(nodes_[n].corner);
      }
      add_monotone(piece, all);
    }
    return all;
  }

 private:
  static constexpr std::uint32_t kNone = ~0u;

  struct Node {
    std::uint32_t corner, previous, next;
    std::uint32_t twin;  // another node of the same corner
  };

  std::uint32_t after(std::uint32_t v) const { return v + 1 == flat_.size() ? 0 : v + 1; }
  std::uint32_t ahead_of(std::uint32_t v) const { return (v == 0 ? static_cast<std::uint32_t>(flat_.size()) : v) - 1; }

  bool before(std::uint32_t a, std::uint32_t b) const {
    if (flat_[a] != flat_[b]) return flat_[a] < flat_[b];
    return a < b;
  }

  // Edges are named by their first corner; those in the status lead to the right, with the inside above them.
  bool is_above(std::uint32_t edge, std::uint32_t v) const {
    return turn(flat_[edge], flat_[after(edge)], flat_[v]) > 0;
  }

  struct Above {
    const Sweep* sweep;
    bool operator()(std::uint32_t a, std::uint32_t b) const {
      if (a == b) return false;
      const auto& p = sweep->flat_;
      const std::uint32_t a2 = sweep->after(a), b2 = sweep->after(b);
      // The edge that begins later is seen from the other.
      if (sweep->before(a, b)) {
        long double side = turn(p[a], p[a2], p[b]);
        if (side == 0) side = turn(p[a], p[a2], p[b2]);
        return side != 0 ? side > 0 : a < b;
      }
      long double side = turn(p[b], p[b2], p[a]);
      if (side == 0) side = turn(p[b], p[b2], p[a2]);
      return side != 0 ? side < 0 : a < b;
    }
  };

  // The status edge right below a corner, or kNone.
  std::uint32_t edge_below(std::uint32_t v) const {
    // The corner's own edge says where in the order it lies; edges through the corner itself are passed over.
    for (auto low = below_.upper_bound(v); low != below_.begin();)
      if (--low; is_above(*low, v)) return *low;
    return kNone;
  }

  void insert(std::uint32_t edge) {
    place_[edge] = below_.insert(edge).first;
    in_status_[edge] = true;
    helper_[edge] = {edge, false};
  }

  void remove(std::uint32_t edge) {
    if (in_status_[edge]) below_.erase(place_[edge]);
    in_status_[edge] = false;
  }

  void cut_to_merge(std::uint32_t v, std::uint32_t edge) {
    if (edge != kNone && helper_[edge].is_merge) cut(v, helper_[edge].corner);
  }

  void visit(std::uint32_t v) {
    const std::uint32_t previous = ahead_of(v), next = after(v);
    const bool from_left = before(previous, v), to_right = before(v, next);
    const bool is_convex_corner = turn(flat_[previous], flat_[v], flat_[next]) > 0;
    if (!from_left && to_right) {  // both neighbours to the right
      if (!is_convex_corner) {
        const std::uint32_t edge = edge_below(v);
        if (edge != kNone) {
          cut(v, helper_[edge].corner);
          helper_[edge] = {v, false};
        }
      }
      insert(v);
    } else if (from_left && !to_right) {  // both to the left
      cut_to_merge(v, previous);
      remove(previous);
      if (!is_convex_corner) {
        const std::uint32_t edge = edge_below(v);
        cut_to_merge(v, edge);
        if (edge != kNone) helper_[edge] = {v, true};
      }
    } else if (from_left) {  // on the lower side
      cut_to_merge(v, previous);
      remove(previous);
      insert(v);
    } else {  // on the upper side
      const std::uint32_t edge = edge_below(v);
      cut_to_merge(v, edge);
      if (edge != kNone) helper_[edge] = {v, false};
    }
  }

  // Whether the direction to `target` lies inside the corner at a node.
  bool faces(const Node& node, const Point& target) const {
    const Point &p = flat_[node.corner], &a = flat_[nodes_[node.previous].corner], &b = flat_[nodes_[node.next].corner];
    if (turn(a, p, b) >= 0) return turn(p, b, target) >= 0 && turn(p, target, a) >= 0;
    return !(turn(p, a, target) > 0 && turn(p, target, b) > 0);
  }

  std::uint32_t node_facing(std::uint32_t corner, std::uint32_t target) const {
    for (std::uint32_t n = corner; n != kNone; n = nodes_[n].twin)
      if (faces(nodes_[n], flat_[target])) return n;
    return corner;
  }

  void cut(std::uint32_t v, std::uint32_t w) {
    if (v == w) return;
    const std::uint32_t a = node_facing(v, w), b = node_facing(w, v);
    const auto a2 = static_cast<std::uint32_t>(nodes_.size()), b2 = a2 + 1;
    // a and b close one piece, their doubles the other.
    nodes_.push_back({v, nodes_[a].previous, b, nodes_[a].twin});
    nodes_.push_back({w, nodes_[b].previous, a, nodes_[b].twin});
    nodes_[nodes_[a].previous].next = a2;
    nodes_[nodes_[b].previous].next = b2;
    nodes_[a].previous = b2;
    nodes_[b].previous = a2;
    nodes_[a].twin = a2;
    nodes_[b].twin = b2;
  }

  void add(std::uint32_t a, std::uint32_t b, std::uint32_t c, Triangles& all) const {
    if (turn(flat_[a], flat_[b], flat_[c]) < 0) std::swap(b, c);
    all.push_back({a, b, c});
  }

  void add_monotone(const std::vector<std::uint32_t>& piece, Triangles& all) const {
    if (piece.size() < 3) return;
    struct Corner {
      std::uint32_t number;
      bool is_lower;
    };
    // The lower chain runs from the leftmost corner to the rightmost, the upper one back.
    std::vector<Corner> order;
    std::size_t leftmost = 0, rightmost = 0;
    for (std::size_t i = 1; i < piece.size(); ++i) {
      if (before(piece[i], piece[leftmost])) leftmost = i;
      if (before(piece[rightmost], piece[i])) rightmost = i;
    }
    for (std::size_t i = leftmost; i != rightmost; i = (i + 1) % piece.size()) order.push_back({piece[i], true});
    for (std::size_t i = rightmost; i != leftmost; i = (i + 1) % piece.size()) order.push_back({piece[i], false});
    std::sort(order.begin(), order.end(), [&](const auto& a, const auto& b) { return before(a.number, b.number); });
    std::vector<Corner> stack = {order[0], order[1]};
    for (std::size_t j = 2; j < order.size(); ++j) {
      const Corner& corner = order[j];
      if (corner.is_lower != stack.back().is_lower || j + 1 == order.size()) {
        for (std::size_t k = 0; k + 1 < stack.size(); ++k)
          add(corner.number, stack[k].number, stack[k + 1].number, all);
        const Corner last = stack.back();
        stack = {last, corner};
        continue;
      }
      Corner last = stack.back();
      stack.pop_back();
      while (!stack.empty()) {
        const long double side = turn(flat_[stack.back().number], flat_[last.number], flat_[corner.number]);
        if (!(corner.is_lower ? side > 0 : side < 0)) break;
        add(corner.number, last.number, stack.back().number, all);
        last = stack.back();
        stack.pop_back();
      }
      stack.push_back(last);
      stack.push_back(corner);
    }
  }

  struct Helper {
    std::uint32_t corner = 0;
    bool is_merge = false;
  };

  const Outline& flat_;
  std::vector<Node> nodes_;
  std::vector<Helper> helper_;  // of edges in the status
  std::set<std::uint32_t, Above> below_;
  std::vector<std::set<std::uint32_t, Above>::iterator> place_;
  std::vector<bool> in_status_;
};

// The corners of an outline without spikes: corners from which it goes back the way it came, which enclose nothing.
std::vector<std::uint32_t> without_spikes(const Outline& flat) {
  std::vector<std::uint32_t> kept;
  const auto is_spike = [&](std::uint32_t before, std::uint32_t at, std::uint32_t after) {
    const Point &a = flat[before], &b = flat[at], &c = flat[after];
    const double back = (b[0] - a[0]) * (c[0] - b[0]) + (b[1] - a[1]) * (c[1] - b[1]);
    return b == c || (turn(a, b, c) == 0 && back < 0);
  };
  for (std::uint32_t v = 0; v < flat.size(); ++v) {
    while (kept.size() >= 2 && is_spike(kept[kept.size() - 2], kept.back(), v)) kept.pop_back();
    kept.push_back(v);
  }
  // Where the outline closes.
  std::size_t first = 0;
  for (bool changed = true; changed && kept.size() - first > 3;) {
    changed = false;
    const std::size_t n = kept.size();
    if (is_spike(kept[n - 2], kept[n - 1], kept[first])) {
      kept.pop_back();
      changed = true;
    } else if (is_spike(kept[n - 1], kept[first], kept[first + 1])) {
      ++first;
      changed = true;
    }
  }
  kept.erase(kept.begin(), kept.begin() + static_cast<std::ptrdiff_t>(first));
  return kept;
}

// An outline without area that is no line either runs around as much to the right as to the left: a figure of eight.
bool is_balanced(const std::vector<std::array<double, 3>>& points, const Outline& flat) {
  if (doubled_area(flat) != 0) return false;
  for (int u = 0; u < 3; ++u) {
    const int v = (u + 1) % 3;
    const auto at = [&](std::size_t i) { return Point{points[i][u], points[i][v]}; };
    for (std::size_t i = 2; i < points.size(); ++i)
      if (turn(at(0), at(i - 1), at(i)) != 0) return true;
  }
  return false;
}

Triangles cut_up(const Outline& flat) {
  Triangles triangles;
  if (flat.size() > kSmall) {
    triangles = Sweep(flat).triangles();
    if (covers(triangles, flat)) return triangles;
  }
  return flat.size() <= kMaxClipped ? clipped(flat) : triangles;
}

}  // namespace

Triangles triangulated(const std::vector<std::array<double, 3>>& points, bool& is_simple) {
  is_simple = true;
  if (points.size() <= 3) return fan(points.size());
  const Outline flat = flattened(points);
  is_simple = !is_balanced(points, flat);
  if (is_convex(flat)) return fan(points.size());
  Triangles triangles = cut_up(flat);
  if (covers(triangles, flat)) return triangles;
  const std::vector<std::uint32_t> kept = without_spikes(flat);
  if (kept.size() < flat.size() && kept.size() >= 3) {
    Outline smooth;
    for (const std::uint32_t v : kept) smooth.push_back(flat[v]);
    Triangles fewer = is_convex(smooth) ? fan(smooth.size()) : cut_up(smooth);
    for (auto& t : fewer)
      for (auto& corner : t) corner = kept[corner];
    if (covers(fewer, flat)) return fewer;
  }
  is_simple = false;
  return triangles;
}

}  // namespace gleaner::scene

#include "worker/stages/links/hanging.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <tuple>
#include <unordered_map>
#include <unordered_set>

#include "worker/stages/links/geometry.h"
#include "worker/wavefront/wanted.h"

namespace gleaner::worker {
namespace {

// The lowest level of the triangles at an edge, by its ends.
class EdgeLevels {
 public:
  EdgeLevels(const TriangleRows& triangles, const std::vector<std::uint32_t>& levels) {
    for (std::uint64_t t = 0; t < triangles.count; ++t)
      for (unsigned k = 0; k < 3; ++k) {
        Found& found =
            levels_.try_emplace(key(triangles.rows + t * triangles.words, k), Found{levels[t], 0}).first->second;
        found = {std::min(found.level, levels[t]), found.triangles + 1};
      }
  }
  // Of the edge from corner k to the next one.
  std::uint32_t at(const float* row, unsigned k) const { return found(row, k).level; }
  bool is_shared(const float* row, unsigned k) const { return found(row, k).triangles > 1; }

 private:
  using Key = std::array<float, 6>;
  static Key key(const float* row, unsigned k) {
    const float *a = row + TRIANGLE_P0 + 3 * k, *b = row + TRIANGLE_P0 + 3 * ((k + 1) % 3);
    if (std::lexicographical_compare(b, b + 3, a, a + 3)) std::swap(a, b);
    return {a[0] + 0.0f, a[1] + 0.0f, a[2] + 0.0f, b[0] + 0.0f, b[1] + 0.0f, b[2] + 0.0f};
  }
  struct Found {
    std::uint32_t level, triangles;
  };
  const Found& found(const float* row, unsigned k) const { return levels_.at(key(row, k)); }
  std::unordered_map<Key, Found, WordsHash> levels_;
};

// Node m of edge k of a triangle that is divided by n, among the triangle's.
std::uint32_t edge_node(unsigned k, std::uint32_t m, std::uint32_t n) {
  const std::uint32_t i = k == 0 ? m : k == 1 ? n - m : 0, j = k == 0 ? 0 : k == 1 ? m : n - m;
  return node_number(i, j, n);
}

void add_words(std::vector<std::uint32_t>& hanging, std::uint32_t vertex, std::uint32_t from, std::uint32_t to,
               double part) {
  hanging.insert(hanging.end(), {vertex, from, to, std::bit_cast<std::uint32_t>(static_cast<float>(part))});
}

// Vertices of one triangle that hang on its edges, as words of the mesh.
void add_hanging(const float* row, std::uint32_t level, const EdgeLevels& edges, const std::uint32_t* nodes,
                 std::vector<std::uint32_t>& hanging) {
  const std::uint32_t n = 1u << level;
  for (unsigned k = 0; k < 3; ++k) {
    const std::uint32_t step = 1u << (level - edges.at(row, k));
    const auto node = [&](std::uint32_t m) { return nodes[edge_node(k, m, n)]; };
    for (std::uint32_t m = 0; m < n && step > 1; ++m)
      if (m % step) add_words(hanging, node(m), node(m - m % step), node(m - m % step + step), double(m % step) / step);
  }
}

// --- Corners of triangles on other triangles' edges (T-vertices) ---

// A vertex lies on an edge where it is as near to it, in parts of the edge's steps.
constexpr double kOnEdge = 1e-4;
// Cells that one edge is looked for in, at most.
constexpr double kMostCells = 4096;

// An edge that no other triangle has as its own.
struct OpenEdge {
  std::uint64_t triangle;
  unsigned k;
  std::uint32_t n;
  std::uint32_t material;
  Vec from, along;
  double length;
  double step() const { return length / n; }
  // What is divided less counts first: others hang on it.
  bool is_before(const OpenEdge& other) const {
    return step() != other.step() ? step() > other.step() : std::tie(triangle, k) < std::tie(other.triangle, other.k);
  }
};

struct EdgeVertex {
  Vec place, normal;
  std::uint32_t vertex;
  std::size_t edge;
};

// Vertices by place.
class PlaceGrid {
 public:
  PlaceGrid(const std::vector<EdgeVertex>& vertices, double cell) : cell_(cell) {
    for (std::size_t i = 0; i < vertices.size(); ++i) cells_[cell_of(vertices[i].place)].push_back(i);
  }
  // Calls `one` with each vertex in the cells about an edge.
  template <typename One>
  void along(const OpenEdge& edge, One one) const {
    std::unordered_set<Cell, WordsHash> seen;
    const double steps = std::ceil(edge.length / cell_);
    for (double t = 0; t <= steps; ++t) {
      const Cell middle = cell_of(edge.from + edge.along * (steps > 0 ? t / steps : 0));
      for (int x = -1; x <= 1; ++x)
        for (int y = -1; y <= 1; ++y)
          for (int z = -1; z <= 1; ++z) {
            const Cell cell = {middle[0] + x, middle[1] + y, middle[2] + z};
            const auto found = cells_.find(cell);
            if (found == cells_.end() || !seen.insert(cell).second) continue;
            for (const std::size_t i : found->second) one(i);
          }
    }
  }

 private:
  // Wraps around: what is far apart may share a cell.
  using Cell = std::array<std::uint32_t, 3>;
  Cell cell_of(const Vec& place) const {
    Cell cell{};
    for (std::size_t k = 0; k < 3; ++k)
      cell[k] =
          static_cast<std::uint32_t>(static_cast<std::int64_t>(std::floor(std::clamp(place[k] / cell_, -9e15, 9e15))));
    return cell;
  }
  double cell_;
  std::unordered_map<Cell, std::vector<std::size_t>, WordsHash> cells_;
};

class OpenEdges {
 public:
  OpenEdges(const DividedTriangles& divided, const EdgeLevels& edges) : divided_(divided) {
    for (std::uint64_t t = 0; t < divided.triangles.count; ++t)
      for (unsigned k = 0; k < 3; ++k)
        if (!edges.is_shared(row(t), k)) add(t, k);
  }

  // Words of the mesh: vertices that lie on an open edge of the same wall that is divided less.
  void add_hanging(std::vector<std::uint32_t>& hanging) const {
    if (edges_.empty()) return;
    double length = 0, steps = 0, longest = 0;
    for (const OpenEdge& edge : edges_)
      length += edge.length, steps += edge.n, longest = std::max(longest, edge.length);
    if (!(length > 0)) return;
    const PlaceGrid grid(vertices_, std::max(length / steps, longest / kMostCells));
    std::vector<std::size_t> order(edges_.size());
    for (std::size_t e = 0; e < order.size(); ++e) order[e] = e;
    std::ranges::sort(order, [&](std::size_t a, std::size_t b) { return edges_[a].is_before(edges_[b]); });
    std::unordered_set<std::uint32_t> hangs;
    for (const std::size_t e : order) {
      check_wanted();
      std::vector<std::size_t> near;
      grid.along(edges_[e], [&](std::size_t i) {
        if (edges_[e].is_before(edges_[vertices_[i].edge])) near.push_back(i);
      });
      std::ranges::sort(near);
      for (const std::size_t i : near)
        if (!hangs.contains(vertices_[i].vertex) && put_on(edges_[e], vertices_[i], hanging))
          hangs.insert(vertices_[i].vertex);
    }
  }

 private:
  const float* row(std::uint64_t t) const { return divided_.triangles.rows + t * divided_.triangles.words; }

  void add(std::uint64_t t, unsigned k) {
    const Triangle triangle(row(t));
    const Vec &from = triangle.p[k], along = triangle.p[(k + 1) % 3] - from;
    const std::uint32_t n = 1u << divided_.levels[t];
    edges_.push_back({t, k, n, triangle.material, from, along, std::sqrt(dot(along, along))});
    for (std::uint32_t m = 0; m <= n; ++m) {
      const double part = static_cast<double>(m) / n;
      vertices_.push_back(
          {from + along * part, normal_on(triangle, k, part), vertex_of(edges_.back(), m), edges_.size() - 1});
    }
  }
  static Vec normal_on(const Triangle& triangle, unsigned k, double part) {
    return k == 0   ? triangle.normal_at(part, 0)
           : k == 1 ? triangle.normal_at(1 - part, part)
                    : triangle.normal_at(0, 1 - part);
  }
  std::uint32_t vertex_of(const OpenEdge& edge, std::uint32_t m) const {
    return divided_.nodes[divided_.first_node[edge.triangle] + edge_node(edge.k, m, edge.n)];
  }

  bool put_on(const OpenEdge& edge, const EdgeVertex& vertex, std::vector<std::uint32_t>& hanging) const {
    if (edges_[vertex.edge].material != edge.material) return false;
    const Vec away = vertex.place - edge.from;
    const double part = dot(away, edge.along) / (edge.length * edge.length);
    if (!(part > 0 && part < 1)) return false;
    const Vec off = away - edge.along * part;
    if (std::sqrt(dot(off, off)) > kOnEdge * edge.step()) return false;
    if (dot(vertex.normal, normal_on(Triangle(row(edge.triangle)), edge.k, part)) < kSameNormal) return false;
    const auto m = std::min(static_cast<std::uint32_t>(part * edge.n), edge.n - 1);
    const std::uint32_t from = vertex_of(edge, m), to = vertex_of(edge, m + 1);
    const double within = part * edge.n - m;
    if (vertex.vertex == from || vertex.vertex == to || !(within > 0 && within < 1)) return false;
    add_words(hanging, vertex.vertex, from, to, within);
    return true;
  }

  const DividedTriangles& divided_;
  std::vector<OpenEdge> edges_;
  std::vector<EdgeVertex> vertices_;
};

}  // namespace

std::vector<std::uint32_t> hanging_vertices(const DividedTriangles& divided) {
  const TriangleRows& triangles = divided.triangles;
  const EdgeLevels edges(triangles, divided.levels);
  std::vector<std::uint32_t> hanging;
  OpenEdges(divided, edges).add_hanging(hanging);
  for (std::uint64_t t = 0; t < triangles.count; ++t) {
    check_wanted();
    add_hanging(triangles.rows + t * triangles.words, divided.levels[t], edges, &divided.nodes[divided.first_node[t]],
                hanging);
  }
  return hanging;
}

}  // namespace gleaner::worker

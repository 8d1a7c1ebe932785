// Which vertices there are: nodes of grids that divide the scene's triangles, shared where they lie at one place.

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstring>
#include <unordered_map>

#include "kernels/scene_layout.h"
#include "scene/model/error.h"
#include "worker/stages/links/mesh.h"
#include "worker/wavefront/wanted.h"

namespace gleaner::worker {
namespace {

using Vec = std::array<double, 3>;

// Nodes at one place are one vertex where their normals agree to half a degree.
constexpr double kSameNormal = 0.99996;
// Nodes are numbered in 32 bits, as are words of the mesh.
constexpr std::uint64_t kMostNodes = std::uint64_t{1} << 28;

Vec operator+(const Vec& a, const Vec& b) { return {a[0] + b[0], a[1] + b[1], a[2] + b[2]}; }
Vec operator-(const Vec& a, const Vec& b) { return {a[0] - b[0], a[1] - b[1], a[2] - b[2]}; }
Vec operator*(const Vec& a, double s) { return {a[0] * s, a[1] * s, a[2] * s}; }
double dot(const Vec& a, const Vec& b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }
Vec cross(const Vec& a, const Vec& b) {
  return {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
}
Vec unit(const Vec& a) {
  const double l = std::sqrt(dot(a, a));
  return l > 0 ? a * (1 / l) : a;
}
Vec vec(const float* p) { return {p[0], p[1], p[2]}; }

struct Triangle {
  explicit Triangle(const float* row)
      : p{vec(row + TRIANGLE_P0), vec(row + TRIANGLE_P1), vec(row + TRIANGLE_P2)},
        n{vec(row + TRIANGLE_N0), vec(row + TRIANGLE_N1), vec(row + TRIANGLE_N2)} {
    std::memcpy(&material, row + TRIANGLE_MATERIAL, 4);
    const Vec normal = cross(p[1] - p[0], p[2] - p[0]);
    area = 0.5 * std::sqrt(dot(normal, normal));
    geometric = unit(normal);
  }
  Vec normal_at(double b1, double b2) const {
    const Vec normal = n[0] * (1 - b1 - b2) + n[1] * b1 + n[2] * b2;
    return dot(normal, normal) > 1e-12 ? unit(normal) : geometric;
  }

  std::array<Vec, 3> p, n;
  std::uint32_t material = 0;
  double area = 0;
  Vec geometric{};
};

// Place k of n between two corners: the same float for every triangle that has this edge.
std::array<float, 3> on_edge(Vec a, Vec b, std::uint32_t k, std::uint32_t n) {
  if (b < a) {
    std::swap(a, b);
    k = n - k;
  }
  const Vec p = k == n ? b : a + (b - a) * (static_cast<double>(k) / n);
  return {static_cast<float>(p[0]), static_cast<float>(p[1]), static_cast<float>(p[2])};
}

// Vertices by place, material and normal.
class VertexTable {
 public:
  std::uint32_t find_or_add(const std::array<float, 3>& place, std::uint32_t material, const Vec& normal) {
    std::array<std::uint32_t, 3> key{};
    for (std::size_t k = 0; k < 3; ++k) key[k] = std::bit_cast<std::uint32_t>(place[k] + 0.0f);  // -0 is 0
    std::uint32_t& head = heads_.try_emplace(key, GLEANER_NONE).first->second;
    for (std::uint32_t at = head; at != GLEANER_NONE; at = shared_[at].next)
      if (shared_[at].material == material && dot(shared_[at].normal, normal) >= kSameNormal) return shared_[at].vertex;
    const std::uint32_t vertex = add(normal);
    if (head != GLEANER_NONE) places_[vertex].first = places_[shared_[head].vertex].first;
    shared_.push_back({vertex, material, head, normal});
    head = static_cast<std::uint32_t>(shared_.size() - 1);
    return shared_.back().vertex;
  }
  std::uint32_t add(const Vec& normal) {
    places_.push_back({normal, count()});
    return count() - 1;
  }
  std::uint32_t count() const { return static_cast<std::uint32_t>(places_.size()); }
  struct Place {
    Vec normal;
    std::uint32_t first;  // vertex at the same place
  };
  const std::vector<Place>& places() const { return places_; }

 private:
  struct Shared {
    std::uint32_t vertex, material, next;
    Vec normal;
  };
  struct Hash {
    std::size_t operator()(const std::array<std::uint32_t, 3>& key) const {
      std::uint64_t h = 0x9e3779b97f4a7c15ull;
      for (const std::uint32_t word : key) h = (h ^ word) * 0xff51afd7ed558ccdull, h ^= h >> 32;
      return h;
    }
  };
  std::unordered_map<std::array<std::uint32_t, 3>, std::uint32_t, Hash> heads_;
  std::vector<Shared> shared_;
  std::vector<Place> places_;
};

// Calls `one` with the three nodes of each small triangle, as grid places.
template <typename One>
void each_small_triangle(std::uint32_t n, One one) {
  using Place = std::array<std::uint32_t, 2>;
  for (std::uint32_t j = 0; j < n; ++j)
    for (std::uint32_t i = 0; i + j < n; ++i) {
      one(Place{i, j}, 0u), one(Place{i + 1, j}, 2u), one(Place{i, j + 1}, 4u);
      if (i + j + 2 <= n) one(Place{i + 1, j + 1}, 3u), one(Place{i, j + 1}, 5u), one(Place{i + 1, j}, 1u);
    }
}

void add_nodes(const Triangle& triangle, std::uint32_t level, VertexTable& table, std::vector<std::uint32_t>& nodes) {
  const std::uint32_t n = 1u << level;
  const auto& p = triangle.p;
  for (std::uint32_t j = 0; j <= n; ++j)
    for (std::uint32_t i = 0; i + j <= n; ++i) {
      const Vec normal = triangle.normal_at(static_cast<double>(i) / n, static_cast<double>(j) / n);
      std::array<float, 3> place{};
      if (j == 0)
        place = on_edge(p[0], p[1], i, n);
      else if (i == 0)
        place = on_edge(p[0], p[2], j, n);
      else if (i + j == n)
        place = on_edge(p[1], p[2], j, n);
      else {
        nodes.push_back(table.add(normal));
        continue;
      }
      nodes.push_back(table.find_or_add(place, triangle.material, normal));
    }
}

// The lowest level of the triangles at an edge, by its ends.
class EdgeLevels {
 public:
  EdgeLevels(const TriangleRows& triangles, const std::vector<std::uint32_t>& levels) {
    for (std::uint64_t t = 0; t < triangles.count; ++t)
      for (unsigned k = 0; k < 3; ++k) {
        const auto [place, added] = levels_.try_emplace(key(triangles.rows + t * triangles.words, k), levels[t]);
        if (!added) place->second = std::min(place->second, levels[t]);
      }
  }
  // Of the edge from corner k to the next one.
  std::uint32_t at(const float* row, unsigned k) const { return levels_.at(key(row, k)); }

 private:
  using Key = std::array<float, 6>;
  static Key key(const float* row, unsigned k) {
    const float *a = row + TRIANGLE_P0 + 3 * k, *b = row + TRIANGLE_P0 + 3 * ((k + 1) % 3);
    if (std::lexicographical_compare(b, b + 3, a, a + 3)) std::swap(a, b);
    return {a[0] + 0.0f, a[1] + 0.0f, a[2] + 0.0f, b[0] + 0.0f, b[1] + 0.0f, b[2] + 0.0f};
  }
  struct Hash {
    std::size_t operator()(const Key& key) const {
      std::uint64_t h = 0x9e3779b97f4a7c15ull;
      for (const float x : key) h = (h ^ std::bit_cast<std::uint32_t>(x)) * 0xff51afd7ed558ccdull, h ^= h >> 32;
      return h;
    }
  };
  std::unordered_map<Key, std::uint32_t, Hash> levels_;
};

// Vertices of one triangle that hang on its edges, as words of the mesh.
void add_hanging(const float* row, std::uint32_t level, const EdgeLevels& edges, const std::uint32_t* nodes,
                 std::vector<std::uint32_t>& hanging) {
  const std::uint32_t n = 1u << level;
  for (unsigned k = 0; k < 3; ++k) {
    const std::uint32_t step = 1u << (level - edges.at(row, k));
    const auto node = [&](std::uint32_t m) {
      const std::uint32_t i = k == 0 ? m : k == 1 ? n - m : 0, j = k == 0 ? 0 : k == 1 ? m : n - m;
      return nodes[node_number(i, j, n)];
    };
    for (std::uint32_t m = 0; m < n && step > 1; ++m)
      if (m % step)
        hanging.insert(hanging.end(),
                       {node(m), node(m - m % step), node(m - m % step + step),
                        std::bit_cast<std::uint32_t>(static_cast<float>(m % step) / static_cast<float>(step))});
  }
}

}  // namespace

std::vector<std::uint32_t> make_links_mesh(const TriangleRows& input, const std::vector<std::uint32_t>& levels,
                                           kernels::LinksMeshFacts* facts) {
  const auto [rows, words, triangles] = input;
  std::uint64_t total = 0;
  for (const std::uint32_t level : levels) total += nodes_of_level(level);
  if (total > kMostNodes)
    throw Error::failed("links: the scene's triangles have " + std::to_string(total) + " nodes, at most " +
                        std::to_string(kMostNodes) + " are possible");

  MeshLayout layout{.triangles = triangles};
  VertexTable table;
  const EdgeLevels edges(input, levels);
  std::vector<std::uint32_t> nodes, first_node(triangles), hanging;
  nodes.reserve(total);
  for (std::uint64_t t = 0; t < triangles; ++t) {
    check_wanted();
    first_node[t] = static_cast<std::uint32_t>(nodes.size());
    add_nodes(Triangle(rows + t * words), levels[t], table, nodes);
    add_hanging(rows + t * words, levels[t], edges, &nodes[first_node[t]], hanging);
    layout.corners += 3 * (std::uint64_t{1} << (2 * levels[t]));
    facts->divided += levels[t] > 0;
  }
  layout.nodes = nodes.size();
  layout.vertices = table.count();
  layout.hanging = hanging.size() / HANGING_WORDS;
  facts->vertices = table.count();
  facts->nodes = static_cast<std::uint32_t>(nodes.size());
  facts->triangles = static_cast<std::uint32_t>(triangles);

  std::vector<std::uint32_t> mesh(layout.words());
  mesh[MESH_TRIANGLES] = facts->triangles;
  mesh[MESH_NODES] = facts->nodes;
  mesh[MESH_VERTICES] = facts->vertices;
  mesh[MESH_CORNERS] = static_cast<std::uint32_t>(layout.corners);
  mesh[MESH_HANGING] = static_cast<std::uint32_t>(layout.hanging);
  std::ranges::copy(hanging, mesh.begin() + static_cast<std::ptrdiff_t>(layout.hanging_at()));
  for (std::uint64_t v = 0; v < layout.vertices; ++v) {
    std::uint32_t* place = &mesh[layout.places_at() + PLACE_WORDS * v];
    for (unsigned k = 0; k < 3; ++k)
      place[PLACE_NORMAL + k] = std::bit_cast<std::uint32_t>(static_cast<float>(table.places()[v].normal[k]));
    place[PLACE_FIRST] = table.places()[v].first;
  }
  for (std::uint64_t t = 0; t < triangles; ++t) {
    mesh[MESH_HEADER + MESH_TRIANGLE_WORDS * t] = first_node[t];
    mesh[MESH_HEADER + MESH_TRIANGLE_WORDS * t + 1] = levels[t];
  }
  std::ranges::copy(nodes, mesh.begin() + static_cast<std::ptrdiff_t>(layout.nodes_at()));

  const auto each_corner = [&](auto one) {
    for (std::uint64_t t = 0; t < triangles; ++t) {
      check_wanted();
      each_small_triangle(1u << levels[t], [&](const auto& place, std::uint32_t kind) {
        one(t, place, kind, nodes[first_node[t] + node_number(place[0], place[1], 1u << levels[t])]);
      });
    }
  };
  std::uint32_t* rings = &mesh[layout.rings_at()];
  each_corner([&](auto, const auto&, auto, std::uint32_t vertex) { ++rings[vertex + 1]; });
  for (std::uint64_t v = 0; v < layout.vertices; ++v) rings[v + 1] += rings[v];
  std::vector<std::uint32_t> next(rings, rings + layout.vertices);
  std::uint32_t* corners = &mesh[layout.corners_at()];
  std::vector<double> areas(triangles);
  for (std::uint64_t t = 0; t < triangles; ++t)
    areas[t] = Triangle(rows + t * words).area / static_cast<double>(std::uint64_t{1} << (2 * levels[t]));
  each_corner([&](std::uint64_t t, const auto& place, std::uint32_t kind, std::uint32_t vertex) {
    std::uint32_t* corner = corners + std::uint64_t{CORNER_WORDS} * next[vertex]++;
    corner[CORNER_TRIANGLE] = static_cast<std::uint32_t>(t);
    corner[CORNER_PLACE] = place[0] | (place[1] << 12) | (kind << 24);
    corner[CORNER_SHARE] = std::bit_cast<std::uint32_t>(static_cast<float>(areas[t]));
    corner[CORNER_STEP] = std::bit_cast<std::uint32_t>(1.0f / static_cast<float>(1u << levels[t]));
  });
  // Areas become cumulated shares.
  for (std::uint64_t v = 0; v < layout.vertices; ++v) {
    double sum = 0, before = 0;
    const auto share = [&](std::uint32_t c) -> std::uint32_t& { return corners[CORNER_WORDS * c + CORNER_SHARE]; };
    for (std::uint32_t c = rings[v]; c < rings[v + 1]; ++c) sum += std::bit_cast<float>(share(c));
    for (std::uint32_t c = rings[v]; c < rings[v + 1]; ++c) {
      before += sum > 0 ? std::bit_cast<float>(share(c)) / sum : 1.0 / (rings[v + 1] - rings[v]);
      share(c) = std::bit_cast<std::uint32_t>(static_cast<float>(before));
    }
    mesh[layout.areas_at() + v] = std::bit_cast<std::uint32_t>(static_cast<float>(sum / 3));
  }
  return mesh;
}

}  // namespace gleaner::worker

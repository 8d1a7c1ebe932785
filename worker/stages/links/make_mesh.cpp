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
  double longest_edge() const {
    double longest = 0;
    for (int k = 0; k < 3; ++k) longest = std::max(longest, dot(p[(k + 1) % 3] - p[k], p[(k + 1) % 3] - p[k]));
    return std::sqrt(longest);
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
    shared_.push_back({add(), material, head, normal});
    head = static_cast<std::uint32_t>(shared_.size() - 1);
    return shared_.back().vertex;
  }
  std::uint32_t add() { return count_++; }
  std::uint32_t count() const { return count_; }

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
  std::uint32_t count_ = 0;
};

std::uint32_t level_for(double edge, double spacing) {
  std::uint32_t level = 0;
  while (level < MESH_MOST_LEVEL && edge > spacing * static_cast<double>(1u << level)) ++level;
  return level;
}

// Levels such that no edge is longer than a spacing, the smallest that leaves about as many vertices as wanted.
std::vector<std::uint32_t> choose_levels(const std::vector<double>& edges, std::uint32_t wanted) {
  std::vector<std::uint32_t> levels(edges.size(), 0);
  if (wanted == 0 || edges.empty()) return levels;
  const double longest = std::max(1e-30, *std::ranges::max_element(edges));
  // A vertex for each two small triangles.
  const auto vertices = [&](double spacing) {
    double sum = 0;
    for (const double edge : edges) sum += 0.5 * std::pow(4.0, level_for(edge, spacing));
    return sum;
  };
  double coarse = longest, fine = longest / static_cast<double>(1u << MESH_MOST_LEVEL);
  if (vertices(coarse) > wanted) return levels;
  for (int step = 0; step < 40; ++step) {
    const double middle = std::sqrt(coarse * fine);
    (vertices(middle) > wanted ? fine : coarse) = middle;
  }
  for (std::size_t t = 0; t < edges.size(); ++t) levels[t] = level_for(edges[t], coarse);
  return levels;
}

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

std::uint32_t node_number(std::uint32_t i, std::uint32_t j, std::uint32_t n) {
  return j * (n + 1) - (j * (j - 1)) / 2 + i;
}

void add_nodes(const Triangle& triangle, std::uint32_t level, VertexTable& table, std::vector<std::uint32_t>& nodes) {
  const std::uint32_t n = 1u << level;
  const auto& p = triangle.p;
  for (std::uint32_t j = 0; j <= n; ++j)
    for (std::uint32_t i = 0; i + j <= n; ++i) {
      std::array<float, 3> place{};
      if (j == 0)
        place = on_edge(p[0], p[1], i, n);
      else if (i == 0)
        place = on_edge(p[0], p[2], j, n);
      else if (i + j == n)
        place = on_edge(p[1], p[2], j, n);
      else {
        nodes.push_back(table.add());
        continue;
      }
      const Vec normal = triangle.normal_at(static_cast<double>(i) / n, static_cast<double>(j) / n);
      nodes.push_back(table.find_or_add(place, triangle.material, normal));
    }
}

}  // namespace

std::vector<std::uint32_t> make_links_mesh(const float* rows, unsigned words, std::uint64_t triangles,
                                           std::uint32_t wanted, kernels::LinksMeshFacts* facts) {
  std::vector<double> edges(triangles);
  for (std::uint64_t t = 0; t < triangles; ++t) edges[t] = Triangle(rows + t * words).longest_edge();
  const std::vector<std::uint32_t> levels = choose_levels(edges, wanted);
  std::uint64_t total = 0;
  for (const std::uint32_t level : levels) total += nodes_of_level(level);
  if (total > kMostNodes)
    throw Error::failed("links: the scene's triangles have " + std::to_string(total) + " nodes, at most " +
                        std::to_string(kMostNodes) + " are possible");

  MeshLayout layout{.triangles = triangles};
  VertexTable table;
  std::vector<std::uint32_t> nodes, first_node(triangles);
  nodes.reserve(total);
  for (std::uint64_t t = 0; t < triangles; ++t) {
    first_node[t] = static_cast<std::uint32_t>(nodes.size());
    add_nodes(Triangle(rows + t * words), levels[t], table, nodes);
    layout.corners += 3 * (std::uint64_t{1} << (2 * levels[t]));
    facts->divided += levels[t] > 0;
  }
  layout.nodes = nodes.size();
  layout.vertices = table.count();
  facts->vertices = table.count();
  facts->nodes = static_cast<std::uint32_t>(nodes.size());
  facts->triangles = static_cast<std::uint32_t>(triangles);

  std::vector<std::uint32_t> mesh(layout.words());
  mesh[MESH_TRIANGLES] = facts->triangles;
  mesh[MESH_NODES] = facts->nodes;
  mesh[MESH_VERTICES] = facts->vertices;
  mesh[MESH_CORNERS] = static_cast<std::uint32_t>(layout.corners);
  for (std::uint64_t t = 0; t < triangles; ++t) {
    mesh[MESH_HEADER + MESH_TRIANGLE_WORDS * t] = first_node[t];
    mesh[MESH_HEADER + MESH_TRIANGLE_WORDS * t + 1] = levels[t];
  }
  std::ranges::copy(nodes, mesh.begin() + static_cast<std::ptrdiff_t>(layout.nodes_at()));

  const auto each_corner = [&](auto one) {
    for (std::uint64_t t = 0; t < triangles; ++t)
      each_small_triangle(1u << levels[t], [&](const auto& place, std::uint32_t kind) {
        one(t, place, kind, nodes[first_node[t] + node_number(place[0], place[1], 1u << levels[t])]);
      });
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

// Which vertices there are: nodes of grids that divide the scene's triangles, shared where they lie at one place.

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstring>
#include <unordered_map>

#include "kernels/scene_layout.h"
#include "scene/model/error.h"
#include "worker/stages/links/geometry.h"
#include "worker/stages/links/hanging.h"
#include "worker/stages/links/mesh.h"
#include "worker/wavefront/wanted.h"

namespace gleaner::worker {
namespace {

// Nodes are numbered in 32 bits, as are words of the mesh.
constexpr std::uint64_t kMostNodes = std::uint64_t{1} << 28;

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
  std::unordered_map<std::array<std::uint32_t, 3>, std::uint32_t, WordsHash> heads_;
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

struct DividedTriangles {
  const std::vector<std::uint32_t>&levels, &first_node;  // of each triangle
  const std::vector<std::uint32_t>& nodes;               // their vertices
  std::vector<double> areas;                             // of one of each triangle's small ones
};

// The small triangles about each vertex, and its area.
void write_rings(const DividedTriangles& divided, const MeshLayout& layout, std::vector<std::uint32_t>& mesh) {
  const std::vector<std::uint32_t>&levels = divided.levels, &first_node = divided.first_node, &nodes = divided.nodes;
  const auto each_corner = [&](auto one) {
    for (std::uint64_t t = 0; t < layout.triangles; ++t) {
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
  each_corner([&](std::uint64_t t, const auto& place, std::uint32_t kind, std::uint32_t vertex) {
    std::uint32_t* corner = corners + std::uint64_t{CORNER_WORDS} * next[vertex]++;
    corner[CORNER_TRIANGLE] = static_cast<std::uint32_t>(t);
    corner[CORNER_PLACE] = place[0] | (place[1] << 12) | (kind << 24);
    corner[CORNER_SHARE] = std::bit_cast<std::uint32_t>(static_cast<float>(divided.areas[t]));
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
  std::vector<std::uint32_t> nodes, first_node(triangles);
  nodes.reserve(total);
  for (std::uint64_t t = 0; t < triangles; ++t) {
    check_wanted();
    first_node[t] = static_cast<std::uint32_t>(nodes.size());
    add_nodes(Triangle(rows + t * words), levels[t], table, nodes);
    layout.corners += 3 * (std::uint64_t{1} << (2 * levels[t]));
    facts->divided += levels[t] > 0;
  }
  const std::vector<std::uint32_t> hanging = hanging_vertices({input, levels, first_node, nodes});
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

  std::vector<double> areas(triangles);
  for (std::uint64_t t = 0; t < triangles; ++t)
    areas[t] = Triangle(rows + t * words).area / static_cast<double>(std::uint64_t{1} << (2 * levels[t]));
  write_rings({levels, first_node, nodes, std::move(areas)}, layout, mesh);
  return mesh;
}

}  // namespace gleaner::worker

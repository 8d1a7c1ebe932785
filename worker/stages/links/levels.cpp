// How far triangles are divided: evenly, or where irradiance bends.

#include <algorithm>
#include <cmath>
#include <queue>

#include "kernels/scene_layout.h"
#include "worker/stages/links/mesh.h"
#include "worker/wavefront/wanted.h"

namespace gleaner::worker {
namespace {

// With each level what a triangle interpolates wrongly falls by so much (squared): smooth light by 16, at the edges of
// shadows by 4; between them.
constexpr double kErrorFalls = 8;

double longest_edge(const float* row) {
  double longest = 0;
  for (unsigned k = 0; k < 3; ++k) {
    double d2 = 0;
    for (unsigned x = 0; x < 3; ++x) {
      const double d = double{row[TRIANGLE_P0 + 3 * k + x]} - row[TRIANGLE_P0 + 3 * ((k + 1) % 3) + x];
      d2 += d * d;
    }
    longest = std::max(longest, d2);
  }
  return std::sqrt(longest);
}

double area(const float* row) {
  double e[2][3], n[3];
  for (unsigned k = 0; k < 2; ++k)
    for (unsigned x = 0; x < 3; ++x) e[k][x] = double{row[TRIANGLE_P1 + 3 * k + x]} - row[TRIANGLE_P0 + x];
  for (unsigned x = 0; x < 3; ++x) n[x] = e[0][(x + 1) % 3] * e[1][(x + 2) % 3] - e[0][(x + 2) % 3] * e[1][(x + 1) % 3];
  return 0.5 * std::sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
}

std::uint32_t level_for(double edge, double spacing) {
  std::uint32_t level = 0;
  while (level < MESH_MOST_LEVEL && edge > spacing * static_cast<double>(1u << level)) ++level;
  return level;
}

// A vertex for each two small triangles.
double vertices_of(std::uint32_t level) { return 0.5 * std::pow(4.0, level); }

// How many vertices all triangles may have, by vertices_of().
double allowed_vertices(const TriangleRows& triangles, const kernels::LinksMeshParameters& wanted) {
  return wanted.vertices + (wanted.beside_own ? static_cast<double>(triangles.count) * vertices_of(0) : 0);
}

// The mean squared second difference of the probe along the grid lines of a triangle, each product of two independent
// estimates. None where it is not divided, nor of sides that are hidden behind walls.
double bend_of(const HostMesh& mesh, std::uint64_t triangle, const std::vector<float>& probe) {
  const std::uint32_t* row = &mesh.words[MESH_HEADER + MESH_TRIANGLE_WORDS * triangle];
  const std::uint32_t n = 1u << row[1];
  const std::uint32_t* nodes = &mesh.words[mesh.layout.nodes_at() + row[0]];
  double sum = 0;
  std::uint64_t count = 0;
  const auto add = [&](std::uint32_t a, std::uint32_t b, std::uint32_t c) {
    for (std::uint64_t side = 0; side < 2; ++side) {
      if (is_hidden(probe, 2ull * nodes[b] + side)) continue;
      const float* p[3] = {&probe[(2ull * nodes[a] + side) * PROBE_WORDS],
                           &probe[(2ull * nodes[b] + side) * PROBE_WORDS],
                           &probe[(2ull * nodes[c] + side) * PROBE_WORDS]};
      for (unsigned k = 0; k < PROBE_LIGHTS; ++k) {
        const auto bend = [&](unsigned half) {
          const unsigned at = half * PROBE_LIGHTS + k;
          return p[1][at] - 0.5 * (double{p[0][at]} + p[2][at]);
        };
        sum += bend(0) * bend(1);
      }
    }
    ++count;
  };
  for (std::uint32_t j = 0; j <= n; ++j)
    for (std::uint32_t i = 0; i + j <= n; ++i) {
      if (i > 0 && i + j < n) add(node_number(i - 1, j, n), node_number(i, j, n), node_number(i + 1, j, n));
      if (j > 0 && i + j < n) add(node_number(i, j - 1, n), node_number(i, j, n), node_number(i, j + 1, n));
      if (i > 0 && j > 0)
        add(node_number(i - 1, j + 1 <= n ? j + 1 : j, n), node_number(i, j, n), node_number(i + 1, j - 1, n));
    }
  return count ? std::max(0.0, sum / static_cast<double>(count)) : 0;
}

}  // namespace

std::vector<std::uint32_t> even_levels(const TriangleRows& triangles, const kernels::LinksMeshParameters& wanted) {
  const double most = allowed_vertices(triangles, wanted);
  std::vector<std::uint32_t> levels(triangles.count, 0);
  if (wanted.vertices == 0 || triangles.count == 0) return levels;
  std::vector<double> edges(triangles.count);
  for (std::uint64_t t = 0; t < triangles.count; ++t) edges[t] = longest_edge(triangles.rows + t * triangles.words);
  const double longest = std::max(1e-30, *std::ranges::max_element(edges));
  const auto vertices = [&](double spacing) {
    double sum = 0;
    for (const double edge : edges) sum += vertices_of(level_for(edge, spacing));
    return sum;
  };
  double coarse = longest, fine = longest / static_cast<double>(1u << MESH_MOST_LEVEL);
  if (vertices(coarse) > most) return levels;
  for (int step = 0; step < 40; ++step) {
    check_wanted();
    const double middle = std::sqrt(coarse * fine);
    (vertices(middle) > most ? fine : coarse) = middle;
  }
  for (std::uint64_t t = 0; t < triangles.count; ++t) levels[t] = level_for(edges[t], coarse);
  return levels;
}

std::vector<std::uint32_t> refined_levels(const TriangleRows& triangles, const kernels::LinksMeshParameters& wanted,
                                          const HostMesh& coarse, const std::vector<float>& probe) {
  struct Next {
    double gain;  // squared error taken off, by vertices added
    std::uint64_t triangle;
    bool operator<(const Next& other) const {
      return gain != other.gain ? gain < other.gain : triangle > other.triangle;
    }
  };
  std::vector<std::uint32_t> levels(triangles.count);
  std::vector<double> error(triangles.count);
  std::priority_queue<Next> queue;
  const auto push = [&](std::uint64_t t) {
    const double vertices = vertices_of(levels[t] + 1) - vertices_of(levels[t]);
    if (error[t] > 0 && levels[t] < MESH_MOST_LEVEL) queue.push({error[t] / vertices, t});
  };
  double left = allowed_vertices(triangles, wanted);
  for (std::uint64_t t = 0; t < triangles.count; ++t) {
    check_wanted();
    levels[t] = coarse.level(t);
    error[t] = area(triangles.rows + t * triangles.words) * bend_of(coarse, t, probe);
    left -= vertices_of(levels[t]);
    push(t);
  }
  while (left > 0 && !queue.empty()) {
    check_wanted();
    const std::uint64_t t = queue.top().triangle;
    queue.pop();
    left -= vertices_of(levels[t] + 1) - vertices_of(levels[t]);
    ++levels[t];
    error[t] /= kErrorFalls;
    push(t);
  }
  return levels;
}

}  // namespace gleaner::worker

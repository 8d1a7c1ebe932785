// Stage kind "links_smooth": irradiance smoothed over one-rings within feature edges (eq. 5-6) as far as its noise
// allows, and put on the edges
// that it hangs on, so that the triangles on both sides interpolate the same.

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>

#include "scene/model/error.h"
#include "worker/stages/links/flux.h"
#include "worker/stages/links/mesh.h"
#include "worker/stages/links/stages.h"
#include "worker/stages/vpl/rows.h"

namespace gleaner::worker {
namespace {

class Smoothing {
 public:
  Smoothing(const HostMesh& mesh, const std::vector<float>& rows) : mesh_(mesh), l_(mesh.layout), rows_(rows) {}

  // eq. 5, over those neighbours whose normals agree (eq. 6). No channel moves by more than their noise (root mean
  // square): an element's own is told low where its irradiance is, and would let it rise less than others sink.
  std::vector<float> smooth(float least_cosine, const std::vector<float>& noise) {
    list_neighbours();
    std::vector<float> out = rows_;
    for (std::uint32_t v = 0; v < l_.vertices; ++v)
      for (unsigned side = 0; side < 2; ++side) {
        std::array<double, 3> sum{};
        double variance = 0;
        std::uint32_t count = 0;
        const std::uint32_t place = first_at(v);
        for (std::uint32_t k = starts_[place]; k < starts_[place + 1]; ++k) {
          const std::uint32_t w = neighbours_[k];
          // Vertices whose normals face away from each other see other sides of a wall.
          if (w != v && (cosine(v, w) < least_cosine || !outside(w, side))) continue;
          for (unsigned c = 0; c < 3; ++c) sum[c] += irradiance(rows_, w, side)[c];
          variance += double{noise[std::size_t{2} * w + side]} * noise[std::size_t{2} * w + side];
          ++count;
        }
        if (count == 0) continue;
        double most = 0;
        for (unsigned c = 0; c < 3; ++c) {
          sum[c] = sum[c] / count - irradiance(rows_, v, side)[c];
          most = std::max(most, std::abs(sum[c]));
        }
        const double allowed = std::sqrt(variance / count), part = most > allowed ? allowed / most : 1;
        for (unsigned c = 0; c < 3; ++c) irradiance(out, v, side)[c] += static_cast<float>(part * sum[c]);
      }
    return out;
  }

  void put_on_edges(std::vector<float>& rows) const {
    for (std::uint64_t h = 0; h < l_.hanging; ++h) {
      const std::uint32_t* row = &mesh_.words[l_.hanging_at() + HANGING_WORDS * h];
      for (unsigned side = 0; side < 2; ++side) {
        // As weigh_outside() has it for the triangle that is divided less.
        const bool from = outside(row[HANGING_FROM], side), to = outside(row[HANGING_TO], side);
        const auto part = from == to ? std::bit_cast<float>(row[HANGING_PART]) : to ? 1.0f : 0.0f;
        if (from || to) rows[(std::size_t{2} * row[HANGING_VERTEX] + side) * RADIOSITY_WORDS + RADIOSITY_OUTSIDE] = 1;
        for (unsigned c = 0; c < 3; ++c)
          irradiance(rows, row[HANGING_VERTEX], side)[c] = (1 - part) * irradiance(rows, row[HANGING_FROM], side)[c] +
                                                           part * irradiance(rows, row[HANGING_TO], side)[c];
      }
    }
  }

 private:
  static float* irradiance(std::vector<float>& rows, std::uint32_t vertex, unsigned side) {
    return &rows[(std::size_t{2} * vertex + side) * RADIOSITY_WORDS + RADIOSITY_IRRADIANCE];
  }
  static const float* irradiance(const std::vector<float>& rows, std::uint32_t vertex, unsigned side) {
    return &rows[(std::size_t{2} * vertex + side) * RADIOSITY_WORDS + RADIOSITY_IRRADIANCE];
  }
  const std::uint32_t* place_of(std::uint32_t vertex) const {
    return &mesh_.words[l_.places_at() + std::uint64_t{PLACE_WORDS} * vertex];
  }
  std::uint32_t first_at(std::uint32_t vertex) const { return place_of(vertex)[PLACE_FIRST]; }
  float cosine(std::uint32_t a, std::uint32_t b) const {
    float sum = 0;
    for (unsigned k = 0; k < 3; ++k)
      sum += std::bit_cast<float>(place_of(a)[PLACE_NORMAL + k]) * std::bit_cast<float>(place_of(b)[PLACE_NORMAL + k]);
    return sum;
  }

  bool outside(std::uint32_t vertex, unsigned side) const {
    return rows_[(std::size_t{2} * vertex + side) * RADIOSITY_WORDS + RADIOSITY_OUTSIDE] > 0;
  }

  // Of each place, by its first vertex: the vertices there and at the other ends of its edges.
  void list_neighbours() {
    std::vector<std::array<std::uint32_t, 2>> pairs;
    const auto add = [&](std::uint32_t v, std::uint32_t w) { pairs.push_back({first_at(v), w}); };
    for (std::uint32_t v = 0; v < l_.vertices; ++v) add(v, v);
    for (std::uint64_t t = 0; t < l_.triangles; ++t) {
      const std::uint32_t* row = &mesh_.words[MESH_HEADER + MESH_TRIANGLE_WORDS * t];
      const std::uint32_t* nodes = &mesh_.words[l_.nodes_at() + row[0]];
      const std::uint32_t n = 1u << row[1];
      const auto edge = [&](std::uint32_t a, std::uint32_t b) { add(nodes[a], nodes[b]), add(nodes[b], nodes[a]); };
      for (std::uint32_t j = 0; j < n; ++j)
        for (std::uint32_t i = 0; i + j < n; ++i) {
          edge(node_number(i, j, n), node_number(i + 1, j, n));
          edge(node_number(i, j, n), node_number(i, j + 1, n));
          edge(node_number(i + 1, j, n), node_number(i, j + 1, n));
        }
    }
    std::ranges::sort(pairs);
    pairs.erase(std::unique(pairs.begin(), pairs.end()), pairs.end());
    starts_.assign(l_.vertices + 1, 0);
    for (const auto& [place, vertex] : pairs) {
      ++starts_[place + 1];
      neighbours_.push_back(vertex);
    }
    for (std::uint64_t v = 0; v < l_.vertices; ++v) starts_[v + 1] += starts_[v];
  }

  const HostMesh& mesh_;
  const MeshLayout& l_;
  const std::vector<float>& rows_;
  std::vector<std::uint32_t> starts_, neighbours_;
};

}  // namespace

BatchResult smooth_links(const StageTask& task) {
  const auto p = host_parameters<kernels::LinksSmoothParameters>(task);
  const HostMesh mesh = read_mesh(task, "mesh");
  std::vector<float> rows = input_rows(task, "irradiance", RADIOSITY_WORDS);
  const std::uint64_t plain = mesh.layout.elements();
  if (p.elements < plain || rows.size() != std::size_t{p.elements} * RADIOSITY_WORDS)
    throw Error::bad_input("stage links_smooth", "input irradiance",
                           std::to_string(mesh.layout.elements()) + " elements",
                           std::to_string(rows.size() / RADIOSITY_WORDS));
  if (p.tail[0] != 0 || p.tail[1] != 0 || p.tail[2] != 0) {
    const std::vector<float> before = input_rows(task, "before", RADIOSITY_WORDS);
    if (before.size() != rows.size())
      throw Error::bad_input("stage links_smooth", "input before", std::to_string(p.elements) + " elements",
                             std::to_string(before.size() / RADIOSITY_WORDS));
    add_tail(rows, before, p.tail);
  }
  const std::vector<float> probe = input_rows(task, "probe", PROBE_WORDS);
  if (probe.size() != plain * PROBE_WORDS)
    throw Error::bad_input("stage links_smooth", "input probe", std::to_string(plain) + " rows",
                           std::to_string(probe.size() / PROBE_WORDS));
  std::vector<float> noise(plain);
  for (std::size_t e = 0; e < plain; ++e) {
    noise[e] = rows[e * RADIOSITY_WORDS + RADIOSITY_NOISE];
    if (!(noise[e] >= 0))
      throw Error::bad_input("stage links_smooth", "input irradiance[" + std::to_string(e) + "].noise", "0 or more",
                             std::to_string(noise[e]));
    rows[e * RADIOSITY_WORDS + RADIOSITY_OUTSIDE] = is_inside(probe, e) ? 0.0f : 1.0f;
  }
  Smoothing smoothing(mesh, rows);
  std::vector<float> out = p.least_cosine <= 1 ? smoothing.smooth(p.least_cosine, noise) : rows;
  smoothing.put_on_edges(out);
  BatchResult result;
  result.records.resize(out.size() * 4);
  std::memcpy(result.records.data(), out.data(), result.records.size());
  return result;
}

}  // namespace gleaner::worker

#include "worker/stages/cluster_stage.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>
#include <numeric>
#include <span>

#include "kernels/cluster_records.h"
#include "kernels/vpl_records.h"
#include "scene/model/error.h"
#include "scene/model/limits.h"
#include "scene/model/order.h"
#include "worker/stages/curve.h"
#include "worker/stages/k_means.h"
#include "worker/wavefront/counters.h"
#include "worker/wavefront/input_rows.h"

namespace gleaner::worker {
namespace {

using kernels::ClusterParameters;

// Evenly spaced along a curve that visits the data side by side and, within a side, place by place: every side gets
// its share of the clusters, every place its share of the side's.
std::vector<std::uint32_t> seeds_along_curve(const std::vector<float>& data, std::size_t stride,
                                             std::uint32_t clusters) {
  const std::vector<std::uint32_t> order = curve_order(data, stride, 1024, true);
  std::vector<std::uint32_t> seeds(clusters);
  for (std::uint64_t k = 0; k < clusters; ++k) seeds[k] = order[(2 * k + 1) * order.size() / (2 * clusters)];
  return seeds;
}

// The cluster's record: the member nearest to the centroid represents all (a centroid may hang in the air), with what
// they send in all.
void write_clusters(const KMeans& means, const std::vector<std::uint32_t>& assigned, const std::vector<float>& data,
                    std::size_t stride, std::uint32_t clusters, std::uint32_t random_representative,
                    std::vector<float>& rows) {
  const bool lights = stride == VPL_WORDS;
  const std::size_t count = data.size() / stride;
  std::vector<double> nearest(clusters, std::numeric_limits<double>::infinity());
  std::vector<std::uint32_t> chosen(clusters, GLEANER_NONE), members(clusters, 0);
  std::vector<double> flux(clusters * 3, 0.0), sent(clusters * 3, 0.0);
  for (std::size_t i = 0; i < count; ++i) {
    const std::uint32_t k = assigned[i];
    const double d = distance2(means.centroid(k), &data[i * stride]);
    if (d < nearest[k]) {
      nearest[k] = d;
      chosen[k] = static_cast<std::uint32_t>(i);
    }
    ++members[k];
    for (unsigned c = 0; lights && c < 3; ++c) {
      flux[3 * k + c] += data[i * stride + VPL_FLUX + c];
      sent[3 * k + c] += data[i * stride + VPL_SENT + c];
    }
  }
  if (lights && random_representative) {
    std::vector<double> aim(clusters), sum(clusters, 0.0);
    for (std::uint32_t k = 0; k < clusters; ++k)
      aim[k] = scene::unit_hash((std::uint64_t{random_representative} << 32) | k) *
               (flux[3 * k] + flux[3 * k + 1] + flux[3 * k + 2]);
    std::vector<bool> drawn(clusters, false);
    for (std::size_t i = 0; i < count; ++i) {
      const std::uint32_t k = assigned[i];
      for (unsigned c = 0; c < 3; ++c) sum[k] += data[i * stride + VPL_FLUX + c];
      if (drawn[k] || sum[k] <= aim[k]) continue;
      drawn[k] = true;
      chosen[k] = static_cast<std::uint32_t>(i);
    }
  }
  for (std::uint32_t k = 0; k < clusters; ++k)
    if (chosen[k] != GLEANER_NONE) std::copy_n(&data[chosen[k] * stride], stride, &rows[k * stride]);
  std::vector<double> reach(clusters, 0.0);
  std::vector<float> least(clusters, 1.0f);
  for (std::size_t i = 0; i < count; ++i) {
    const std::uint32_t k = assigned[i];
    reach[k] = std::max(reach[k], distance2(&rows[k * stride], &data[i * stride]));
    if (chosen[k] != i) least[k] = std::min(least[k], cosine(&rows[k * stride + 3], &data[i * stride + 3]));
  }
  for (std::uint32_t k = 0; k < clusters; ++k) {
    if (chosen[k] == GLEANER_NONE) continue;
    float* row = &rows[k * stride];
    if (lights) {
      for (unsigned c = 0; c < 3; ++c) {
        row[VPL_FLUX + c] = static_cast<float>(flux[3 * k + c]);
        row[VPL_SENT + c] = static_cast<float>(sent[3 * k + c]);
      }
      row[VPL_RADIUS] = static_cast<float>(std::sqrt(reach[k]));
      row[VPL_COS] = least[k];
      row[VPL_COUNT] = static_cast<float>(members[k]);
    } else {
      row[POINT_WEIGHT] = static_cast<float>(members[k]);
      row[POINT_COS] = least[k];
    }
  }
}

// The rows that there is something to cluster in. Throws Error::bad_input for places or fluxes that are not finite.
std::vector<float> read_data(const InputRows& input, bool lights) {
  const std::size_t stride = input.row_bytes() / 4;
  std::vector<float> data, row(stride);
  data.reserve(input.rows() * stride);
  input.visit(0, input.rows(), [&](std::uint64_t number, std::span<const std::byte> rows) {
    for (std::size_t at = 0; at < rows.size(); at += stride * 4, ++number) {
      std::memcpy(row.data(), &rows[at], stride * 4);
      std::uint32_t triangle = GLEANER_NONE;
      if (!lights) std::memcpy(&triangle, &row[POINT_TRIANGLE], 4);
      const bool holds =
          lights ? row[VPL_FLUX] > 0 || row[VPL_FLUX + 1] > 0 || row[VPL_FLUX + 2] > 0 : triangle != GLEANER_NONE;
      if (!holds) continue;
      for (std::size_t k = 0; k < 6; ++k)
        if (!(std::abs(row[k]) <= 2 * scene::kMaxCoordinate))
          input.fail(number, "position and normal", "finite numbers of a scene's size", std::to_string(row[k]));
      data.insert(data.end(), row.begin(), row.end());
    }
  });
  return data;
}

ClusterParameters read_parameters(const StageRun& run, bool lights) {
  const auto p = run.parameters<ClusterParameters>();
  const std::uint64_t all = p.clusters + (lights ? (std::uint64_t{p.lights} + VPL_WORDS - 1) / VPL_WORDS : 0);
  if (run.first != 0 || run.count != all || p.clusters == 0 || p.clusters > (1u << 24))
    throw Error::bad_input(run.where(), "items", "all of its clusters, 1 to 2^24, and the rows of what is in them",
                           std::to_string(run.first) + " + " + std::to_string(run.count));
  if (p.iterations > 1000 || !(p.least_cosine >= -1 && p.least_cosine <= 1))
    throw Error::bad_input(run.where(), "parameters", "at most 1000 iterations, a cosine", "other numbers");
  return p;
}

// Of clusters of points, those that have members: an item has one record or none.
void drop_empty(std::vector<float>& rows, std::uint64_t clusters, std::vector<std::uint32_t>& counts) {
  std::size_t to = 0;
  for (std::uint64_t k = 0; k < clusters; ++k) {
    std::uint32_t triangle = GLEANER_NONE;
    std::memcpy(&triangle, &rows[k * POINT_WORDS + POINT_TRIANGLE], 4);
    counts.push_back(triangle != GLEANER_NONE ? 1 : 0);
    if (triangle == GLEANER_NONE) continue;
    std::copy_n(&rows[k * POINT_WORDS], POINT_WORDS, &rows[to]);
    to += POINT_WORDS;
  }
  rows.resize(to);
}

}  // namespace

BatchResult run_cluster_stage(const StageRun& run) {
  const bool lights = run.task.kind == "vpl_cluster";
  const ClusterParameters parameters = read_parameters(run, lights);
  const std::size_t stride = lights ? VPL_WORDS : POINT_WORDS;
  const InputRows input(run.task, lights ? "lights" : "points", stride * 4);
  const double start = seconds_now();
  const std::vector<float> data = read_data(input, lights);
  const std::size_t held = data.size() / stride;
  if (lights && held != parameters.lights)
    throw Error::bad_input(run.where(), "input lights", std::to_string(parameters.lights) + " rows of some flux",
                           std::to_string(held));
  std::vector<float> rows(run.count * stride, 0.0f);
  if (!lights)
    for (std::size_t k = 0; k < run.count; ++k) std::memset(&rows[k * stride + POINT_TRIANGLE], 0xff, 4);
  std::vector<std::uint32_t> assigned(held);
  if (held <= parameters.clusters) {
    // As many clusters as there is to cluster: each is its own cluster, exactly.
    std::copy(data.begin(), data.end(), rows.begin());
    std::iota(assigned.begin(), assigned.end(), 0u);
  } else {
    KMeans means(run, data, stride,
                 {.clusters = parameters.clusters,
                  .iterations = parameters.iterations,
                  .least_cosine = parameters.least_cosine});
    assigned = means.run(seeds_along_curve(data, stride, parameters.clusters));
    write_clusters(means, assigned, data, stride, parameters.clusters, parameters.random_representative, rows);
  }
  if (lights) std::memcpy(&rows[parameters.clusters * stride], assigned.data(), held * 4);
  BatchResult result;
  if (!lights) drop_empty(rows, parameters.clusters, result.counts);
  result.records.resize(rows.size() * 4);
  if (!rows.empty()) std::memcpy(result.records.data(), rows.data(), result.records.size());
  result.counters.seconds = seconds_now() - start;
  result.counters.kernel_seconds = result.counters.seconds;
  return result;
}

}  // namespace gleaner::worker

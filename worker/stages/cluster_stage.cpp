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
#include "worker/stages/cluster_grid.h"
#include "worker/stages/curve.h"
#include "worker/wavefront/counters.h"
#include "worker/wavefront/input_rows.h"

namespace gleaner::worker {
namespace {

using kernels::ClusterParameters;

constexpr std::uint32_t kAssignItems = 1u << 13;  // data a launch
constexpr std::size_t kCentroidWords = 8;

double distance2(const float* a, const float* b) {
  double sum = 0;
  for (int k = 0; k < 3; ++k) sum += (double{a[k]} - b[k]) * (double{a[k]} - b[k]);
  return sum;
}

float cosine(const float* a, const float* b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

class KMeans {
 public:
  KMeans(const StageRun& run, const std::vector<float>& data, std::size_t stride, const ClusterParameters& parameters)
      : device_(run.device),
        workspace_(run.workspace),
        data_(data),
        stride_(stride),
        count_(data.size() / stride),
        parameters_(parameters),
        queue_(run.device.make_queue()),
        kernel_(run.device, run.build_plain("cluster.cl", " -D FUZZINESS=1"), "cluster_assign") {
    const std::size_t room = (count_ + 15) / 16 * 16;
    data_buffer_ = workspace_.take("cluster.data", (data.size() + 16) * 4);
    queue_.enqueueWriteBuffer(data_buffer_, CL_TRUE, 0, data.size() * 4, data.data());
    assigned_buffer_ = workspace_.take("cluster.assigned", room * 4);
    assigned_.resize(count_);
  }

  // For each datum, the row of its cluster.
  const std::vector<std::uint32_t>& run() {
    seed();
    for (std::uint32_t i = 0; i < parameters_.iterations; ++i) {
      assign();
      update();
    }
    assign();
    adopt();
    return assigned_;
  }

  const float* centroid(std::uint32_t k) const { return &centroids_[k * kCentroidWords]; }

 private:
  const float* datum(std::size_t i) const { return &data_[i * stride_]; }

  // Evenly spaced along a curve that visits the data side by side and, within a side, place by place: every side gets
  // its share of the clusters, every place its share of the side's.
  void seed() {
    const std::vector<std::uint32_t> order = curve_order(data_, stride_, 1024, true);
    centroids_.assign(parameters_.clusters * kCentroidWords, 0.0f);
    for (std::uint64_t k = 0; k < parameters_.clusters; ++k)
      std::copy_n(datum(order[(2 * k + 1) * count_ / (2 * parameters_.clusters)]), 6, &centroids_[k * kCentroidWords]);
    alive_.assign(parameters_.clusters, true);
  }

  void assign() {
    const ClusterGrid grid = make_cluster_grid(centroids_, kCentroidWords, alive_);
    const auto put = [&](const char* name, const auto& values) {
      cl::Buffer buffer = workspace_.take(name, values.size() * 4);
      queue_.enqueueWriteBuffer(buffer, CL_TRUE, 0, values.size() * 4, values.data());
      return buffer;
    };
    kernel_.set("data", data_buffer_)
        .set("stride", static_cast<cl_uint>(stride_))
        .set("grid", put("cluster.grid", grid.header))
        .set("cells", put("cluster.cells", grid.cells))
        .set("seeds", put("cluster.seeds", grid.seeds))
        .set("least_cosine", parameters_.least_cosine)
        .set("assigned", assigned_buffer_);
    for (std::size_t base = 0; base < count_; base += kAssignItems) {
      kernel_.set("base", static_cast<cl_uint>(base))
          .set("count", static_cast<cl_uint>(std::min<std::size_t>(kAssignItems, count_ - base)));
      kernel_.launch(queue_, {.work = kAssignItems, .capacity = kAssignItems, .per_item = device_.lanes()});
    }
    queue_.enqueueReadBuffer(assigned_buffer_, CL_TRUE, 0, count_ * 4, assigned_.data());
  }

  // New centroids: means in the data's order, so that any device's floats add up alike. A cluster without members
  // begins anew at a datum that no cluster takes, if there is one.
  void update() {
    std::vector<double> sums(parameters_.clusters * 6, 0.0);
    std::vector<std::uint32_t> members(parameters_.clusters, 0);
    std::vector<std::uint32_t> strays;
    for (std::size_t i = 0; i < count_; ++i) {
      const std::uint32_t k = assigned_[i];
      if (k == GLEANER_NONE) {
        strays.push_back(static_cast<std::uint32_t>(i));
        continue;
      }
      ++members[k];
      for (int c = 0; c < 6; ++c) sums[6 * k + c] += datum(i)[c];
    }
    std::vector<std::uint32_t> empty;
    for (std::uint32_t k = 0; k < parameters_.clusters; ++k) {
      if (members[k] == 0) {
        empty.push_back(k);
        continue;
      }
      float* centroid = &centroids_[k * kCentroidWords];
      for (int c = 0; c < 3; ++c) centroid[c] = static_cast<float>(sums[6 * k + c] / members[k]);
      const double length = std::sqrt(sums[6 * k + 3] * sums[6 * k + 3] + sums[6 * k + 4] * sums[6 * k + 4] +
                                      sums[6 * k + 5] * sums[6 * k + 5]);
      // Members are within the threshold of one normal, so that their mean has a length.
      if (length > 0)
        for (int c = 3; c < 6; ++c) centroid[c] = static_cast<float>(sums[6 * k + c] / length);
    }
    for (std::size_t e = 0; e < empty.size(); ++e) {
      const bool again = e < strays.size();
      alive_[empty[e]] = again;
      // Spread over the strays: neighbours among them need one cluster between them.
      if (again)
        std::copy_n(datum(strays[e * strays.size() / std::min(empty.size(), strays.size())]), 6,
                    &centroids_[empty[e] * kCentroidWords]);
    }
  }

  // Data that no cluster within the threshold is near to: a cluster without members where there is one, else the
  // nearest, whatever its normal. No light is lost.
  void adopt() {
    std::vector<std::uint32_t> members(parameters_.clusters, 0);
    for (auto k : assigned_)
      if (k != GLEANER_NONE) ++members[k];
    std::uint32_t next = 0;
    for (std::size_t i = 0; i < count_; ++i) {
      if (assigned_[i] != GLEANER_NONE) continue;
      double nearest = std::numeric_limits<double>::infinity();
      std::uint32_t best = GLEANER_NONE;
      for (int pass = 0; pass < 2 && best == GLEANER_NONE; ++pass) {
        for (std::uint32_t k = 0; k < parameters_.clusters; ++k) {
          if (members[k] == 0) continue;
          const float* c = centroid(k);
          if (pass == 0 && !(cosine(c + 3, datum(i) + 3) > parameters_.least_cosine)) continue;
          const double d = distance2(c, datum(i));
          if (d < nearest) {
            nearest = d;
            best = k;
          }
        }
        while (next < parameters_.clusters && members[next] != 0) ++next;
        if (best == GLEANER_NONE && next < parameters_.clusters) {
          best = next;
          std::copy_n(datum(i), 6, &centroids_[next * kCentroidWords]);
        }
      }
      assigned_[i] = best;
      ++members[best];
    }
  }

  const Device& device_;
  Workspace& workspace_;
  const std::vector<float>& data_;
  std::size_t stride_, count_;
  ClusterParameters parameters_;
  cl::CommandQueue queue_;
  Kernel kernel_;
  cl::Buffer data_buffer_, assigned_buffer_;
  std::vector<float> centroids_;  // kCentroidWords each
  std::vector<bool> alive_;
  std::vector<std::uint32_t> assigned_;
};

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
    KMeans means(run, data, stride, parameters);
    assigned = means.run();
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

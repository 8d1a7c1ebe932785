#include "worker/stages/k_means.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <string>

#include "worker/stages/cluster_grid.h"
#include "worker/wavefront/wanted.h"

namespace gleaner::worker {
namespace {

constexpr std::uint32_t kAssignItems = 1u << 13;  // data a launch

// Where clusters differ in size, those about a datum may be few: wider cells.
double seeds_per_cell(ClusterMetric metric) { return metric == ClusterMetric::distance ? 3 : 16; }

std::string options_of(ClusterMetric metric) {
  return metric == ClusterMetric::distance ? " -D FUZZINESS=1" : " -D FUZZINESS=1 -D WITH_NORMALS";
}

}  // namespace

double distance2(const float* a, const float* b) {
  double sum = 0;
  for (int k = 0; k < 3; ++k) sum += (double{a[k]} - b[k]) * (double{a[k]} - b[k]);
  return sum;
}

float cosine(const float* a, const float* b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

double cluster_error2(ClusterMetric metric, const float* datum, const float* centroid) {
  const double place = distance2(datum, centroid);
  if (metric == ClusterMetric::distance) return place;
  const double error = std::sqrt(place) + std::sqrt(distance2(datum + 3, centroid + 3));
  return error * error;
}

KMeans::KMeans(const StageRun& run, const std::vector<float>& data, std::size_t stride, const KMeansSettings& settings)
    : device_(run.device),
      workspace_(run.workspace),
      data_(data),
      stride_(stride),
      count_(data.size() / stride),
      settings_(settings),
      queue_(run.device.make_queue()),
      kernel_(run.device, run.build_plain("cluster.cl", options_of(settings.metric)), "cluster_assign") {
  const std::size_t room = (count_ + 15) / 16 * 16;
  data_buffer_ = workspace_.take("cluster.data", (data.size() + 16) * 4);
  queue_.enqueueWriteBuffer(data_buffer_, CL_TRUE, 0, data.size() * 4, data.data());
  assigned_buffer_ = workspace_.take("cluster.assigned", room * 4);
  assigned_.resize(count_);
}

const std::vector<std::uint32_t>& KMeans::run(std::span<const std::uint32_t> seeds) {
  centroids_.assign(settings_.clusters * kCentroidWords, 0.0f);
  for (std::size_t k = 0; k < settings_.clusters; ++k) std::copy_n(datum(seeds[k]), 6, &centroids_[k * kCentroidWords]);
  alive_.assign(settings_.clusters, true);
  for (std::uint32_t i = 0; i < settings_.iterations; ++i) {
    check_wanted();
    assign();
    update();
  }
  assign();
  adopt();
  return assigned_;
}

void KMeans::assign() {
  const ClusterGrid grid = make_cluster_grid(centroids_, kCentroidWords, alive_, seeds_per_cell(settings_.metric));
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
      .set("least_cosine", settings_.least_cosine)
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
void KMeans::update() {
  std::vector<double> sums(settings_.clusters * 6, 0.0);
  std::vector<std::uint32_t> members(settings_.clusters, 0);
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
  for (std::uint32_t k = 0; k < settings_.clusters; ++k) {
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
void KMeans::adopt() {
  std::vector<std::uint32_t> members(settings_.clusters, 0);
  for (auto k : assigned_)
    if (k != GLEANER_NONE) ++members[k];
  std::uint32_t next = 0;
  for (std::size_t i = 0; i < count_; ++i) {
    if (assigned_[i] != GLEANER_NONE) continue;
    double nearest = std::numeric_limits<double>::infinity();
    std::uint32_t best = GLEANER_NONE;
    for (int pass = 0; pass < 2 && best == GLEANER_NONE; ++pass) {
      for (std::uint32_t k = 0; k < settings_.clusters; ++k) {
        if (members[k] == 0) continue;
        const float* c = centroid(k);
        if (pass == 0 && !(cosine(c + 3, datum(i) + 3) > settings_.least_cosine)) continue;
        const double d = cluster_error2(settings_.metric, datum(i), c);
        if (d < nearest) {
          nearest = d;
          best = k;
        }
      }
      while (next < settings_.clusters && members[next] != 0) ++next;
      if (best == GLEANER_NONE && next < settings_.clusters) {
        best = next;
        std::copy_n(datum(i), 6, &centroids_[next * kCentroidWords]);
      }
    }
    assigned_[i] = best;
    ++members[best];
  }
}

}  // namespace gleaner::worker

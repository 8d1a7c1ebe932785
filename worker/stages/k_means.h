#pragma once
// k-means of points on surfaces: seeds and metric are the caller's. The assignment step runs on the device
// (kernels/cluster.cl); sums are made on the host, in the data's order, so that any device's floats add up alike.

#include <cstdint>
#include <span>
#include <vector>

#include "worker/stages/stage.h"

namespace gleaner::worker {

// distance: the nearest centroid. distance_and_normal: eq. 2 of Wang et al. 2009, |x_i - x_k| + |n_i - n_k|, where the
// data's positions come multiplied by its alpha.
enum class ClusterMetric { distance, distance_and_normal };

struct KMeansSettings {
  std::uint32_t clusters = 0, iterations = 0;
  float least_cosine = -1;  // between a datum's normal and its centroid's
  ClusterMetric metric = ClusterMetric::distance;
};

double distance2(const float* a, const float* b);
float cosine(const float* a, const float* b);
// Of a datum from a centroid, squared.
double cluster_error2(ClusterMetric metric, const float* datum, const float* centroid);

class KMeans {
 public:
  // `data`: rows of `stride` words that begin with a position and a normal; more of them than clusters.
  KMeans(const StageRun& run, const std::vector<float>& data, std::size_t stride, const KMeansSettings& settings);

  // For each datum, the row of its cluster. `seeds`: the data that the clusters begin with.
  const std::vector<std::uint32_t>& run(std::span<const std::uint32_t> seeds);

  const float* centroid(std::uint32_t k) const { return &centroids_[k * kCentroidWords]; }

 private:
  static constexpr std::size_t kCentroidWords = 8;
  const float* datum(std::size_t i) const { return &data_[i * stride_]; }
  void assign();
  void update();
  void adopt();

  const Device& device_;
  Workspace& workspace_;
  const std::vector<float>& data_;
  std::size_t stride_, count_;
  KMeansSettings settings_;
  cl::CommandQueue queue_;
  Kernel kernel_;
  cl::Buffer data_buffer_, assigned_buffer_;
  std::vector<float> centroids_;  // kCentroidWords each
  std::vector<bool> alive_;
  std::vector<std::uint32_t> assigned_;
};

}  // namespace gleaner::worker

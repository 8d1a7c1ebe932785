#pragma once
// What the pixels' points will be told by the records of shading clusters, and how far that may be from what a gather
// of their own would find.

#include <span>
#include <vector>

#include "worker/stages/photon/reach_grid.h"
#include "worker/stages/splat/points.h"

namespace gleaner::worker {

// Of a point. Irradiance is the sum of the colours, W/m^2.
struct Predicted {
  double irradiance = 0;
  double off = 0;     // by what it may be off
  float nearest = 0;  // m: how far the nearest record is that the point reads; infinite where it reads none
};

class ClusterPrediction {
 public:
  // `records`: as they were gathered (read_cluster_records()). `noise`: of each, over its irradiance.
  ClusterPrediction(const std::vector<CacheRecord>& records, double noise);

  // A record as a point reads it.
  struct Read {
    std::uint32_t record;
    double weight;                   // of all that the point reads, their sum is 1
    double distance;                 // m
    std::array<double, 3> to, turn;  // from the record, m; n_record x n
  };
  // Thread-safe. `reads`: a thread's own, whose memory is used again.
  Predicted at(const SplatPoint& point, std::vector<Read>& reads) const;

 private:
  struct Said {
    double irradiance = 0, deviation = 0;  // the latter: of what the records say, each by its gradients
    double distance = 0;                   // m: of the records in the mean
  };

  void read(const std::array<float, 3>& position, const std::array<float, 3>& normal, std::uint32_t all_but,
            std::vector<Read>& reads) const;
  Said said(std::span<const Read> reads) const;

  // A record's irradiance and gradients, of the colours' sum.
  struct Sums {
    double irradiance = 0;
    std::array<double, 3> rotation{}, translation{};
  };

  double noise_;
  std::vector<CacheRecord> records_;  // smoothed
  std::vector<Sums> sums_;            // of these
  // Where a record is, m, and the squared distance from which on no point reads it.
  struct Extent {
    std::array<float, 3> position;
    float squared_reach;
  };
  std::vector<Extent> extents_;
  ReachGrid grid_;
  struct LeftOut {
    double residual = 0;  // what the others say of the record's place, less what was gathered there; without noise
    double distance = 0;  // m: of these, in the mean
    double radius = 0;    // m: its own R, as it was gathered
  };
  std::vector<LeftOut> left_out_;
};

}  // namespace gleaner::worker

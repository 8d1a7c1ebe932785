#pragma once
// Which numbers of virtual point lights (VPLs) and of clusters to take: predictions from what a pilot measured
// (kernels/vpl_host_records.h, worker/stages/vpl/pilot.cpp), and the choice among them. Pure.
//
// Squared errors are means over the picture's pixels, in radiance squared, of the VPLs' light alone.

#include <array>
#include <cstdint>
#include <optional>
#include <vector>

#include "kernels/vpl_host_records.h"

namespace gleaner::coordinator {

// Work, in samples of paths (0.1 us on two cores); measured on the Cornell boxes and on sponza.
struct VplWork {
  static constexpr double path = 2;        // a light path
  static constexpr double light = 27;      // a VPL is drawn and clustered, on one worker
  static constexpr double point = 8;       // so is a point
  static constexpr double pair = 0.15;     // a point cluster queries a light
  static constexpr double shade = 0.003;   // a pixel and a light
  static constexpr double sample = 0.9;    // a pixel's sample of the VPLs' light
  static constexpr double residual = 0.3;  // a light that a point queries itself
};

class VplPilot {
 public:
  // Throws Error::failed for facts that are not finite or not possible.
  VplPilot(const kernels::VplPilotFacts& facts, const std::array<double, kernels::VplPilotShape::bounds>& bounds);

  // Bounds of the geometry term, 1/m^2, rising.
  const std::array<double, kernels::VplPilotShape::bounds>& bounds() const { return bounds_; }
  // The bound nearest to this one, as a ratio.
  std::size_t nearest_bound(double bound) const;
  // Mean radiance, over all pixels, of the VPLs' light with the k-th bound.
  double mean(std::size_t k) const { return facts_.mean[k]; }
  // Variance that `count` VPLs have, each queried by every point. Exact for VPLs drawn independently by their flux.
  double lights_error(std::size_t k, double count) const { return facts_.per_light[k] / count; }
  // Of so many clusters of the VPLs, each queried by every point and shining from the member in its middle, or
  // (`drawn`) from one drawn by flux, when it is a variance. What is near a cluster (NEAR_RADII) is lit by its members,
  // but they all count as seen where that one is: errors are in proportion to what they would be without.
  double clusters_error(std::size_t k, double clusters, bool drawn) const;
  // Of so many clusters, lights that a point looks at on average: those that are near are looked at member by member.
  double looked_at(double clusters) const;
  struct Split {
    double common = 0;      // the same in every pass
    double stochastic = 0;  // a variance: falls as one over the number of passes
  };
  // Of visibility by the six nearest point clusters (eq. 9, 10), one to so many of the points given, towards so many
  // lights; `threshold` as VplPointParameters' residual threshold.
  Split points_error(double spacing, double lights, double threshold) const;
  // Lights that a pixel queries itself in each pass, on average.
  double queries(double spacing, double threshold) const;
  // Of camera paths beside the VPLs of the k-th bound.
  kernels::VplPilotFacts::Paths paths(std::size_t k) const;

 private:
  kernels::VplPilotFacts::Spacing at(double spacing) const;

  kernels::VplPilotFacts facts_;
  std::array<double, kernels::VplPilotShape::bounds> bounds_;
};

struct VplCounts {
  std::uint32_t count = 0, clusters = 0, point_clusters = 0, passes = 1;  // clusters 0: as many as VPLs
  double residual_threshold = 0;
  std::size_t bound = 0;  // which one of the pilot's
};

// What to choose from, and for what.
struct VplTarget {
  double pixels = 0;
  double points = 0;                       // rows that the pilot was given
  double spp = 0;                          // samples a pixel; where error > 0, these are chosen too
  double error = 0;                        // RMSE over the mean radiance of the whole picture; 0: none
  std::uint32_t made = 0;                  // VPLs that there are to draw from
  std::uint32_t samples = 1;               // of a pixel and pass
  std::uint32_t usual_point_clusters = 0;  // others are so many times as many
  bool denoised = false;                   // paths' noise is taken out of the picture
  // Shadows that none of the pilot's points meets are found by what points query themselves.
  double most_residual_threshold = 0.2;
  // What was set, and stays.
  std::optional<std::uint32_t> count, clusters, point_clusters, passes;
  std::optional<double> residual_threshold;
  std::optional<double> clamp;  // 1/m^2: the bound
};

struct VplPrediction {
  VplCounts counts;
  double lights = 0, clusters = 0, points = 0, paths = 0;  // squared errors, before a denoiser's work
  double mean = 0;                                         // of the whole picture
  double vpl_mean = 0;                                     // of the VPLs' light
  double spp = 0;
  double cost = 0;  // of all, in samples of paths

  double vpl() const { return lights + clusters + points; }
};

// The counts of a coarse grid (factors of 1.5 or 2 between neighbours) whose error falls most for their work. Where
// samples are given: as many as make the next unit of work worth the same, spent on VPLs or on samples. Where an error
// is: the least work that meets it, the VPLs' part counted kVplCaution times. A denoiser takes away the paths' noise,
// and not what VPLs are off by, which is as smooth as light itself: then more of the work goes to VPLs.
inline constexpr double kVplCaution = 2.5;
inline constexpr double kLeastChosen = 4000;  // VPLs of a pass
VplPrediction choose_vpl(const VplPilot& pilot, const VplTarget& target);
// The errors and work of given counts, by the same model.
VplPrediction predict_vpl(const VplPilot& pilot, const VplTarget& target, const VplCounts& counts);

}  // namespace gleaner::coordinator

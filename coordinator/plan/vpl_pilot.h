#pragma once
// What a few points of the picture tell of the errors that numbers of virtual point lights (VPLs) and of clusters would
// leave, and which numbers to take. Pure: the plan asks for the visibility.
//
// Light and albedo are taken for grey (the mean of the channels). Squared errors are means over the picture's pixels,
// in radiance squared, of the VPLs' light alone. Lights that clusters stand for are runs of neighbours along a curve,
// point clusters are points of the same spacing: stand-ins, whose errors are those of the clusters that are made within
// a factor of about two (`bench/vpl pilot` shows both).

#include <array>
#include <cstdint>
#include <optional>
#include <vector>

#include "scene/model/blob.h"

namespace gleaner::coordinator {

using scene::Bytes;

class VplPilot {
 public:
  static constexpr std::uint32_t kPoints = 160;       // that stand for the picture
  static constexpr std::uint32_t kLights = 64;        // that they ask, a multiple of 32
  static constexpr std::uint32_t kNeighbours = 6;     // that stand for the point clusters a point belongs to
  static constexpr std::uint32_t kMeanPoints = 2048;  // at most, that tell the mean
  // Points to a cluster, of the points given: neighbours are looked for at these spacings, others are read between
  // them.
  static constexpr std::array<std::uint32_t, 3> kSpacings = {2, 8, 32};
  // Clusters of lights: powers of two from 2^kFirstLevel on.
  static constexpr std::uint32_t kFirstLevel = 4, kLevels = 10;

  // lights: rows of VPL_WORDS words; points: rows of POINT_WORDS words, spread evenly over the picture's pixels, those
  // of triangle GLEANER_NONE included; bounds: of the geometry term, 1/m^2, rising. empty() where no light shines or no
  // point is there.
  VplPilot(const std::vector<float>& lights, const std::vector<float>& points, std::vector<double> bounds);

  bool empty() const { return asked_points_.empty(); }
  // What stage `vpl_visibility` is to be asked: kLights rows of VPL_WORDS words, and rows of POINT_WORDS words.
  const std::vector<float>& asked_lights() const { return asked_lights_; }
  const std::vector<float>& asked_points() const { return asked_points_; }
  // The stage's records. Throws Error::failed where they are of another size. All below counts from then on.
  void answer(const Bytes& records);

  const std::vector<double>& bounds() const { return bounds_; }
  // The bound nearest to this one, as a ratio.
  std::size_t nearest_bound(double bound) const;
  // Mean radiance, over all pixels, of the VPLs' light with the k-th bound.
  double mean(std::size_t k) const { return mean_[k]; }
  // Variance that `count` VPLs have, each asked by every point. Exact for lights drawn independently by their flux.
  double lights_error(std::size_t k, double count) const { return per_light_[k] / count; }
  // Of so many clusters of the lights, each asked by every point and shining from the member in its middle, or
  // (`drawn`) from one drawn by flux, when it is a variance. What is near a cluster (NEAR_RADII) is lit by its members,
  // but they all count as seen where that one is: errors are in proportion to what they would be without.
  double clusters_error(std::size_t k, double clusters, bool drawn) const;
  // Of so many clusters, lights that a point looks at on average: those that are near are looked at member by member.
  double looked_at(double clusters) const;
  struct Split {
    double common = 0;  // the same in every set
    double by_lot = 0;  // a variance: falls as one over the number of sets
  };
  // Of visibility by the six nearest point clusters (eq. 9, 10), one to so many of the points given, towards so many
  // lights; `doubt` as in VplPointParameters.
  Split points_error(double spacing, double lights, double doubt) const;
  // Lights that a pixel asks itself in each set, on average.
  double asked(double spacing, double doubt) const;

 private:
  struct Spacing {
    double coherent = 0;  // squared error of all lights' light, if lights were endlessly many
    double single = 0;    // the rest, for one light in place of all
    double disputed = 0;  // mean over points of light squared times the share of it that is told wrong, squared a light
    double asked = 0;     // lights that a point asks itself, times doubt
  };
  void choose_points(const std::vector<float>& points);
  void measure_lights(const std::vector<float>& lights);
  void measure_mean(const std::vector<float>& points);
  Spacing at(double spacing) const;

  std::vector<double> bounds_;
  std::vector<float> asked_lights_, asked_points_;
  std::uint32_t pilots_ = 0;
  double coverage_ = 0;  // points that are there, of all
  double flux_ = 0;      // that each of the asked lights stands for, W/sr
  // By bound, for unshadowed light until answer(): means over the pixels.
  std::vector<double> mean_, per_light_;
  std::vector<std::array<double, kLevels>> middle_, drawn_;
  std::array<double, kLevels> looked_{};
  std::array<Spacing, kSpacings.size()> spacings_{};
};

// What paths do beside the VPLs, with each bound: the variance of one sample a pixel and the mean radiance.
struct PathForecast {
  double variance = 0, mean = 0;
};

struct VplCounts {
  std::uint32_t count = 0, clusters = 0, point_clusters = 0, sets = 1;  // clusters 0: as many as lights
  double doubt = 0;
  std::size_t bound = 0;  // which one of the pilot's
};

// What to choose from, and for what.
struct VplWish {
  double pixels = 0;
  double points = 0;                       // rows that the pilot was given
  double spp = 0;                          // samples a pixel; where target > 0, these are chosen too
  double target = 0;                       // RMSE over the mean radiance of the whole picture; 0: none
  std::uint32_t made = 0;                  // lights that there are to draw from
  std::uint32_t samples = 1;               // of a pixel and set
  std::uint32_t usual_point_clusters = 0;  // others are so many times as many
  double most_doubt = 0.2;  // shadows that none of the pilot's points meets are found by what points ask themselves
  // What was set, and stays.
  std::optional<std::uint32_t> count, clusters, point_clusters, sets;
  std::optional<double> doubt;
  std::optional<double> clamp;  // 1/m^2: the bound
};

struct VplForecast {
  VplCounts counts;
  double lights = 0, clusters = 0, points = 0, paths = 0;  // squared errors
  double mean = 0;                                         // of the whole picture
  double vpl_mean = 0;                                     // of the VPLs' light
  double spp = 0;
  double cost = 0;  // of all, in samples of paths

  double vpl() const { return lights + clusters + points; }
};

// The counts of a coarse grid (factors of 1.5 or 2 between neighbours) whose error falls most for their work. Where
// samples are given: as many as make the next unit of work worth the same, spent on VPLs or on samples. Where a target
// is: the least work that meets it, the VPLs' part counted kVplCaution times.
inline constexpr double kVplCaution = 2.5;
VplForecast choose_vpl(const VplPilot& pilot, const std::vector<PathForecast>& paths, const VplWish& wish);
// The errors and work of given counts, by the same reckoning.
VplForecast forecast_vpl(const VplPilot& pilot, const std::vector<PathForecast>& paths, const VplWish& wish,
                         const VplCounts& counts);

}  // namespace gleaner::coordinator

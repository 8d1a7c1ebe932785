#include "coordinator/plan/vpl_pilot.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>
#include <string>

#include "coordinator/plan/noise_left.h"
#include "kernels/vpl_records.h"
#include "scene/model/error.h"

namespace gleaner::coordinator {
namespace {

using kernels::VplPilotFacts;
using Shape = kernels::VplPilotShape;

// Fitted by `bench/vpl pilot` on its four scenes: squares as measured over squares of the stand-ins. VPLs are not drawn
// independently: a light path leaves several, of its colour. Residual samples are taken at equal steps, not
// independently.
constexpr double kLightsFitted = 3.6, kMiddleFitted = 1.0, kDrawnFitted = 1.6, kPointsFitted = 1.0;
constexpr double kResidualFitted = 0.45;

// What VPLs leave is smooth, seen for longer than noise of the same strength, and predicted less surely than it. A
// denoiser takes none of it out: it is what frames of other seeds flicker by.
constexpr double kVplWeight = 3, kVplWeightDenoised = 10;
// Samples of a pixel for each pass, at least.
constexpr double kSamplesAPass = 16, kSamplesAPassDenoised = 2;

// Samples a pixel that leave this squared error of a sample's `variance`.
double samples_for(double variance, double error, bool denoised) {
  const double all = variance / error;
  // kNoiseLeft sqrt(spp) variance / spp = error, where that is less than the noise itself.
  return denoised ? std::min(all, std::pow(kNoiseLeft * all, 2)) : all;
}

// Between values at rising x, both in proportion; beyond the ends the last ones' slope.
double between(double x0, double y0, double x1, double y1, double x) {
  if (!(y0 > 0) || !(y1 > 0)) return std::max(0.0, x < std::sqrt(x0 * x1) ? y0 : y1);
  return y0 * std::pow(y1 / y0, std::log(x / x0) / std::log(x1 / x0));
}

// Of a table at 2^first_level, 2^(first_level + 1), ...
double at_level(const double* table, double clusters) {
  const double level = std::clamp(std::log2(clusters) - Shape::first_level, 0.0, Shape::levels - 1.0);
  const auto low = std::min<std::size_t>(static_cast<std::size_t>(level), Shape::levels - 2);
  const double x0 = std::exp2(static_cast<double>(low)), x = clusters / std::exp2(Shape::first_level);
  return between(x0, table[low], 2 * x0, table[low + 1], x);
}

}  // namespace

VplPilot::VplPilot(const VplPilotFacts& facts, const std::array<double, Shape::bounds>& bounds)
    : facts_(facts), bounds_(bounds) {
  double numbers[sizeof facts / sizeof(double)];
  std::memcpy(numbers, &facts, sizeof facts);
  for (const double number : numbers)
    if (!(number >= 0) || !std::isfinite(number))
      throw Error::failed("stage vpl.pilot: a mean or a squared error of " + std::to_string(number) +
                          ", expected finite numbers that are not negative");
}

std::size_t VplPilot::nearest_bound(double bound) const {
  std::size_t best = 0;
  for (std::size_t k = 1; k < bounds_.size(); ++k)
    if (bound * bound > bounds_[k - 1] * bounds_[k]) best = k;
  return best;
}

double VplPilot::clusters_error(std::size_t k, double clusters, bool drawn) const {
  return drawn ? kDrawnFitted * at_level(facts_.drawn[k], clusters)
               : kMiddleFitted * at_level(facts_.middle[k], clusters);
}

double VplPilot::looked_at(double clusters) const { return at_level(facts_.looked, clusters); }

VplPilotFacts::Spacing VplPilot::at(double spacing) const {
  std::size_t low = 0;
  while (low + 2 < Shape::spacings && spacing > Shape::spacing[low + 1]) ++low;
  const double x0 = Shape::spacing[low], x1 = Shape::spacing[low + 1];
  const VplPilotFacts::Spacing &a = facts_.spacings[low], &b = facts_.spacings[low + 1];
  return {between(x0, a.coherent, x1, b.coherent, spacing), between(x0, a.single, x1, b.single, spacing),
          between(x0, a.disputed, x1, b.disputed, spacing), between(x0, a.queries, x1, b.queries, spacing)};
}

VplPilot::Split VplPilot::points_error(double spacing, double lights, double threshold) const {
  const VplPilotFacts::Spacing s = at(spacing);
  const double off = kPointsFitted * (s.coherent + s.single / lights), noise = kResidualFitted * threshold * s.disputed;
  if (!(threshold > 0)) return {off, 0};
  if (!(off + noise > 0)) return {};
  // The measured difference is subtracted in the proportion in which it exceeds its noise.
  const double taken = off / (off + noise);
  return {off * (1 - taken) * (1 - taken), noise * taken * taken};
}

double VplPilot::queries(double spacing, double threshold) const {
  return threshold > 0 ? std::min(at(spacing).queries / threshold, double{MAX_RESIDUAL_SAMPLES}) : 0;
}

// Between the least and the highest bound, as a power of them.
VplPilotFacts::Paths VplPilot::paths(std::size_t k) const {
  const VplPilotFacts::Paths &low = facts_.paths[0], &high = facts_.paths[1];
  const double t = std::log(bounds_[k] / bounds_.front()) / std::log(bounds_.back() / bounds_.front());
  const auto blend = [&](double a, double b) { return a > 0 && b > 0 ? a * std::pow(b / a, t) : a + t * (b - a); };
  return {blend(low.variance, high.variance), blend(low.mean, high.mean)};
}

VplPrediction predict_vpl(const VplPilot& pilot, const VplTarget& target, const VplCounts& counts) {
  VplPrediction f;
  f.counts = counts;
  // No more lights are drawn than there are.
  const double lights = std::min(counts.count, target.made);
  const double clusters = counts.clusters ? std::min<double>(counts.clusters, lights) : lights;
  const double passes = counts.passes;
  f.lights = kLightsFitted * pilot.lights_error(counts.bound, lights) / passes;
  if (clusters < lights) {
    // Where every light is a cluster of its own, none is off.
    const bool drawn = counts.passes > 1;
    f.clusters = pilot.clusters_error(counts.bound, clusters, drawn) * (1 - clusters / lights) / (drawn ? passes : 1);
  }
  double queries = clusters;
  if (counts.point_clusters) {
    const double spacing = target.points / counts.point_clusters;
    const VplPilot::Split split = pilot.points_error(spacing, clusters, counts.residual_threshold);
    f.points = split.common + split.stochastic / passes;
    queries = pilot.queries(spacing, counts.residual_threshold);
  }
  const VplPilotFacts::Paths paths = pilot.paths(counts.bound);
  f.vpl_mean = pilot.mean(counts.bound);
  f.mean = f.vpl_mean + paths.mean;
  const double work =
      passes *
          (lights * VplWork::light * (clusters < lights ? 1 : 0.2) + counts.point_clusters * clusters * VplWork::pair +
           target.pixels * ((clusters < lights ? pilot.looked_at(clusters) : lights) * VplWork::shade +
                            target.samples * VplWork::sample + queries * VplWork::residual)) +
      8 * VplWork::point * counts.point_clusters;
  f.spp = target.spp;
  if (target.error > 0) {
    // What the VPLs may not use is for samples to reach; a quarter is kept for them whatever the VPLs do.
    const double all = target.error * target.error * f.mean * f.mean;
    const double left = std::max(all - kVplCaution * f.vpl(), 0.25 * all);
    f.spp = left > 0 ? std::max(32.0, samples_for(paths.variance, left, target.denoised)) : 32.0;
  }
  f.paths = paths.variance / f.spp;
  f.cost = work + target.pixels * f.spp;
  return f;
}

namespace {

// What is set, else those of `values` from `least` to `most`, else the nearest to them.
std::vector<std::uint32_t> grid(const std::optional<std::uint32_t>& fixed, const std::vector<double>& values,
                                double least, double most) {
  if (fixed) return {*fixed};
  std::vector<std::uint32_t> list;
  for (const double v : values)
    if (v >= least && v <= most) list.push_back(static_cast<std::uint32_t>(v));
  if (list.empty()) list.push_back(static_cast<std::uint32_t>(std::max(1.0, std::min(most, values.front()))));
  return list;
}

// Of predictions, the one with the least value is taken.
double value_of(const VplPrediction& f, const VplTarget& target) {
  const double noise = target.denoised ? noise_left(f.spp) * f.paths : f.paths;
  if (target.error > 0) {
    // Where nothing meets the target, the nearest to it.
    const double all = target.error * target.error * f.mean * f.mean;
    const double over = (kVplCaution * f.vpl() + noise) / all;
    return over > 1.0001 ? f.cost * 1e6 * over * over : f.cost;
  }
  // Samples' variance falls as one over their number: that is what a sample more of all pixels is worth.
  const double weight = target.denoised ? kVplWeightDenoised : kVplWeight;
  return weight * f.vpl() + noise + noise / (target.pixels * target.spp) * f.cost;
}

}  // namespace

VplPrediction choose_vpl(const VplPilot& pilot, const VplTarget& target) {
  std::vector<double> clusters, points;
  for (double c = 256; c <= 8192; c *= 2) {
    clusters.push_back(c);
    clusters.push_back(1.5 * c);
  }
  for (const double factor : {0.125, 0.25, 0.5, 1.0, 2.0}) points.push_back(target.usual_point_clusters * factor);
  const double most_passes =
      target.error > 0 ? 64 : std::max(1.0, target.spp / (target.denoised ? kSamplesAPassDenoised : kSamplesAPass));
  const auto counts = grid(target.count, {kLeastChosen, 8000, 16000, 24000}, 1, target.made);
  const auto passes = grid(target.passes, {1, 2, 4, 8, 16, 32, 64}, 1, most_passes);
  const auto point_clusters = grid(target.point_clusters, points, 64, 1e9);
  std::vector<double> thresholds{target.residual_threshold.value_or(0.02)};
  for (const double threshold : {0.05, 0.1, 0.2})
    if (!target.residual_threshold && threshold <= target.most_residual_threshold) thresholds.push_back(threshold);
  VplPrediction best;
  double least = std::numeric_limits<double>::infinity();
  const auto consider = [&](const VplCounts& candidate) {
    const VplPrediction f = predict_vpl(pilot, target, candidate);
    const double value = value_of(f, target);
    if (best.counts.count && !(value < least)) return;
    least = value;
    best = f;
  };
  for (const std::uint32_t count : counts)
    for (const std::uint32_t c : grid(target.clusters, clusters, 1, count / 2))
      for (std::size_t bound = 0; bound < pilot.bounds().size(); ++bound) {
        if (target.clamp && bound != pilot.nearest_bound(*target.clamp > 0 ? *target.clamp : 1e300)) continue;
        for (const std::uint32_t p : point_clusters)
          for (const double threshold : thresholds)
            for (const std::uint32_t n : passes) consider({count, c, p, n, threshold, bound});
      }
  return best;
}

}  // namespace gleaner::coordinator

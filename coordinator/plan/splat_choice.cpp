#include "coordinator/plan/splat_choice.h"

#include <algorithm>
#include <bit>
#include <cmath>

#include "kernels/splat_records.h"

namespace gleaner::coordinator {
namespace {

// Fitted to cornell-box and sponza-dabrovic; `bench/splat choice` shows whether they hold. A sample a pixel of what the
// cache leaves to paths is noisy by so much of the picture's mean.
constexpr double kSampleError = 0.14;
constexpr double kLeastSamples = 16, kMostSamples = 4096;
// A time limit allows a cache as of so few samples, at least.
constexpr double kLimitedSamples = 1, kFewerSamples = 0.8;

// So is the cache where its records have a ray each and are smoothed, in a picture of which half the light is the
// cache's.
constexpr double kRayNoise = 0.4;
constexpr double kLeastRays = 64, kMostRays = 4096;
// Interpolation is off by so much of the cache's light with an accuracy of 1; by the square of less.
constexpr double kInterpolation = 0.34, kCacheShare = 0.5;
constexpr double kLeastAccuracy = 0.08, kMostAccuracy = 0.6;
// Squared error of interpolation in the picture, over the variance of what the records of a point say.
constexpr double kErrorOfSpread = 1.0;

// The noise of a ray over that of a sample, which the usual rays are right for: that of cornell-box at 512 x 512.
constexpr double kUsualNoise = 4;

// Of the picture's squared error, at most: the paths', noise of records, and what interpolation does wrong. A ray for a
// record would be worth as much as one for a pixel at 0.35; but its noise shows as blotches, which people see sooner
// than grain.
constexpr double kPathShare = 0.45, kNoiseShare = 0.2, kInterpolationShare = 0.2;
// Where the picture is denoised, rays for so many times less noise of records: at 8 samples the error of cornell-box
// falls from 2.5 to 1.8 % by that, for a sixth more time, and that of modern-hall from 6.6 to 6.3 % for a quarter.
constexpr double kDenoisedRays = 3;
// Beyond these another cache is made.
constexpr double kMostNoiseShare = 0.45, kMostInterpolationShare = 0.3, kMostStep = 16;

double accuracy_of(double accuracy) { return std::clamp(accuracy, kLeastAccuracy, kMostAccuracy); }

std::uint32_t rays_of(double rays) {
  return static_cast<std::uint32_t>(std::lround(std::clamp(rays, kLeastRays, kMostRays)));
}

double samples_of(const SplatTarget& target) {
  return target.error > 0
             ? std::clamp(std::pow(kSampleError / target.error, 2) / kPathShare, kLeastSamples, kMostSamples)
             : std::max(1u, target.spp);
}

double more_rays_of(const SplatTarget& target) { return target.denoised && !(target.error > 0) ? kDenoisedRays : 1; }

// `more_rays`: so many times the rays that samples of this number ask for.
SplatCounts counts_of(double samples, double more_rays, const GivenSplatCounts& given) {
  const double squared_error = kSampleError * kSampleError / (kPathShare * samples);
  SplatCounts counts;
  counts.rays = given.rays.value_or(rays_of(more_rays * kRayNoise * kRayNoise / (kNoiseShare * squared_error)));
  counts.accuracy = given.accuracy.value_or(
      accuracy_of(std::sqrt(std::sqrt(kInterpolationShare * squared_error) / (kCacheShare * kInterpolation))));
  counts.points = std::bit_floor(static_cast<std::uint32_t>(std::clamp(samples, 1.0, 16.0)));
  return counts;
}

}  // namespace

SplatCounts choose_splat_counts(const SplatTarget& target, const GivenSplatCounts& given) {
  return counts_of(samples_of(target), more_rays_of(target), given);
}

double usual_splat_records(double pixels, double accuracy) {
  const double usual = 27 * std::pow(pixels, 0.55);
  return accuracy > 0 ? std::min(pixels, usual * std::pow(0.15 / accuracy, 2)) : pixels;
}

// Rays are worth the most where the time they take and the error they leave weigh the same: where a record costs c
// times as much, sqrt(c) times fewer.
std::uint32_t splat_rays_of_many(double records, double pixels, const SplatCounts& counts) {
  const double more = records / usual_splat_records(pixels, counts.accuracy);
  return more > 1 ? std::min(counts.rays, rays_of(counts.rays / std::sqrt(more))) : counts.rays;
}

std::uint32_t splat_rays_beside(const CacheNoise& noise, const SplatCounts& counts) {
  return std::min(counts.rays, rays_of(counts.rays * worthwhile_part_of_rays(noise, kUsualNoise)));
}

SplatCounts splat_counts_within(double work, double pixels, const SplatTarget& target, const GivenSplatCounts& given) {
  double samples = samples_of(target);
  const double more_rays = more_rays_of(target);
  const SplatCounts asked = counts_of(samples, more_rays, given);
  SplatCounts counts = asked;
  while (samples > kLimitedSamples && usual_splat_records(pixels, counts.accuracy) * counts.rays > work)
    counts = counts_of(samples *= kFewerSamples, more_rays, given);
  counts.points = asked.points;
  return counts;
}

std::uint32_t splat_rays_within(double work, double records, std::uint32_t rays) {
  return records * rays > work ? std::min(rays, rays_of(work / records)) : rays;
}

double splat_interpolation_error(const kernels::SplatJudgeFacts& facts, double accuracy) {
  // Records of a point may agree and be wrong.
  const double usual = std::pow(kInterpolation * accuracy * accuracy * facts.mean, 2);
  return std::max(usual, kErrorOfSpread * facts.spread);
}

std::optional<SplatCounts> better_splat_counts(const SplatCounts& counts, const kernels::SplatJudgeFacts& facts,
                                               double squared_error, const GivenSplatCounts& given) {
  if (!(squared_error > 0)) return std::nullopt;
  SplatCounts better = counts;
  const double noise = facts.noise / squared_error,
               off = splat_interpolation_error(facts, counts.accuracy) / squared_error;
  if (!given.rays && noise > kMostNoiseShare)
    better.rays = rays_of(counts.rays * std::min(noise / kNoiseShare, kMostStep));
  // The square of what interpolation does wrong goes with the fourth power of the accuracy.
  if (!given.accuracy && off > kMostInterpolationShare)
    better.accuracy = accuracy_of(counts.accuracy / std::pow(std::min(off / kInterpolationShare, kMostStep), 0.25));
  if (better.rays == counts.rays && better.accuracy == counts.accuracy) return std::nullopt;
  return better;
}

}  // namespace gleaner::coordinator

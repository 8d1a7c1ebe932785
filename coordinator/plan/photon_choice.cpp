#include "coordinator/plan/photon_choice.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace gleaner::coordinator {
namespace {

// Fitted to cornell-box, the other Cornell boxes, modern-hall and white-room at 128x128 to 512x512 pixels. A direct
// sample a pixel is noisy by so much of the mean; errors fall as one over the root of the samples.
constexpr double kSampleError = 0.1;
constexpr double kLeastSamples = 4, kMostSamples = 1024;

// Shapes in a picture are the finer the more pixels it has along an edge: so are clusters. At kUsualSamples.
constexpr double kClustersOfAnEdge = 8, kUsualSamples = 16;
constexpr double kLeastClusters = 64, kMostClusters = 32768;
// A record is noisy by 2 % of its light with 384 rays, which its pixels share.
constexpr double kRaysOfASample = 24, kLeastRays = 96, kMostRays = 1024;

// The noise of a ray over that of a sample, which the usual rays are right for.
constexpr double kUsualNoise = 5;

// A light path costs two samples.
constexpr double kPathsOfASample = 1.0 / 8, kLeastPaths = 100'000, kMostPaths = 1'000'000;

// A cut is made in the time in which so many rays read photons, and it has to stand for more of these.
constexpr double kReadsOfACut = 200'000;
constexpr std::uint32_t kCut = 4096;
constexpr std::uint32_t kPhotonsOfACut = 50'000;

constexpr std::uint32_t kCausticPaths = 200'000, kSamplesOfAPass = 4, kLeastPasses = 2, kMostPasses = 64;

// Caustics are off in blotches and beside edges, which people see sooner than grain: their squared error counts for so
// many times itself.
constexpr double kBlotches = 4;

std::uint32_t whole(double number, double least, double most) {
  return static_cast<std::uint32_t>(std::lround(std::clamp(number, least, most)));
}

}  // namespace

PhotonCounts choose_photon_counts(std::uint64_t pixels, std::uint32_t spp, double error, bool takes_clusters,
                                  const GivenPhotonCounts& given) {
  const double samples =
      error > 0 ? std::clamp(std::pow(kSampleError / error, 2), kLeastSamples, kMostSamples) : std::max(1u, spp);
  const double all = static_cast<double>(pixels) * samples;
  PhotonCounts counts;
  counts.count = given.count.value_or(whole(all * kPathsOfASample, kLeastPaths, kMostPaths));
  counts.caustics = given.caustics.value_or(kCausticPaths);
  counts.passes = given.passes.value_or(whole(samples / kSamplesOfAPass, kLeastPasses, kMostPasses));
  const double finer = std::clamp(std::sqrt(samples / kUsualSamples), 0.5, 2.0);
  counts.clusters = given.clusters.value_or(
      whole(kClustersOfAnEdge * std::sqrt(static_cast<double>(pixels)) * finer, kLeastClusters, kMostClusters));
  if (!takes_clusters) counts.clusters = 0;
  counts.rays = given.rays.value_or(whole(kRaysOfASample * samples, kLeastRays, kMostRays));
  const bool clustered = counts.clusters > 0 && counts.rays > 0;
  const double reads = clustered ? static_cast<double>(counts.clusters) * counts.rays : all;
  counts.cut = given.cut.value_or(reads > kReadsOfACut && counts.count >= kPhotonsOfACut ? kCut : 0);
  return counts;
}

std::uint32_t photon_rays_beside(const CacheNoise& noise, const PhotonCounts& counts) {
  return std::min(counts.rays, whole(counts.rays * worthwhile_part_of_rays(noise, kUsualNoise), kLeastRays, kMostRays));
}

std::uint32_t worthwhile_passes(const CausticPasses& passes, std::uint32_t usual) {
  if (!(passes.sample_error > 0) || !(passes.pass_error >= 0) || usual <= kLeastPasses) return usual;
  const double paths = passes.sample_error * passes.sample_error / passes.samples;
  std::uint32_t best = usual;
  double least = std::numeric_limits<double>::infinity();
  for (std::uint32_t number = kLeastPasses; number <= usual; ++number) {
    const double error = paths + kBlotches * passes.pass_error * passes.pass_error * std::pow(number, -kShrinkage);
    const double cost = error * (passes.work + number * passes.pass_work);
    if (cost < least) least = cost, best = number;
  }
  return best;
}

}  // namespace gleaner::coordinator

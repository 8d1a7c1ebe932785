#pragma once
// How many photons, clusters, nodes of the cut and rays method `photon` takes where they are not set: such numbers that
// each part of the work costs about as much as the paths' samples, and none is off by more than these are noisy. Pure.

#include <cstdint>
#include <optional>

#include "coordinator/plan/cache_noise.h"

namespace gleaner::coordinator {

// Knaus & Zwicker 2011: of the variance of caustics' density, what a pass adds falls, and its bias shrinks, by this.
inline constexpr double kShrinkage = 2.0 / 3;

struct PhotonCounts {
  std::uint32_t count = 0, caustics = 0;  // light paths: of the map, and of each pass of caustics
  std::uint32_t passes = 1;
  std::uint32_t clusters = 0;  // 0: each sample gathers by itself
  std::uint32_t rays = 0;      // of a cluster's sample
  std::uint32_t cut = 0;       // nodes; 0: rays read photons
};

// What was set, and stays.
struct GivenPhotonCounts {
  std::optional<std::uint32_t> count{}, caustics{}, passes{}, clusters{}, rays{}, cut{};
};

// `spp`: samples of a pixel; where `error` > 0 (RMSE over the mean radiance of the picture), as many as paths are
// predicted to need for it beside photons. `takes_clusters`: whether the film is not too large for them.
PhotonCounts choose_photon_counts(std::uint64_t pixels, std::uint32_t spp, double error, bool takes_clusters,
                                  const GivenPhotonCounts& given);

// Rays of a cluster's sample, given what both kinds of rays are off by: fewer than `counts` has where paths are noisier
// beside clusters than there.
std::uint32_t photon_rays_beside(const CacheNoise& noise, const PhotonCounts& counts);

// What passes of caustics are worth beside the rest of the picture. Errors as radiance that the picture shows.
struct CausticPasses {
  double sample_error = 0;         // of a sample of a pixel (PathSampler::sample_error()); 0: not known
  double pass_error = 0;           // of the first pass's density estimates
  double samples = 0;              // of a pixel
  double work = 0, pass_work = 0;  // of all but the passes, and of each of these: in samples
};
// So many passes that the least is left of the squared error for the time: 2 to `usual`. They are as many as usual
// where nothing is known.
std::uint32_t worthwhile_passes(const CausticPasses& passes, std::uint32_t usual);

}  // namespace gleaner::coordinator

#pragma once
// How accurate a cache method `splat` takes where that is not set, and with how many rays: such that its records are
// noisy, and interpolation is off, by a part of what the paths beside it are. Pure.

#include <cstdint>
#include <optional>

#include "coordinator/plan/cache_noise.h"
#include "kernels/splat_records.h"

namespace gleaner::coordinator {

struct SplatCounts {
  double accuracy = 0;       // a; 0: a record at every point
  std::uint32_t rays = 0;    // of each record; 0: no cache
  std::uint32_t points = 1;  // of a pixel: a power of two
};

// What was set, and stays.
struct GivenSplatCounts {
  std::optional<double> accuracy{};
  std::optional<std::uint32_t> rays{};
};

// What the cache is for.
struct SplatTarget {
  std::uint32_t spp = 1;  // samples of a pixel; where `error` > 0, as many as paths are predicted to need for it
  double error = 0;       // RMSE over the mean radiance of the picture; 0: none
  bool denoised = false;  // paths' noise is taken out of the picture; that of records, wide blotches, is not
};

SplatCounts choose_splat_counts(const SplatTarget& target, const GivenSplatCounts& given);

// Records that rooms take: as cornell-box and modern-hall of 64 to 512 pixels have them. `accuracy` 0: one a pixel.
double usual_splat_records(double pixels, double accuracy);

// Rays of a record where there are so many of them: fewer where they are more than usual, since those near each other
// share their noise, and all of them together take as long as everything else of the picture.
std::uint32_t splat_rays_of_many(double records, double pixels, const SplatCounts& counts);

// Rays of a record, given that noise: fewer than `counts` has where paths are noisier beside the cache than there.
std::uint32_t splat_rays_beside(const CacheNoise& noise, const SplatCounts& counts);

// Counts of fewer samples: as many as have a cache of no more than `work` rays in all, or
// the coarsest one. `points` stay.
SplatCounts splat_counts_within(double work, double pixels, const SplatTarget& target, const GivenSplatCounts& given);

// Rays of so many records that are no more than `work` in all, and no fewer than make a picture.
std::uint32_t splat_rays_within(double work, double records, std::uint32_t rays);

// Squared error that interpolation with this accuracy makes in the picture (a mean over pixels and channels), after a
// look at the cache.
double splat_interpolation_error(const kernels::SplatJudgeFacts& facts, double accuracy);

// What a cache of these counts was found to be is known: counts that leave enough of `squared_error`, the whole
// picture's, to the paths. None: these do, or nothing may be changed.
std::optional<SplatCounts> better_splat_counts(const SplatCounts& counts, const kernels::SplatJudgeFacts& facts,
                                               double squared_error, const GivenSplatCounts& given);

}  // namespace gleaner::coordinator

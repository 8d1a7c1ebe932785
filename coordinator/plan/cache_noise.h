#pragma once
// How many rays the records of a cache are worth beside the samples of paths: methods `splat` and `photon` look at some
// records with few rays (record_look.h), and at the first samples of all pixels, before they gather all records. Pure.

#include <cstdint>
#include <span>

#include "kernels/splat_records.h"

namespace gleaner::coordinator {

// What both kinds of rays are off by, as radiance that the picture shows. 0: not known.
struct CacheNoise {
  double sample = 0;  // of paths: a sample of a pixel (PathSampler::sample_error())
  double ray = 0;     // of the cache: a ray of a record, before records are smoothed (ray_noise())
};

// Of records with so many rays each, rows of CACHE_WORDS words of which `word` is CACHE_NOISE, on surfaces of this
// albedo.
double ray_noise(std::span<const float> cache, std::uint32_t rays, double albedo, std::uint32_t word = CACHE_NOISE);

// The part of its usual rays that a record is worth: less than 1 where paths are noisier beside the cache than
// `usual` says, the noise of a ray over that of a sample.
double worthwhile_part_of_rays(const CacheNoise& noise, double usual);

}  // namespace gleaner::coordinator

// How many rays the records of a cache are worth beside the samples of paths.

#include "coordinator/plan/cache_noise.h"

#include <gtest/gtest.h>

#include <numbers>
#include <vector>

#include "kernels/splat_records.h"

namespace gleaner::coordinator {
namespace {

// Records tell by how much the halves of their rays differ.
TEST(CacheNoise, RecordsTellTheNoiseOfARay) {
  std::vector<float> cache(2 * CACHE_WORDS);
  for (const std::size_t at : {0u, CACHE_WORDS})
    for (std::size_t c = 0; c < 3; ++c) cache[at + CACHE_IRRADIANCE + c] = 3;
  cache[CACHE_NOISE] = 0.1f;
  cache[CACHE_WORDS + CACHE_NOISE] = -0.3f;
  EXPECT_NEAR(ray_noise(cache, 16, 0.5), 0.5 / std::numbers::pi * 3 * 0.2 * 4, 1e-6);
  cache[34] = 0.4f;
  EXPECT_NEAR(ray_noise(cache, 16, 0.5, 34), 0.5 / std::numbers::pi * 3 * 0.2 * 4, 1e-6);
  EXPECT_EQ(ray_noise({}, 16, 0.5), 0);
}

// Error of records and of paths: where paths are noisier than usual, the last rays of a record are worth less.
TEST(CacheNoise, NoisyPathsMakeRaysWorthLess) {
  EXPECT_EQ(worthwhile_part_of_rays({.sample = 0, .ray = 1}, 4), 1) << "not known";
  EXPECT_EQ(worthwhile_part_of_rays({.sample = 1, .ray = 0}, 4), 1) << "not known";
  EXPECT_EQ(worthwhile_part_of_rays({.sample = 1, .ray = 8}, 4), 1) << "quiet paths";
  EXPECT_NEAR(worthwhile_part_of_rays({.sample = 1, .ray = 2}, 4), 0.5, 1e-12);
  EXPECT_NEAR(worthwhile_part_of_rays({.sample = 2, .ray = 4}, 4), 0.5, 1e-12) << "the one beside the other";
  EXPECT_EQ(worthwhile_part_of_rays({.sample = 1e9, .ray = 1}, 4), 0.25) << "no fewer than a part";
}

}  // namespace
}  // namespace gleaner::coordinator

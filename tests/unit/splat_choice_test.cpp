// How method `splat` chooses accuracy and rays that are not set.

#include "coordinator/plan/splat_choice.h"

#include <gtest/gtest.h>

#include <cmath>

namespace gleaner::coordinator {
namespace {

using kernels::SplatJudgeFacts;

TEST(SplatChoice, WhatIsSetStays) {
  const SplatCounts counts = choose_splat_counts(64, 0.05, {.accuracy = 0, .rays = 7});
  EXPECT_EQ(counts.accuracy, 0);
  EXPECT_EQ(counts.rays, 7u);
  const SplatJudgeFacts bad{.pixels = 9, .mean = 1, .square = 1, .noise = 1, .spread = 1};
  EXPECT_FALSE(better_splat_counts(counts, bad, 0.01, {.accuracy = 0, .rays = 7}));
}

TEST(SplatChoice, MoreSamplesTakeMoreOfAll) {
  SplatCounts last = choose_splat_counts(1, 0, {});
  for (const std::uint32_t spp : {4u, 16u, 64u, 256u}) {
    const SplatCounts next = choose_splat_counts(spp, 0, {});
    EXPECT_GE(next.rays, last.rays) << spp;
    EXPECT_LE(next.accuracy, last.accuracy) << spp;
    EXPECT_EQ(next.points, std::min(spp, 16u));
    last = next;
  }
  EXPECT_EQ(last.rays, 4096u);
  EXPECT_LT(last.accuracy, 0.2);
  EXPECT_EQ(choose_splat_counts(3, 0, {}).points, 2u) << "a power of two";
}

// Half the error: four times the rays, and an interpolation that is off by half.
TEST(SplatChoice, TargetsAskForTheirErrors) {
  const SplatCounts wide = choose_splat_counts(1, 0.04, {}), fine = choose_splat_counts(1, 0.02, {});
  EXPECT_NEAR(static_cast<double>(fine.rays) / wide.rays, 4, 0.1);
  EXPECT_NEAR(std::pow(wide.accuracy / fine.accuracy, 2), 2, 0.01);
  EXPECT_EQ(fine.points, 16u) << "paths take more than that";
}

TEST(SplatChoice, ALookThatFindsTooMuchAsksForMore) {
  const SplatCounts counts{.accuracy = 0.2, .rays = 256, .points = 16};
  const double wanted = 0.01;
  // Of a mean of 1: what interpolation does wrong as usual is far less than that.
  SplatJudgeFacts facts{.pixels = 9, .mean = 1, .square = 1, .noise = 0.4 * wanted, .spread = 0.2 * wanted};
  EXPECT_FALSE(better_splat_counts(counts, facts, wanted, {}));
  facts.noise = 0.7 * wanted;
  const auto more_rays = better_splat_counts(counts, facts, wanted, {});
  ASSERT_TRUE(more_rays);
  EXPECT_NEAR(more_rays->rays, 896, 1);
  EXPECT_EQ(more_rays->accuracy, counts.accuracy);
  facts.noise = 0;
  facts.spread = 16 * 0.2 * wanted;
  const auto finer = better_splat_counts(counts, facts, wanted, {});
  ASSERT_TRUE(finer);
  EXPECT_EQ(finer->rays, counts.rays);
  EXPECT_NEAR(finer->accuracy, 0.1, 1e-9);
  // A dark picture has no error to reach, and a step has an end.
  EXPECT_FALSE(better_splat_counts(counts, facts, 0, {}));
  facts.noise = 1e6;
  EXPECT_EQ(better_splat_counts(counts, facts, wanted, {})->rays, 4096u);
}

// Records of a point that agree may be wrong together: no less than what such an accuracy is usually off by.
TEST(SplatChoice, InterpolationIsNeverWithoutError) {
  SplatJudgeFacts facts{.pixels = 9, .mean = 2, .square = 4};
  const double usual = splat_interpolation_error(facts, 0.3);
  EXPECT_GT(usual, 0);
  EXPECT_NEAR(splat_interpolation_error(facts, 0.6) / usual, 16, 1e-9);
  facts.spread = 3 * usual;
  EXPECT_NEAR(splat_interpolation_error(facts, 0.3), 3 * usual, 1e-12);
}

}  // namespace
}  // namespace gleaner::coordinator

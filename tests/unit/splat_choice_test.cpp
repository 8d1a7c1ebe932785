// How method `splat` chooses accuracy and rays that are not set.

#include "coordinator/plan/splat_choice.h"

#include <gtest/gtest.h>

#include <cmath>
#include <cstring>
#include <deque>
#include <limits>
#include <numbers>
#include <optional>
#include <vector>

#include "coordinator/plan/graph.h"
#include "scene/library/library.h"

namespace gleaner::coordinator {
namespace {

using kernels::SplatJudgeFacts;

TEST(SplatChoice, WhatIsSetStays) {
  const SplatCounts counts = choose_splat_counts({64, 0.05}, {.accuracy = 0, .rays = 7});
  EXPECT_EQ(counts.accuracy, 0);
  EXPECT_EQ(counts.rays, 7u);
  const SplatJudgeFacts bad{.pixels = 9, .mean = 1, .square = 1, .noise = 1, .spread = 1};
  EXPECT_FALSE(better_splat_counts(counts, bad, 0.01, {.accuracy = 0, .rays = 7}));
}

TEST(SplatChoice, MoreSamplesTakeMoreOfAll) {
  SplatCounts last = choose_splat_counts({1}, {});
  for (const std::uint32_t spp : {4u, 16u, 64u, 256u}) {
    const SplatCounts next = choose_splat_counts({spp}, {});
    EXPECT_GE(next.rays, last.rays) << spp;
    EXPECT_LE(next.accuracy, last.accuracy) << spp;
    EXPECT_EQ(next.points, std::min(spp, 16u));
    last = next;
  }
  EXPECT_EQ(last.rays, 4096u);
  EXPECT_LT(last.accuracy, 0.2);
  EXPECT_EQ(choose_splat_counts({3}, {}).points, 2u) << "a power of two";
}

// A denoiser leaves records' noise, since it is as wide as they are.
TEST(SplatChoice, DenoisedPicturesTakeMoreRays) {
  const SplatCounts sampled = choose_splat_counts({8}, {}), denoised = choose_splat_counts({8, 0, true}, {});
  EXPECT_GT(denoised.rays, 2 * sampled.rays);
  EXPECT_EQ(denoised.accuracy, sampled.accuracy);
  // A target error is that of the denoised picture.
  EXPECT_EQ(choose_splat_counts({8, 0.05, true}, {}).rays, choose_splat_counts({8, 0.05}, {}).rays);
}

TEST(SplatChoice, ManyRecordsHaveFewerRays) {
  const double pixels = 256 * 256;
  const SplatCounts counts = choose_splat_counts({64}, {});
  const double usual = usual_splat_records(pixels, counts.accuracy);
  EXPECT_EQ(splat_rays_of_many(usual / 2, pixels, counts), counts.rays);
  EXPECT_NEAR(splat_rays_of_many(4 * usual, pixels, counts), counts.rays / 2.0, 1);
  EXPECT_EQ(splat_rays_of_many(1e9, pixels, counts), 64u) << "as few as make a picture";
  EXPECT_EQ(splat_rays_of_many(1e9, pixels, {.accuracy = 0.3, .rays = 16, .points = 1}), 16u);
}

// Error of records and of paths: where paths are noisier, the last rays of a record are worth less than their time.
TEST(SplatChoice, NoisyPathsTakeFewerRays) {
  const SplatCounts counts = choose_splat_counts({64}, {});
  const auto rays = [&](double sample, double ray) { return splat_rays_beside({sample, ray}, counts); };
  for (const double unknown : {rays(0, 1), rays(1, 0)}) EXPECT_EQ(unknown, counts.rays);
  EXPECT_EQ(rays(0.1, 1), counts.rays) << "quiet paths";
  EXPECT_LT(rays(0.5, 1), counts.rays);
  EXPECT_NEAR(rays(0.4, 1), 2 * rays(0.8, 1), 1);
  EXPECT_EQ(rays(0.4, 1), rays(0.8, 2)) << "the one beside the other";
  EXPECT_EQ(rays(1e9, 1), rays(1e6, 1)) << "no fewer than a part";
  EXPECT_GE(rays(1e9, 1), 64u);
  EXPECT_EQ(splat_rays_beside({1, 0.1}, {.accuracy = 0.3, .rays = 16, .points = 1}), 16u);
}

// Half the error: four times the rays, and an interpolation that is off by half.
TEST(SplatChoice, TargetsAskForTheirErrors) {
  const SplatCounts wide = choose_splat_counts({1, 0.04}, {}), fine = choose_splat_counts({1, 0.02}, {});
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

TEST(SplatChoice, CountsKeepWithinWork) {
  const double pixels = 128 * 128;
  const SplatCounts asked = choose_splat_counts({1024}, {});
  const SplatCounts free = splat_counts_within(1e12, pixels, {1024}, {});
  EXPECT_EQ(free.rays, asked.rays);
  EXPECT_EQ(free.accuracy, asked.accuracy);
  double last = 1e12;
  for (const double work : {1e7, 1e6, 1e5}) {
    const SplatCounts counts = splat_counts_within(work, pixels, {1024}, {});
    const double rays = usual_splat_records(pixels, counts.accuracy) * counts.rays;
    EXPECT_LE(rays, work);
    EXPECT_GT(rays, work / 2) << "no less than it may";
    EXPECT_LT(rays, last);
    EXPECT_EQ(counts.points, asked.points);
    last = rays;
  }
  const SplatCounts coarsest = splat_counts_within(0, pixels, {1024}, {});
  EXPECT_EQ(coarsest.rays, 64u) << "it ends, and is a cache";
  const SplatCounts given = splat_counts_within(0, pixels, {1024}, {.accuracy = 0.1, .rays = 500});
  EXPECT_EQ(given.rays, 500u) << "what is set stays";
  EXPECT_EQ(given.accuracy, 0.1);
  EXPECT_EQ(splat_rays_within(1e6, 2000, 1000), 500u);
  EXPECT_EQ(splat_rays_within(1e6, 2000, 100), 100u);
  EXPECT_EQ(splat_rays_within(1e6, 1e6, 100), 64u);
}

// What the plan asks for once the first samples and points are there, and 2,000 places are chosen.
struct AskedCache {
  float accuracy = 0;
  std::uint32_t rays = 0;
};

AskedCache asked_cache(const FrameSettings& settings, std::optional<double> allowed) {
  const auto plan = make_plan(settings, summarize(scene::make_scene("cornell-box")));
  AskedCache asked;
  const auto next = [&](const FinishedStage* finished) {
    if (allowed) plan->allow(finished ? *allowed : std::numeric_limits<double>::infinity());
    return plan->next(finished);
  };
  Step step = next(nullptr);
  std::deque<StageSpec> waiting(step.stages.begin(), step.stages.end());
  while (!waiting.empty() && !asked.rays) {
    const StageSpec stage = waiting.front();
    waiting.pop_front();
    FinishedStage finished{stage.name, nullptr, stage.items, {}};
    if (stage.output.placement == Placement::stream)
      plan->take(stage.name, 0, stage.items, Bytes(stage.items * stage.output.record_bytes));
    if (stage.kind == "splat_select") {
      kernels::SplatSelectParameters p;
      std::memcpy(&p, stage.parameters.data(), sizeof p);
      asked.accuracy = p.accuracy;
      finished.record_count = 2000;
      finished.facts = bytes_of(kernels::SplatSelectFacts{.points = 9000, .records = 2000, .accuracy = p.accuracy});
    } else if (stage.name == "splat.look") {
      finished.records =
          std::make_shared<const Bytes>(stage.items * stage.output.record_bytes);  // dark: nothing is told
    } else if (stage.kind == "splat_gather") {
      kernels::SplatGatherParameters p;
      std::memcpy(&p, stage.parameters.data(), sizeof p);
      asked.rays = p.polar * p.azimuthal;
    }
    if (asked.rays) break;
    step = next(&finished);
    waiting.insert(waiting.end(), step.stages.begin(), step.stages.end());
  }
  return asked;
}

TEST(SplatChoice, TheCacheFollowsATimeLimit) {
  FrameSettings settings;
  settings.method = "splat";
  settings.width = settings.height = 128;
  settings.spp = 1024;
  const AskedCache free = asked_cache(settings, {}), wide = asked_cache(settings, 1e12),
                   unknown = asked_cache(settings, std::numeric_limits<double>::infinity()),
                   narrow = asked_cache(settings, 1e7), none = asked_cache(settings, 0);
  EXPECT_NEAR(free.rays, 4096, 64);
  for (const AskedCache& same : {wide, unknown}) {
    EXPECT_EQ(same.rays, free.rays);
    EXPECT_EQ(same.accuracy, free.accuracy);
  }
  EXPECT_GT(narrow.accuracy, free.accuracy);
  EXPECT_LT(2000.0 * narrow.rays, 1e7 / 4) << "a ray takes longer than a path's sample";
  EXPECT_GT(narrow.rays, none.rays);
  EXPECT_EQ(none.rays, 64u);
}

}  // namespace
}  // namespace gleaner::coordinator

// How method `links` chooses vertices, directions and light samples that are not set.

#include "coordinator/plan/links_choice.h"
#include "kernels/links_records.h"

#include <gtest/gtest.h>

#include <cmath>
#include <random>
#include <vector>

namespace gleaner::coordinator {
namespace {

constexpr std::uint64_t kPixels = 512 * 512;

using kernels::LinksBounces;

// Light that two groups of elements exchange, of which each loses its own share: what all send at bounce k grows by the
// sum of both.
struct Series {
  double slow = 0, fast = 0;
  double at(double ratio, std::uint32_t bounce) const { return std::pow(ratio, bounce); }
  double grown(std::uint32_t bounce) const { return at(slow, bounce) + at(fast, bounce); }
  double to_come(std::uint32_t bounce) const {
    return at(slow, bounce + 1) / (1 - slow) + at(fast, bounce + 1) / (1 - fast);
  }
  kernels::LinksFluxFacts after(std::uint32_t bounce) const {
    kernels::LinksFluxFacts facts;
    for (unsigned c = 0; c < 3; ++c) {
      facts.flux[c] = 1 / (1 - slow) + 1 / (1 - fast) - to_come(bounce);
      facts.grown[c] = grown(bounce), facts.earlier[c] = grown(bounce - 1);
      const double r = facts.grown[c] / facts.earlier[c];
      facts.strayed[c] =
          std::abs(at(slow, bounce) - r * at(slow, bounce - 1)) + std::abs(at(fast, bounce) - r * at(fast, bounce - 1));
    }
    return facts;
  }
};

TEST(LinksBouncesTest, LightThatShrinksEvenlyIsMeasuredOnce) {
  for (const double shrinks : {0.2, 0.6, 0.9}) {
    const Series light{shrinks, shrinks};
    LinksBounces bounces;
    EXPECT_TRUE(bounces.is_enough(light.after(bounces.next), 0.001)) << shrinks;
    EXPECT_EQ(bounces.done, 2u);
    for (const float tail : bounces.tail)
      EXPECT_NEAR(light.grown(2) * double{tail}, light.to_come(2), 1e-4 * light.to_come(2)) << shrinks;
  }
}

// What the tail is off by is told: not less than it is, and seldom measured.
TEST(LinksBouncesTest, TheTailIsOffByLessThanTold) {
  for (const double fast : {0.1, 0.3, 0.45})
    for (const double share : {0.01, 0.001, 0.0001}) {
      const Series light{0.5, fast};
      LinksBounces bounces;
      unsigned measured = 1;
      for (; !bounces.is_enough(light.after(bounces.next), share); ++measured) ASSERT_LT(measured, 20u);
      const double tail = double{bounces.tail[0]}, all = 1 / (1 - light.slow) + 1 / (1 - fast);
      const double off = std::abs(light.at(0.5, bounces.done) * (1 / (1 - 0.5) - 1 - tail)) +
                         std::abs(light.at(fast, bounces.done) * (fast / (1 - fast) - tail));
      EXPECT_LT(bounces.left, share);
      EXPECT_LT(off / all, bounces.left) << fast << ' ' << share;
      EXPECT_LT(measured, 6u);
    }
}

TEST(LinksBouncesTest, LimitedBouncesHaveNoTail) {
  for (const double shrinks : {0.2, 0.6, 0.9}) {
    const Series light{shrinks, shrinks};
    LinksBounces bounces;
    bounces.adds_tail = false;
    unsigned measured = 1;
    for (; !bounces.is_enough(light.after(bounces.next), 0.001); ++measured) ASSERT_LT(measured, 20u);
    const double all = 2 / (1 - shrinks);
    EXPECT_LT(light.to_come(bounces.done) / all, 0.001 * 1.01) << shrinks;
    if (bounces.done > 2) {
      EXPECT_GT(light.to_come(bounces.done - 1) / all, 0.001 * 0.99) << shrinks << ": one bounce fewer would have done";
    }
    EXPECT_EQ(bounces.tail[0], 0.0f);
    EXPECT_LT(measured, 9u) << shrinks;
  }
}

TEST(LinksBouncesTest, LightThatDoesNotGrowIsEnough) {
  LinksBounces dark;
  EXPECT_TRUE(dark.is_enough({}, 0.001));
  LinksBounces still;
  EXPECT_TRUE(still.is_enough({.flux = {1, 1, 1}}, 0.001));
  EXPECT_EQ(still.tail[0], 0.0f);
}

TEST(LinksChoice, WhatIsSetStays) {
  const GivenLinksCounts given = {.vertices = 0, .directions = 16, .light_samples = 64};
  const LinksCounts counts = choose_links_counts(30, {kPixels, 64, 0.01}, given);
  EXPECT_EQ(counts.vertices, 0u) << "the scene's own";
  EXPECT_EQ(counts.directions, 16u);
  EXPECT_EQ(counts.light_samples, 64u);
  const LinksError bad{.mean = 1, .square = 100, .noise = 50, .pixels = 9};
  EXPECT_FALSE(better_links_counts(counts, bad, 0.01, given));
}

TEST(LinksChoice, MoreSamplesTakeMoreOfAll) {
  LinksCounts last = choose_links_counts(30, {kPixels, 1, 0}, {});
  for (const std::uint32_t spp : {4u, 16u, 64u, 256u, 4096u}) {
    const LinksCounts next = choose_links_counts(30, {kPixels, spp, 0}, {});
    EXPECT_GE(next.vertices, last.vertices) << spp;
    EXPECT_GE(next.directions, last.directions) << spp;
    EXPECT_GE(next.light_samples, last.light_samples) << spp;
    const auto side = static_cast<std::uint32_t>(std::lround(std::sqrt(next.directions)));
    EXPECT_EQ(side * side, next.directions);
    EXPECT_EQ(side % 4, 0u);
    EXPECT_EQ(next.light_samples % 16, 0u);
    last = next;
  }
  EXPECT_EQ(last.directions, 1024u);
  // Links have a bound, which leaves no room for more vertices.
  EXPECT_NEAR(2.0 * last.vertices * last.directions, 1.5e8, 1e6);
  EXPECT_GT(choose_links_counts(20'000, {kPixels, 64, 0}, {}).vertices,
            5 * choose_links_counts(30, {kPixels, 64, 0}, {}).vertices);
}

// A scene's own vertices say nothing of what its large triangles interpolate. They want directions, too: where they are
// many, others cost little beside them.
TEST(LinksChoice, TheScenesOwnVerticesCountForNothing) {
  const LinksCounts few = choose_links_counts(30, {kPixels, 16, 0}, {}),
                    many = choose_links_counts(70'000, {kPixels, 16, 0}, {});
  EXPECT_TRUE(few.beside_own && many.beside_own);
  EXPECT_GT(many.vertices, 35'000u);
  EXPECT_LE(many.directions, few.directions);
  EXPECT_FALSE(choose_links_counts(70'000, {kPixels, 16, 0}, {.vertices = 5000}).beside_own);
  // Both are bounded, so that links of a scene of any size have room.
  EXPECT_LE(choose_links_counts(1e6, {kPixels, 64, 0}, {}).vertices, 500u);
}

// Paths' noise goes; what vertices are off by stays, unless it was promised to be less.
TEST(LinksChoice, DenoisedPicturesTakeMore) {
  const LinksCounts noisy = choose_links_counts(30, {.pixels = kPixels, .spp = 8}, {}),
                    denoised = choose_links_counts(30, {.pixels = kPixels, .spp = 8, .denoised = true}, {});
  EXPECT_GT(denoised.vertices, 4 * noisy.vertices);
  EXPECT_GT(denoised.directions, noisy.directions);
  EXPECT_LT(2.0 * denoised.vertices * denoised.directions, 12.0 * kPixels * 8) << "and cost no more than others may";
  const LinksTarget promised{.pixels = kPixels, .spp = 8, .error = 0.02};
  LinksTarget promised_denoised = promised;
  promised_denoised.denoised = true;
  EXPECT_EQ(choose_links_counts(30, promised, {}).vertices, choose_links_counts(30, promised_denoised, {}).vertices);
}

// A small picture's links cost no more than a few times its paths; a promise is kept at any size.
TEST(LinksChoice, SmallPicturesTakeFewer) {
  const LinksCounts large = choose_links_counts(30, {kPixels, 64, 0}, {}),
                    small = choose_links_counts(30, {48 * 48, 64, 0}, {});
  EXPECT_LT(small.vertices, large.vertices);
  EXPECT_LT(2.0 * small.vertices * small.directions, 12.0 * 48 * 48 * 64);
  const LinksCounts promised = choose_links_counts(30, {48 * 48, 1, 0.02}, {});
  EXPECT_EQ(promised.vertices, choose_links_counts(30, {kPixels, 4096, 0.02}, {}).vertices);
  EXPECT_GT(promised.vertices, 4 * choose_links_counts(30, {kPixels, 1, 0.06}, {}).vertices);
}

constexpr std::size_t kPoints = 4;

// Of pixels that show 1 and something, `off` from what all rays say, whose halves are noisy.
std::vector<float> audit(double off, double noise, std::size_t pixels) {
  std::mt19937 random(3);
  std::normal_distribution<double> number(0, 1);
  std::vector<float> records;
  for (std::size_t k = 0; k < pixels * kPoints; ++k) {
    // The points of a pixel are off together.
    const double shown = 1 + (k / kPoints % 2 ? off : -off);
    for (int c = 0; c < 3; ++c) records.push_back(static_cast<float>(shown));
    for (int c = 0; c < 12; ++c) records.push_back(static_cast<float>(1 + noise * number(random)));
  }
  return records;
}

TEST(LinksChoice, AnAuditTellsNoiseFromError) {
  const LinksCounts counts{.vertices = 1000, .directions = 256, .light_samples = 16};
  for (const double off : {0.0, 0.03, 0.1})
    for (const double noise : {0.0, 0.05, 0.2}) {
      const LinksError found = links_error(audit(off, noise, 4000), kPoints, counts);
      EXPECT_EQ(found.pixels, 4000u);
      EXPECT_NEAR(found.mean, 1, 1e-6);
      EXPECT_NEAR(found.truth, 1, 0.01);
      EXPECT_NEAR(found.square, off * off, 4 * found.deviation + 1e-8) << off << " " << noise;
      EXPECT_LE(found.deviation, 0.001);
      EXPECT_GE(found.upper(), off * off - 1e-8);
      // The audit's rays are a quarter of a vertex'; between vertices half of the noise is left.
      EXPECT_NEAR(found.noise, 0.5 * noise * noise * std::pow(0.25, 1.25), 0.02 * noise * noise + 1e-12);
    }
}

TEST(LinksChoice, AnAuditThatFindsTooMuchAsksForMore) {
  const LinksCounts counts{.vertices = 1000, .directions = 144, .light_samples = 16};
  const double wanted = 0.01;
  EXPECT_FALSE(better_links_counts(counts, {.mean = 1, .square = 0.4 * wanted, .noise = 0.2 * wanted}, wanted, {}));
  const auto more_rays = better_links_counts(counts, {.mean = 1, .square = wanted, .noise = 0.9 * wanted}, wanted, {});
  ASSERT_TRUE(more_rays);
  EXPECT_GE(more_rays->directions, 4 * counts.directions);
  EXPECT_EQ(more_rays->vertices, counts.vertices);
  const auto finer = better_links_counts(counts, {.mean = 1, .square = wanted, .noise = 0}, wanted, {});
  ASSERT_TRUE(finer);
  EXPECT_EQ(finer->directions, counts.directions);
  EXPECT_NEAR(finer->vertices, 1000 * std::pow(4, 1 / 0.86), 1);
  // What is set stays; a dark picture has no error to reach; a step has an end.
  EXPECT_FALSE(better_links_counts(counts, {.mean = 1, .square = wanted}, wanted, {.vertices = 1000}));
  EXPECT_FALSE(better_links_counts(counts, {.mean = 1, .square = 1}, 0, {}));
  EXPECT_EQ(better_links_counts(counts, {.mean = 1, .square = 1e6}, wanted, {})->vertices, 16'000u);
}

}  // namespace
}  // namespace gleaner::coordinator

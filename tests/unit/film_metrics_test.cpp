// The definitions of error that everything else is judged by, against values worked out by hand or by another program.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <limits>
#include <random>

#include "coordinator/film/metrics.h"
#include "coordinator/film/read.h"
#include "scene/model/error.h"

namespace gleaner::coordinator {
namespace {

using testing::AllOf;
using testing::HasSubstr;

Film flat(std::uint32_t width, std::uint32_t height, float r, float g, float b) {
  Film film{width, height, {}};
  const std::size_t count = std::size_t{width} * height;
  film.channel("R").values.assign(count, r);
  film.channel("G").values.assign(count, g);
  film.channel("B").values.assign(count, b);
  return film;
}

Comparison compare_films(const Film& test, const Film& reference, const Film* error = nullptr) {
  if (!error) return compare({test, "a.exr"}, {reference, "b.exr"}, nullptr);
  const Picture picture{*error, "stderr.exr"};
  return compare({test, "a.exr"}, {reference, "b.exr"}, &picture);
}

std::string bad_input_of(const Film& test, const Film& reference, const Film* error = nullptr) {
  try {
    compare_films(test, reference, error);
  } catch (const Error& thrown) {
    EXPECT_EQ(thrown.kind(), ErrorKind::bad_input);
    return thrown.what();
  }
  ADD_FAILURE() << "no error was thrown";
  return {};
}

TEST(FilmMetrics, WorkedByHand) {
  const Film reference = flat(2, 1, 1, 2, 3);  // mean 2
  Film test = reference;
  test.channel("R").values[0] = 1.3f;
  test.channel("B").values[1] = 2.6f;
  const auto result = compare_films(test, reference).picture;
  const double mse = (0.09 + 0.16) / 6;
  EXPECT_NEAR(result.mse, mse, 1e-7);
  EXPECT_NEAR(result.rmse, std::sqrt(mse), 1e-7);
  EXPECT_NEAR(result.error, std::sqrt(mse) / 2, 1e-7);
  EXPECT_NEAR(result.error_robust, std::sqrt(mse) / 2, 1e-7);  // fewer than 1000 pixels: none is left out
  EXPECT_NEAR(result.relmse, (0.09 / (1 + 0.04) + 0.16 / (9 + 0.04)) / 6, 1e-7);
  EXPECT_NEAR(result.bias, (0.3 - 0.4) / 12, 1e-7);
  EXPECT_NEAR(result.mean, 2, 1e-12);
  EXPECT_NEAR(result.test_mean, 2 - 0.1 / 6, 1e-7);
  ASSERT_TRUE(result.psnr);
  EXPECT_NEAR(*result.psnr, 10 * std::log10(9 / mse), 1e-5);
  ASSERT_EQ(result.channels.size(), 3u);
  EXPECT_NEAR(result.channels[0].deviation, 0.15, 1e-6);
  EXPECT_NEAR(result.channels[1].deviation, 0, 1e-12);
  EXPECT_NEAR(result.channels[2].deviation, -0.4 / 6, 1e-6);
}

TEST(FilmMetrics, EqualPicturesDoNotDiffer) {
  const Film film = flat(20, 20, 1, 2, 3);
  const auto result = compare_films(film, film);
  EXPECT_EQ(result.picture.mse, 0);
  EXPECT_EQ(result.picture.error, 0);
  EXPECT_EQ(result.picture.relmse, 0);
  EXPECT_EQ(result.picture.bias, 0);
  EXPECT_FALSE(result.picture.psnr);
  EXPECT_FALSE(result.blocks);  // no standard error is known
}

TEST(FilmMetrics, BlackReferenceGivesPlainValues) {
  const auto result = compare_films(flat(4, 4, 0.5f, 0.5f, 0.5f), flat(4, 4, 0, 0, 0)).picture;
  EXPECT_DOUBLE_EQ(result.error, 0.5);
  EXPECT_DOUBLE_EQ(result.bias, 0.5);
  EXPECT_DOUBLE_EQ(result.channels[0].deviation, 0.5);
  EXPECT_EQ(compare_films(flat(4, 4, 0, 0, 0), flat(4, 4, 0, 0, 0)).picture.relmse, 0);
}

TEST(FilmMetrics, RobustLeavesOutOnePixelInAThousand) {
  const Film reference = flat(100, 20, 1, 1, 1);
  Film test = flat(100, 20, 1.1f, 1.1f, 1.1f);
  test.channel("R").values[77] = 500;
  test.channel("G").values[1234] = 300;
  const auto two = compare_films(test, reference).picture;
  EXPECT_GT(two.error, 7);
  EXPECT_NEAR(two.error_robust, 0.1, 1e-6);
  test.channel("B").values[1999] = 200;  // a third one stays in
  EXPECT_GT(compare_films(test, reference).picture.error_robust, 2);
}

// Truth 1, a reference with noise of 0.05, a picture with noise of 0.1 and a variance layer that says so.
struct NoisyPair {
  Film test = flat(256, 128, 1, 1, 1), reference = flat(256, 128, 1, 1, 1), error = flat(256, 128, 0.05f, 0.05f, 0.05f);
  NoisyPair() {
    std::mt19937 bits(20080701);
    std::normal_distribution<float> normal;
    for (const char* name : {"R", "G", "B"}) {
      for (float& value : test.channel(name).values) value += 0.1f * normal(bits);
      for (float& value : reference.channel(name).values) value += 0.05f * normal(bits);
      test.channel(std::string("variance.") + name).values.assign(256 * 128, 0.01f);
    }
  }
};

TEST(FilmMetrics, ReferenceNoiseIsTakenOff) {
  const NoisyPair pair;
  const auto result = compare_films(pair.test, pair.reference, &pair.error);
  // The relative standard error of a variance from n = 98304 values is sqrt(2 / n) = 0.0045; bounds at 5 of them.
  EXPECT_NEAR(result.picture.mse_measured, 0.0125, 0.0125 * 0.0226);
  EXPECT_NEAR(result.picture.mse, 0.01, 0.0125 * 0.0226);
  EXPECT_NEAR(result.picture.error, 0.1, 0.0015);
  EXPECT_NEAR(result.reference_noise, 0.0025, 1e-9);
  ASSERT_TRUE(result.variance_ratio);
  EXPECT_NEAR(*result.variance_ratio, 1, 0.0283);
  ASSERT_TRUE(result.blocks);
  EXPECT_EQ(result.blocks->count, 128u);
  EXPECT_EQ(result.blocks->off, 0u);
  for (const auto& channel : result.picture.channels) {
    ASSERT_TRUE(channel.sigmas);
    EXPECT_LT(std::abs(*channel.sigmas), 5);
    EXPECT_NEAR(*channel.sigmas, (channel.test - channel.reference) / std::sqrt(0.0125 / (256 * 128)), 1e-6);
  }
}

TEST(FilmMetrics, OwnNoiseIsWhatTheVarianceLayerTells) {
  const NoisyPair pair;
  const auto noise = own_noise({pair.test, "a.exr"});
  EXPECT_NEAR(noise.mean, 1, 0.002);
  ASSERT_TRUE(noise.standard_error);
  EXPECT_NEAR(*noise.standard_error, 0.1 / noise.mean, 1e-6);
  EXPECT_FALSE(own_noise({pair.reference, "b.exr"}).standard_error);
}

TEST(FilmMetrics, BiasedBlocksAreFound) {
  NoisyPair pair;
  for (std::size_t y = 32; y < 48; ++y)
    for (std::size_t x = 64; x < 80; ++x) pair.test.channel("G").values[y * 256 + x] += 0.08f;  // 11 standard errors
  const auto blocks = compare_films(pair.test, pair.reference, &pair.error).blocks;
  ASSERT_TRUE(blocks);
  EXPECT_EQ(blocks->off, 1u);
  EXPECT_DOUBLE_EQ(blocks->share(), 1.0 / 128);
  EXPECT_EQ(blocks->worst_x, 64u);
  EXPECT_EQ(blocks->worst_y, 32u);
  EXPECT_NEAR(blocks->worst_sigmas, 0.08 * 16 / std::sqrt(0.0125), 5);
}

TEST(FilmMetrics, BlocksWithinOnePercentAreFine) {
  const Film reference = flat(16, 16, 1, 1, 1), error = flat(16, 16, 1e-4f, 1e-4f, 1e-4f);
  EXPECT_EQ(compare_films(flat(16, 16, 1.009f, 1, 1), reference, &error).blocks->off, 0u);
  EXPECT_EQ(compare_films(flat(16, 16, 1.011f, 1, 1), reference, &error).blocks->off, 1u);
  EXPECT_EQ(compare_films(flat(16, 16, 0.989f, 1, 1), reference, &error).blocks->off, 1u);
}

TEST(FilmMetrics, BlocksAtTheEdgeArePartial) {
  const Film reference = flat(40, 20, 1, 1, 1), error = flat(40, 20, 0.01f, 0.01f, 0.01f);
  Film test = reference;
  for (std::size_t y = 16; y < 20; ++y)
    for (std::size_t x = 32; x < 40; ++x) test.channel("R").values[y * 40 + x] = 1.1f;
  const auto blocks = compare_films(test, reference, &error).blocks;
  ASSERT_TRUE(blocks);
  EXPECT_EQ(blocks->count, 6u);
  EXPECT_EQ(blocks->off, 1u);
  EXPECT_EQ(blocks->worst_x, 32u);
  EXPECT_EQ(blocks->worst_y, 16u);
}

TEST(FilmMetrics, NearerThanTheReferenceCanTell) {
  const Film film = flat(8, 8, 1, 1, 1), error = flat(8, 8, 0.1f, 0.1f, 0.1f);
  const auto result = compare_films(film, film, &error).picture;
  EXPECT_NEAR(result.mse, -0.01, 1e-8);
  EXPECT_EQ(result.rmse, 0);
  EXPECT_EQ(result.error, 0);
  EXPECT_EQ(result.error_robust, 0);
  EXPECT_FALSE(result.psnr);
}

TEST(FilmMetrics, LayersOfBothAreCompared) {
  Film test = flat(4, 4, 1, 1, 1), reference = flat(4, 4, 1, 1, 1);
  test.channel("direct.R").values.assign(16, 3);
  reference.channel("direct.R").values.assign(16, 2);
  test.channel("depth.Z").values.assign(16, 7);  // the reference has none
  const auto layers = compare_films(test, reference).layers;
  ASSERT_EQ(layers.size(), 1u);
  EXPECT_EQ(layers[0].name, "direct");
  EXPECT_DOUBLE_EQ(layers[0].mse, 1);
  EXPECT_DOUBLE_EQ(layers[0].error, 0.5);
  EXPECT_DOUBLE_EQ(layers[0].bias, 0.5);
}

TEST(FilmMetrics, NotANumberIsNamedByPixel) {
  const Film good = flat(8, 4, 1, 1, 1);
  Film bad = good;
  bad.channel("G").values[2 * 8 + 5] = std::numeric_limits<float>::quiet_NaN();
  bad.channel("G").values[3 * 8 + 1] = std::numeric_limits<float>::infinity();
  const auto named = AllOf(HasSubstr("channel G"), HasSubstr("pixel 5,2"), HasSubstr("2 such pixels"));
  EXPECT_THAT(bad_input_of(bad, good), AllOf(HasSubstr("a.exr"), named));
  EXPECT_THAT(bad_input_of(good, bad), AllOf(HasSubstr("b.exr"), named));
  EXPECT_THAT(bad_input_of(good, good, &bad), AllOf(HasSubstr("stderr.exr"), named));
}

TEST(FilmMetrics, WhatCannotBeComparedIsBadInput) {
  const Film film = flat(8, 4, 1, 1, 1);
  EXPECT_THAT(bad_input_of(flat(4, 8, 1, 1, 1), film), AllOf(HasSubstr("a.exr"), HasSubstr("8x4"), HasSubstr("4x8")));
  const Film other = flat(4, 8, 1, 1, 1);
  EXPECT_THAT(bad_input_of(film, film, &other), AllOf(HasSubstr("stderr.exr"), HasSubstr("4x8")));
  Film grey{8, 4, {}};
  grey.channel("Y");
  EXPECT_THAT(bad_input_of(film, grey), AllOf(HasSubstr("b.exr"), HasSubstr("R")));
}

// Two different pictures with a measured standard error, judged once by an independent program in numpy.
TEST(FilmMetrics, AgreesWithAnotherProgramOnRealPictures) {
  const char* given = std::getenv("GLEANER_SHARED");
  const std::string folder = std::string(given ? given : GLEANER_SHARED_DIR) + "/references/";
  if (!std::filesystem::exists(folder)) GTEST_SKIP() << "NOT CHECKED: the reference pictures are not at " << folder;
  const Film test = read_exr(folder + "cornell-box.exr"), reference = read_exr(folder + "CornellBox-Original.exr");
  const Film error = read_exr(folder + "CornellBox-Original.stderr.exr");
  const auto result = compare_films(test, reference, &error);
  EXPECT_NEAR(result.picture.mse, 0.7977582424670809, 1e-9);
  EXPECT_NEAR(result.picture.mse_measured, 0.7977632635342022, 1e-9);
  EXPECT_NEAR(result.reference_noise, 5.021067121259402e-06, 1e-12);
  EXPECT_NEAR(result.picture.error, 5.293932645816127, 1e-9);
  EXPECT_NEAR(result.picture.relmse, 353.9554522431458, 1e-7);
  EXPECT_NEAR(result.picture.bias, -0.28872217685039636, 1e-9);
  EXPECT_NEAR(result.picture.channels[0].deviation, -0.3165737883733625, 1e-9);
  EXPECT_NEAR(result.picture.channels[1].deviation, -0.2470259274052663, 1e-9);
  EXPECT_NEAR(result.picture.channels[2].deviation, -0.26979420406097887, 1e-9);
}

}  // namespace
}  // namespace gleaner::coordinator

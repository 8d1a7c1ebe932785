// What a cache of radiance cache splatting tells of its own errors, where they are known.

#include "worker/stages/splat/judge.h"

#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <random>

namespace gleaner::test {
namespace {

using worker::CacheRecord;
using worker::SplatPoint;

// Irradiance over the plane z = 0, and its derivative along x.
struct Light {
  std::function<double(double x)> at, slope;
};

// Records on a grid, each of which reaches its neighbours and a little more.
std::vector<CacheRecord> records_of(const Light& light, double noise) {
  std::mt19937 random(3);
  std::normal_distribution<double> number;
  std::vector<CacheRecord> records;
  for (int y = 0; y < 40; ++y)
    for (int x = 0; x < 40; ++x) {
      CacheRecord record{};
      record.position = {static_cast<float>(x), static_cast<float>(y), 0};
      record.normal = {0, 0, 1};
      record.radius = 7.5f;
      record.accuracy = 0.2f;
      const double off = noise * number(random);
      // Halves of its rays differ by another such number.
      record.spare[0] = static_cast<float>(noise * number(random) / (1 + off));
      for (std::size_t c = 0; c < 3; ++c) {
        record.irradiance[c] = static_cast<float>(light.at(x) * (1 + off));
        record.translation[3 * c] = static_cast<float>(light.slope(x));
      }
      records.push_back(record);
    }
  return records;
}

std::vector<SplatPoint> points_of(std::uint32_t pixels, std::uint32_t samples) {
  std::mt19937 random(5);
  std::uniform_real_distribution<float> number(2, 37);
  std::vector<SplatPoint> points;
  for (std::uint32_t k = 0; k < pixels; ++k) {
    SplatPoint point{};
    point.position = {number(random), number(random), 0};
    point.normal = {0, 0, 1};
    point.factor = {0.5f, 0.5f, 0.5f};
    point.footprint = 0.01f;
    points.insert(points.end(), samples, point);
  }
  return points;
}

TEST(SplatJudge, LinearLightWithoutNoiseIsExact) {
  const Light linear{[](double x) { return 10 + 0.2 * x; }, [](double) { return 0.2; }};
  const auto facts = worker::judge_cache(points_of(500, 2), 2, records_of(linear, 0));
  EXPECT_EQ(facts.pixels, 500u);
  EXPECT_NEAR(facts.mean, 0.5 * (10 + 0.2 * 19.5), 0.2);
  EXPECT_EQ(facts.noise, 0);
  EXPECT_LT(facts.sampling, 1e-10) << "the points of a pixel are one point";
  EXPECT_LT(facts.spread, 1e-10);
}

// Points of a pixel of which half are dark: the variance of their mean.
TEST(SplatJudge, FewPointsOfAPixelAreAnError) {
  const Light even{[](double) { return 4.0; }, [](double) { return 0.0; }};
  std::vector<SplatPoint> points = points_of(200, 4);
  for (std::size_t i = 0; i < points.size(); i += 2) points[i].factor = {};
  EXPECT_NEAR(worker::judge_cache(points, 4, records_of(even, 0)).sampling, 1.0 / 3, 1e-4);
}

// The noise that is told from halves is that of the light itself.
TEST(SplatJudge, NoiseIsThatOfTheRecords) {
  const Light even{[](double) { return 4.0; }, [](double) { return 0.0; }};
  const auto points = points_of(4000, 1);
  for (const double noise : {0.02, 0.1}) {
    const auto exact = worker::judge_cache(points, 1, records_of(even, 0)),
               facts = worker::judge_cache(points, 1, records_of(even, noise));
    // The mean square of what is off: the square of the light less that of the true light.
    const double square = facts.square - 2 * facts.mean * exact.mean + exact.square;
    std::printf("  noise %.2f: predicted %.5f, is %.5f; spread %.6f\n", noise, std::sqrt(facts.noise),
                std::sqrt(square), std::sqrt(facts.spread));
    EXPECT_NEAR(facts.noise / square, 1, 0.25) << noise;
    // Noise is not taken for records that disagree.
    EXPECT_LT(facts.spread, 0.1 * facts.noise) << noise;
  }
}

TEST(SplatJudge, CurvesShowAsSpread) {
  double last = 0;
  for (const double period : {12.0, 8.0, 6.0}) {
    const Light wave{[period](double x) { return 5 + std::sin(x / period * 6.2831853); },
                     [period](double x) { return 6.2831853 / period * std::cos(x / period * 6.2831853); }};
    const double found = worker::judge_cache(points_of(1000, 1), 1, records_of(wave, 0.01)).spread;
    std::printf("  a wave of %.0f records: %.4f\n", period, std::sqrt(found));
    EXPECT_GT(found, last) << period;
    last = found;
  }
}

}  // namespace
}  // namespace gleaner::test

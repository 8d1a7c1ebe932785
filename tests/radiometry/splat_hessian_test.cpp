// `splat.hessian`: second derivatives of irradiance beside those of a lamp whose irradiance is integrated here, the
// shapes that come of them, and what such a cache shows.

#include "worker/stages/splat/hessian.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <numbers>
#include <random>
#include <vector>

#include "scene/library/library.h"
#include "tests/radiometry/rendered_frame.h"
#include "worker/stages/splat/reading.h"
#include "worker/stages/splat/select.h"
#include "worker/stages/splat/shape.h"
#include "worker/stages/splat/tangent_frame.h"

namespace gleaner::test {
namespace {

using worker::CacheRecord;
using worker::HemisphereGrid;
using worker::HemisphereSample;
using worker::RecordShape;
using worker::SplatPlace;
using worker::SplatPoint;
using worker::TangentMatrix;
using Normal = std::array<float, 3>;

// A square lamp at z = 1, parallel to the floor.
struct Lamp {
  double x, y, half;
};

// Its irradiance at (x, y, 0) from unit radiance: the integral of cos^2 / (pi r^2) dA, times pi.
double irradiance(const Lamp& lamp, double x, double y) {
  constexpr int steps = 400;
  const double step = 2 * lamp.half / steps;
  double sum = 0;
  for (int i = 0; i < steps; ++i)
    for (int k = 0; k < steps; ++k) {
      const double dx = lamp.x - lamp.half + (i + 0.5) * step - x, dy = lamp.y - lamp.half + (k + 0.5) * step - y;
      const double squared = dx * dx + dy * dy + 1;
      sum += step * step / (squared * squared);
    }
  return sum;
}

// What a record at the origin sees of the lamp.
TangentMatrix seen(const Lamp& lamp, const HemisphereGrid& grid) {
  std::mt19937 random(3);
  std::uniform_real_distribution<double> number;
  std::vector<HemisphereSample> samples;
  for (std::uint32_t j = 0; j < grid.polar; ++j)
    for (std::uint32_t k = 0; k < grid.azimuthal; ++k) {
      const double sine = std::sqrt((j + number(random)) / grid.polar), cosine = std::sqrt(1 - sine * sine);
      const double phi = 2 * std::numbers::pi * (k + number(random)) / grid.azimuthal;
      const double x = sine * std::cos(phi), y = sine * std::sin(phi);
      const bool lit = std::abs(x / cosine - lamp.x) <= lamp.half && std::abs(y / cosine - lamp.y) <= lamp.half;
      const float light = lit ? 1 : 0;
      samples.push_back(
          {{light, light, light}, lit ? static_cast<float>(cosine) : 0, static_cast<float>(x), static_cast<float>(y)});
    }
  return worker::IrradianceHessian(grid).relative(samples);
}

TEST(SplatHessian, IsThatOfALamp) {
  for (const Lamp lamp : {Lamp{0, 0, 0.5}, Lamp{0.8, 0, 0.4}, Lamp{0.6, -0.9, 0.5}}) {
    const TangentMatrix found = seen(lamp, {256, 1024});
    const double h = 0.02, here = irradiance(lamp, 0, 0);
    const auto at = [&](double x, double y) { return irradiance(lamp, x, y); };
    const TangentMatrix expected = {(at(h, 0) - 2 * here + at(-h, 0)) / (h * h * here),
                                    (at(h, h) - at(h, -h) - at(-h, h) + at(-h, -h)) / (4 * h * h * here),
                                    (at(0, h) - 2 * here + at(0, -h)) / (h * h * here)};
    // The frame of normal (0, 0, 1) is that of the axes.
    for (std::size_t k = 0; k < 3; ++k) {
      std::printf("  lamp at (%.1f, %.1f): %.4f, expected %.4f\n", lamp.x, lamp.y, found[k], expected[k]);
      EXPECT_NEAR(found[k], expected[k], 0.03) << lamp.x << ", " << lamp.y << ": " << k;
    }
  }
}

TEST(SplatHessian, OfAConstantEnvironmentVanishes) {
  const HemisphereGrid grid{16, 64};
  const std::vector<HemisphereSample> samples(grid.strata(), {{3, 3, 3}, 0.5f, 0, 0});
  for (const double value : worker::IrradianceHessian(grid).relative(samples)) EXPECT_EQ(value, 0);
}

TEST(SplatHessian, ShapeIsTheEllipseOfItsMetric) {
  // Half axes of 2 m and, 30 degrees from the first tangent, 0.5 m.
  const double c = std::cos(std::numbers::pi / 6), s = std::sin(std::numbers::pi / 6);
  const TangentMatrix metric = {4 * c * c + 0.25 * s * s, (4 - 0.25) * c * s, 4 * s * s + 0.25 * c * c};
  const RecordShape shape = worker::shape_of(metric, {.least = 0.01, .most = 10});
  EXPECT_NEAR(shape.radius, 2, 1e-5);
  EXPECT_NEAR(std::abs(shape.narrow[0] * c + shape.narrow[1] * s), std::sqrt(15), 1e-5);
  EXPECT_NEAR(shape.narrow[0] * s - shape.narrow[1] * c, 0, 1e-5);
  const Normal normal = {0.48f, -0.6f, 0.64f};
  const TangentMatrix again = worker::in_plane(normal, worker::metric_of(normal, shape));
  for (std::size_t k = 0; k < 3; ++k) EXPECT_NEAR(again[k], metric[k], 1e-5) << k;
  const RecordShape bounded = worker::shape_of(metric, {.least = 0.8, .most = 1});
  EXPECT_NEAR(bounded.radius, 1, 1e-6);
  EXPECT_NEAR(std::hypot(bounded.narrow[0], bounded.narrow[1]), std::sqrt(1 / 0.64 - 1), 1e-5);
}

TEST(SplatHessian, ARecordCountsAsFarAsItsShapeSays) {
  CacheRecord record{};
  record.normal = {0, 0, 1};
  record.radius = 2;
  record.accuracy = 0.5f;
  const Normal up = {0, 0, 1};
  const auto reaches = [&](float x, float y) { return worker::splat::record_weight(record, {x, y, 0}, up) > 0; };
  EXPECT_TRUE(reaches(0.9f, 0)) << "a round one reaches a R";
  EXPECT_TRUE(reaches(0, 0.9f));
  record.hessian = {std::sqrt(15.0f), 0, 0};  // a quarter of that along x
  EXPECT_TRUE(reaches(0.24f, 0));
  EXPECT_FALSE(reaches(0.26f, 0));
  EXPECT_TRUE(reaches(0, 0.9f));
}

// On a floor that one light from x = 0 brightens as 1 + x^2: records end along x alone.
TEST(SplatHessian, PlacesReachAcrossWhatBendsTheLight) {
  std::vector<SplatPlace> places(9);
  std::vector<CacheRecord> records(9);
  for (std::size_t i = 0; i < places.size(); ++i) {
    places[i].point.position = {0.3f * static_cast<float>(i % 3), 0.3f * static_cast<float>(i / 3), 0};
    places[i].point.normal = {0, 0, 1};
    places[i].point.factor = {2, 0.5f, 2};  // radius, accuracy, mean distance
    places[i].point.footprint = 0.001f;
    records[i] = {};
    records[i].position = places[i].point.position;
    records[i].normal = {0, 0, 1};
    records[i].radius = 2;
    records[i].accuracy = 0.5f;
    records[i].irradiance = {1, 1, 1};
    records[i].hessian = {-4, 0, 0};
  }
  worker::shape_places({.least_radius = 10, .most_radius = 10000}, places, records);
  for (const SplatPlace& place : places) {
    EXPECT_EQ(place.shaped, 1u);
    EXPECT_NEAR(place.point.factor[0], 4, 1e-5) << "twice the mean distance, where nothing bends";
    // E'' d^2 / 2 = a^2 E / 2 at d = a R: R = 1 / sqrt(4).
    EXPECT_NEAR(4 / std::sqrt(1 + std::pow(place.narrow[0], 2) + std::pow(place.narrow[1], 2)), 0.5, 1e-5);
    EXPECT_NEAR(place.narrow[1], 0, 1e-5);
  }
}

// New places are shaped like the given ones, and whoever finds a surface near them shrinks them all the same.
TEST(SplatHessian, NewPlacesAreShapedLikeGivenOnes) {
  worker::SelectSettings s{
      .width = 32, .height = 32, .samples = 1, .accuracy = 0.5f, .least_radius = 1, .most_radius = 1000};
  std::vector<SplatPoint> points(32 * 32);
  for (std::size_t i = 0; i < points.size(); ++i) {
    const std::size_t tile = i / 64, at = i % 64, x = tile % 4 * 8 + at % 8, y = tile / 4 * 8 + at / 8;
    points[i] = {};
    points[i].position = {static_cast<float>(x) / 32, static_cast<float>(y) / 32, 0};
    points[i].normal = points[i].geometric = {0, 0, 1};
    points[i].footprint = 1.0f / 32;
    points[i].table = GLEANER_NONE;
  }
  const auto all_at = [](float mean) {
    return [mean](std::span<const std::uint32_t> asked) {
      return std::vector<worker::Surroundings>(asked.size(), {.mean = mean});
    };
  };
  const worker::Selection::Place given{.point = points[0], .mean = 1, .radius = 0.8f, .narrow = {3, 0}, .shaped = true};
  const worker::Selection made = worker::select_places(s, points, std::span(&given, 1), all_at(1));
  EXPECT_TRUE(made.whole);
  ASSERT_GT(made.places.size(), 2u);
  EXPECT_NEAR(made.places[1].radius, 0.8f, 1e-5f);
  EXPECT_NEAR(std::abs(made.places[1].narrow[0]), 3, 1e-4f);
  const worker::Selection shrunk = worker::select_places(s, points, std::span(&given, 1), all_at(0.05f));
  EXPECT_TRUE(shrunk.whole);
  EXPECT_LT(shrunk.places[0].radius, 0.7f);
  EXPECT_GT(shrunk.places.size(), made.places.size());
}

double error_of(const Rendered& made, const Rendered& exact) {
  double off = 0, sum = 0;
  const std::vector<float> a = made.floats("splat.shade"), b = exact.floats("splat.shade");
  for (std::size_t i = 0; i < a.size(); ++i) off += std::pow(a[i] - b[i], 2), sum += b[i];
  return std::sqrt(off / static_cast<double>(a.size())) / (sum / static_cast<double>(a.size()));
}

// As many records by mean distances would err more: their error is taken for a power of their number.
TEST(SplatHessian, RecordsErrLessThanAsManyByMeanDistances) {
  Frame frame = square_frame("splat", scene::make_scene("cornell-box", {}), {}, 96, 1, {});
  frame.settings.set = {{"splat.accuracy", "0"}, {"splat.gather_rays", "1024"}, {"splat.smooth", "0"}};
  const Rendered exact = render(frame);
  struct Point {
    double records, error;
  };
  const auto made = [&](const char* accuracy, const char* hessian) {
    frame.settings.set = {{"splat.accuracy", accuracy}, {"splat.gather_rays", "2048"}, {"splat.hessian", hessian}};
    const Rendered picture = render(frame);
    const Point point{static_cast<double>(picture.results.at("splat.select").counts[0]), error_of(picture, exact)};
    std::printf("  Hessians %s: %.0f records, off by %.2f %%\n", hessian, point.records, 100 * point.error);
    return point;
  };
  const Point few = made("0.5", "0"), many = made("0.35", "0"), shaped = made("0.35", "1");
  const double power = std::log(many.error / few.error) / std::log(many.records / few.records);
  const double expected = few.error * std::pow(shaped.records / few.records, power);
  std::printf("  as many by mean distances: %.2f %%\n", 100 * expected);
  EXPECT_LT(power, 0);
  EXPECT_LT(shaped.error, 0.95 * expected);
}

}  // namespace
}  // namespace gleaner::test

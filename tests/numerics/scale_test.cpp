// The same scene at another size or in another place gives the same picture. Random numbers are the same, so that a
// path differs only where rounding takes it to the other side of an edge.
//
// Sizes that are powers of two change no rounding at all: pictures are equal to the bit unless some length in the
// program is absolute.

#include <gtest/gtest.h>

#include "scene/library/library.h"
#include "tests/numerics/rendering.h"

namespace gleaner::test {
namespace {

using ScaleAndPlace = WithRenderer;

constexpr Shot kShot{.width = 48, .height = 48, .samples = 64, .depth = 8};

void scale(scene::Scene& scene, float factor) {
  for (float& x : scene.positions) x *= factor;
  for (auto& camera : scene.cameras)
    for (float& x : camera.camera.origin) x *= factor;
}

Picture picture_of(Renderer& renderer, const scene::Scene& scene) {
  return renderer.render(scene, scene.cameras[0].camera, kShot);
}

// Root mean square of the difference over the mean: the project's measure of error.
double error_between(const Picture& a, const Picture& b) {
  const auto x = a.radiance(kShot.samples), y = b.radiance(kShot.samples);
  double squares = 0, sum = 0;
  for (std::size_t i = 0; i < x.size(); ++i) {
    squares += (x[i] - y[i]) * (x[i] - y[i]);
    sum += x[i];
  }
  return std::sqrt(squares / static_cast<double>(x.size())) / (sum / static_cast<double>(x.size()));
}

double bias_between(const Picture& a, const Picture& b) {
  const auto x = a.radiance(kShot.samples), y = b.radiance(kShot.samples);
  double difference = 0, sum = 0;
  for (std::size_t i = 0; i < x.size(); ++i) difference += y[i] - x[i], sum += x[i];
  return difference / sum;
}

TEST_P(ScaleAndPlace, PowersOfTwoChangeNoBit) {
  const scene::Scene scene = scene::make_scene("cornell-box");
  const Picture once = picture_of(*renderer_, scene);
  for (const float factor : {0x1p-13f, 0x1p13f}) {
    scene::Scene other = scene;
    scale(other, factor);
    const Picture scaled = picture_of(*renderer_, other);
    std::size_t differ = 0;
    for (std::size_t i = 0; i < once.records.size(); ++i)
      differ += std::memcmp(&once.records[i].direct, &scaled.records[i].direct, 6 * sizeof(float)) != 0;
    std::printf("times %g: %zu of %zu pixels differ\n", static_cast<double>(factor), differ, once.records.size());
    EXPECT_EQ(differ, 0u) << "times " << factor;
    EXPECT_EQ(once.counters.scatter_rays, scaled.counters.scatter_rays);
    EXPECT_EQ(once.counters.shadow_rays, scaled.counters.shadow_rays);
  }
}

TEST_P(ScaleAndPlace, OtherSizesChangeFewPaths) {
  const scene::Scene scene = scene::make_scene("cornell-box");
  const Picture once = picture_of(*renderer_, scene);
  for (const float factor : {1e-4f, 1e-2f, 1e2f, 1e4f}) {
    scene::Scene other = scene;
    scale(other, factor);
    const Picture scaled = picture_of(*renderer_, other);
    const double error = error_between(once, scaled), bias = bias_between(once, scaled);
    std::printf("times %g: error %.2g, bias %+.2g\n", static_cast<double>(factor), error, bias);
    EXPECT_LT(error, 0.01) << "times " << factor;
    EXPECT_LT(std::fabs(bias), 0.001) << "times " << factor;
  }
}

// 10^5 m out, floats are 1/128 to 1/64 m apart: the room of 2 m stands on that grid, hit points do not.
TEST_P(ScaleAndPlace, FarPlacesChangeLittle) {
  const scene::Scene near = scene::make_scene("far", {{"x", "0"}, {"y", "0"}, {"z", "0"}});
  const Picture once = picture_of(*renderer_, near);
  const std::map<std::string, std::string> places[] = {
      {{"x", "100000"}, {"y", "100000"}, {"z", "100000"}},
      {{"x", "148376"}, {"y", "1234"}, {"z", "-223423"}},
  };
  for (const auto& place : places) {
    const Picture moved = picture_of(*renderer_, scene::make_scene("far", place));
    const double error = error_between(once, moved), bias = bias_between(once, moved);
    std::printf("at (%s, %s, %s): error %.2g, bias %+.2g\n", place.at("x").c_str(), place.at("y").c_str(),
                place.at("z").c_str(), error, bias);
    EXPECT_LT(error, 0.1);
    EXPECT_LT(std::fabs(bias), 0.02);
  }
}

INSTANTIATE_TEST_SUITE_P(Tracer, ScaleAndPlace, both_tracers(), tracer_name);

}  // namespace
}  // namespace gleaner::test

// Method `splat`: gradients of environments that are known, the whole picture against the path tracer, and records that
// do not depend on batches.

#include <cmath>
#include <functional>
#include <numbers>
#include <random>

#include "scene/library/library.h"
#include "tests/radiometry/rendered_frame.h"
#include "worker/stages/splat/irradiance.h"

namespace gleaner::test {
namespace {

using worker::CacheRecord;
using worker::HemisphereGrid;
using worker::HemisphereSample;

// A record on the plane z = 0 under an environment, which is infinitely far.
CacheRecord under(const std::function<double(double x, double y, double z)>& radiance) {
  const HemisphereGrid grid{16, 64};
  std::mt19937 random(1);
  std::uniform_real_distribution<double> number;
  std::vector<HemisphereSample> samples;
  for (std::uint32_t j = 0; j < grid.polar; ++j)
    for (std::uint32_t k = 0; k < grid.azimuthal; ++k) {
      const double sine = std::sqrt((j + number(random)) / grid.polar);
      const double phi = 2 * std::numbers::pi * (k + number(random)) / grid.azimuthal;
      const double x = sine * std::cos(phi), y = sine * std::sin(phi), z = std::sqrt(1 - sine * sine);
      const auto light = static_cast<float>(radiance(x, y, z));
      samples.push_back({{light, light, light}, 0, static_cast<float>(x), static_cast<float>(y)});
    }
  worker::SplatPoint place{};
  place.normal = place.geometric = {0, 0, 1};
  place.factor[0] = 1;
  place.footprint = 1;
  return worker::cache_record(place, grid, samples);
}

TEST(Splat, GradientsOfAConstantEnvironmentVanish) {
  const CacheRecord record = under([](double, double, double) { return 3.0; });
  EXPECT_NEAR(record.irradiance[0], 3 * std::numbers::pi, 1e-5);
  for (std::size_t k = 0; k < 9; ++k) {
    EXPECT_NEAR(record.rotation[k], 0, 1e-5) << k;
    EXPECT_NEAR(record.translation[k], 0, 1e-5) << k;
  }
}

// Radiance 2 + b.w gives the irradiance 2 pi + 2/3 pi b.n: its derivative by rotation is 2/3 pi n x b.
TEST(Splat, RotationGradientOfALinearEnvironmentIsExact) {
  const CacheRecord record = under([](double x, double y, double z) { return 2 + 0.5 * x - 0.25 * y + 0.125 * z; });
  const double third = 2 * std::numbers::pi / 3;
  EXPECT_NEAR(record.rotation[0], third * 0.25, 1e-5);
  EXPECT_NEAR(record.rotation[1], third * 0.5, 1e-5);
  EXPECT_NEAR(record.rotation[2], 0, 1e-5);
  for (std::size_t k = 0; k < 9; ++k) EXPECT_NEAR(record.translation[k], 0, 1e-5) << k;
}

// Radiance x^3, which is not linear: the integral of L (n x w) has the y part of x^4.
TEST(Splat, RotationGradientOfACubicEnvironment) {
  const CacheRecord record = under([](double x, double, double) { return x * x * x; });
  // The integral of x^4 over the hemisphere is 2 pi / 5.
  EXPECT_NEAR(record.rotation[1], 2 * std::numbers::pi / 5, 0.02);
  EXPECT_NEAR(record.rotation[0], 0, 0.02);
}

TEST(Splat, MeanIsThePathTracers) {
  const Scene scene = scene::make_scene("cornell-box", {});
  const Rendered path = render(square_frame("path", scene, {}, 32, 4096, {}));
  for (const char* accuracy : {"0.25", "0"}) {
    const Rendered made = render(
        square_frame("splat", scene, {}, 32, 1024, {{"splat.accuracy", accuracy}, {"splat.gather_rays", "256"}}));
    for (const char* channel : {"R", "G", "B"}) {
      const double expected = mean_of(path.film, channel), found = mean_of(made.film, channel);
      std::printf("  accuracy %s, %s: %.6f, expected %.6f\n", accuracy, channel, found, expected);
      EXPECT_NEAR(found / expected, 1, 0.005) << accuracy << ", " << channel;
    }
  }
}

TEST(Splat, RecordsDoNotDependOnBatches) {
  const Frame frame =
      square_frame("splat", scene::make_scene("cornell-glass", {}), {}, 32, 4, {{"splat.gather_rays", "64"}});
  const Rendered made = render(frame);
  worker::Executor two({.device = -1, .threads = 2, .trace = worker::TraceKind::automatic});
  two.load_scene("two", frame.scene, nullptr);
  for (const char* name : {"splat.points", "splat.select", "splat.gather", "splat.shade"}) {
    const coordinator::StageSpec& spec = made.specs.at(name);
    const worker::BatchResult& whole = made.results.at(name);
    worker::StageTask task = made.tasks.at(name);
    task.scene = "two";
    for (auto& [input, to] : task.inputs) to.own_items = false;
    std::size_t at = 0;
    for (std::uint64_t first = 0; first < spec.items;) {
      const std::uint64_t count = std::min<std::uint64_t>(spec.items - first, 5);
      const worker::BatchResult part = two.run(task, first, count);
      ASSERT_LE(at + part.records.size(), whole.records.size()) << name;
      ASSERT_EQ(std::memcmp(part.records.data(), whole.records.data() + at, part.records.size()), 0)
          << name << ", items from " << first;
      at += part.records.size();
      first += count;
    }
    EXPECT_EQ(at, whole.records.size()) << name;
  }
}

}  // namespace
}  // namespace gleaner::test

// Algorithms on the host end soon where nobody wants their batch any more.

#include "worker/wavefront/wanted.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <functional>

#include "kernels/scene_layout.h"
#include "scene/model/error.h"
#include "worker/stages/links/mesh.h"
#include "worker/stages/photon/seeding.h"
#include "worker/stages/splat/select.h"
#include "worker/wavefront/host_threads.h"

namespace gleaner::worker {
namespace {

using testing::HasSubstr;

std::string error_of(const std::function<void()>& act) {
  try {
    act();
  } catch (const Error& error) {
    return error.what();
  }
  return "no error";
}

TEST(Wanted, WithoutAScopeEverythingIs) {
  EXPECT_EQ(given_up_flag(), nullptr);
  check_wanted();
}

TEST(Wanted, InnerScopesEndAlone) {
  const std::atomic<bool> outer = true, inner = false;
  const WantedScope around(&outer);
  {
    const WantedScope within(&inner);
    check_wanted();
  }
  EXPECT_THAT(error_of(check_wanted), HasSubstr(nobody_wants_it));
}

TEST(Wanted, ThreadsInheritIt) {
  const std::atomic<bool> given_up = true;
  const WantedScope wanted(&given_up);
  std::atomic<int> stopped = 0;
  run_threads(3, [&](unsigned) { stopped += error_of(check_wanted) == nobody_wants_it; });
  EXPECT_EQ(stopped, 3);
}

TEST(Wanted, QueuesGiveNothingOutAfterwards) {
  std::atomic<bool> given_up = false;
  const WantedScope wanted(&given_up);
  WorkQueue work(1000, 2);
  EXPECT_TRUE(work.claim(16));
  given_up = true;
  EXPECT_FALSE(work.claim(16));
  EXPECT_TRUE(work.stopped());
}

// A picture of one tile of points in a plane, a metre apart.
std::vector<SplatPoint> plane() {
  std::vector<SplatPoint> points(SPLAT_TILE * SPLAT_TILE);
  for (std::size_t i = 0; i < points.size(); ++i) {
    points[i] = {};
    points[i].position = {static_cast<float>(i % SPLAT_TILE), static_cast<float>(i / SPLAT_TILE), 0};
    points[i].normal = points[i].geometric = {0, 0, 1};
    points[i].factor = {1, 1, 1};
    points[i].footprint = 1;
  }
  return points;
}

TEST(Wanted, SelectionEndsAfterItsRound) {
  std::atomic<bool> given_up = false;
  const WantedScope wanted(&given_up);
  const std::vector<SplatPoint> points = plane();
  const SelectSettings settings{
      .width = SPLAT_TILE, .height = SPLAT_TILE, .samples = 1, .accuracy = 0.1f, .least_radius = 1, .most_radius = 2};
  int rounds = 0;
  const auto probe = [&](std::span<const std::uint32_t> asked) {
    given_up = ++rounds == 2;
    return std::vector<Surroundings>(asked.size(), {.mean = 1});
  };
  EXPECT_THAT(error_of([&] { select_places(settings, points, {}, probe); }), HasSubstr(nobody_wants_it));
  EXPECT_EQ(rounds, 2);
}

TEST(Wanted, SeedingEnds) {
  const std::atomic<bool> given_up = true;
  std::vector<float> data;
  std::vector<ScreenPoint> points;
  for (std::uint32_t i = 0; i < 64; ++i) {
    points.push_back({i % 8, i / 8, i});
    for (int k = 0; k < 6; ++k) data.push_back(static_cast<float>(i * k % 7));
  }
  const auto seeds = [&] { return seeds_by_variation(data, 6, points, 16, 1); };
  EXPECT_EQ(seeds().size(), 16u);
  const WantedScope wanted(&given_up);
  EXPECT_THAT(error_of(seeds), HasSubstr(nobody_wants_it));
}

TEST(Wanted, MeshesEnd) {
  const std::atomic<bool> given_up = true;
  std::vector<float> row(64, 0);
  row[TRIANGLE_P1] = row[TRIANGLE_P1 + 4] = 1;  // a right angle in the plane z = 0
  const TriangleRows triangle{row.data(), 64, 1};
  const WantedScope wanted(&given_up);
  kernels::LinksMeshFacts facts{};
  EXPECT_THAT(error_of([&] { make_links_mesh(triangle, {2}, &facts); }), HasSubstr(nobody_wants_it));
  EXPECT_THAT(error_of([&] { even_levels(triangle, {.vertices = 100, .beside_own = 0, .reserved = {}}); }),
              HasSubstr(nobody_wants_it));
}

}  // namespace
}  // namespace gleaner::worker

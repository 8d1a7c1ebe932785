// Where records of radiance cache splatting are: the selection by rounds of blocks beside the paper's serial loop, and
// beside records that exist already. The rooms and the distances in them are computed here.

#include "worker/stages/splat/select.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <limits>
#include <numbers>
#include <random>
#include <vector>

#include "worker/stages/splat/scalar.h"

namespace gleaner::test {
namespace {

using worker::Selection;
using worker::SelectSettings;
using worker::SplatPoint;
using Vec = std::array<double, 3>;

Vec along(const Vec& origin, const Vec& direction, double t) {
  return {origin[0] + t * direction[0], origin[1] + t * direction[1], origin[2] + t * direction[2]};
}
double dot(const Vec& a, const Vec& b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }
Vec unit(const Vec& v) { return along({0, 0, 0}, v, 1 / std::sqrt(dot(v, v))); }

struct Sphere {
  Vec center;
  double radius;
};
struct Box {
  Vec lower, upper;
};

// A box seen from inside, and what stands in it.
struct Room {
  Box walls;
  std::vector<Sphere> spheres;
  std::vector<Box> boxes;
  Vec eye;
};

struct Hit {
  double t = std::numeric_limits<double>::infinity();
  Vec normal{};
};

void meet(const Box& box, bool inside, const Vec& o, const Vec& d, Hit& hit) {
  double near = -std::numeric_limits<double>::infinity(), far = -near;
  int near_axis = 0, far_axis = 0;
  for (int k = 0; k < 3; ++k) {
    const double a = (box.lower[k] - o[k]) / d[k], b = (box.upper[k] - o[k]) / d[k];
    if (std::min(a, b) > near) near = std::min(a, b), near_axis = k;
    if (std::max(a, b) < far) far = std::max(a, b), far_axis = k;
  }
  const double t = inside ? far : near;
  if (near > far || t < 1e-9 || t >= hit.t) return;
  const int axis = inside ? far_axis : near_axis;
  hit = {t, {}};
  hit.normal[axis] = d[axis] > 0 ? -1 : 1;
}

void meet(const Sphere& sphere, const Vec& o, const Vec& d, Hit& hit) {
  const Vec to = along(o, sphere.center, -1);
  const double b = dot(to, d), c = dot(to, to) - sphere.radius * sphere.radius, root = b * b - c;
  if (root <= 0) return;
  const double t = -b - std::sqrt(root);
  if (t < 1e-9 || t >= hit.t) return;
  hit = {t, unit(along(along(o, d, t), sphere.center, -1))};
}

Hit first_hit(const Room& room, const Vec& o, const Vec& d) {
  Hit hit;
  meet(room.walls, true, o, d, hit);
  for (const Sphere& sphere : room.spheres) meet(sphere, o, d, hit);
  for (const Box& box : room.boxes) meet(box, false, o, d, hit);
  return hit;
}

Room hall() {
  Room room{.walls = {{-4, 0, -24}, {4, 6, 2}}, .spheres = {{{0, 0.7, -6}, 0.7}}, .boxes = {}, .eye = {0.2, 1.7, 1}};
  for (int row = 0; row < 6; ++row)
    for (const double x : {-2.5, 2.5}) {
      const double z = -3.0 - 3 * row;
      room.boxes.push_back({{x - 0.3, 0, z - 0.3}, {x + 0.3, 4.5, z + 0.3}});
      room.spheres.push_back({{x, 4.5, z}, 0.55});
    }
  return room;
}

Room cornell() {
  return {.walls = {{-1, 0, -1}, {1, 2, 3.8}},
          .spheres = {{{-0.4, 0.35, 0.3}, 0.35}},
          .boxes = {{{0.1, 0, -0.6}, {0.7, 1.2, 0}}},
          .eye = {0, 1, 3.6}};
}

// Looks towards -z. Points in the order of kernels/splat_records.h.
std::vector<SplatPoint> points_of(const Room& room, const SelectSettings& s) {
  std::mt19937 random(7);
  std::uniform_real_distribution<double> number;
  std::vector<SplatPoint> points;
  const std::uint32_t columns = worker::splat_tiles(s.width), rows = worker::splat_tiles(s.height);
  for (std::uint32_t tile = 0; tile < columns * rows; ++tile)
    for (std::uint32_t place = 0; place < SPLAT_TILE_PIXELS; ++place)
      for (std::uint32_t sample = 0; sample < s.samples; ++sample) {
        const std::uint32_t x = tile % columns * SPLAT_TILE + place % SPLAT_TILE,
                            y = tile / columns * SPLAT_TILE + place / SPLAT_TILE;
        SplatPoint point{};
        if (x < s.width && y < s.height) {
          const Vec d = unit(
              {(2 * (x + number(random)) / s.width - 1) * 0.6, (1 - 2 * (y + number(random)) / s.height) * 0.6, -1});
          const Hit hit = first_hit(room, room.eye, d);
          const Vec p = along(room.eye, d, hit.t);
          for (std::size_t k = 0; k < 3; ++k) {
            point.position[k] = static_cast<float>(p[k]);
            point.normal[k] = point.geometric[k] = static_cast<float>(hit.normal[k]);
          }
          point.footprint = static_cast<float>(hit.t * 1.2 / s.width);
        }
        points.push_back(point);
      }
  return points;
}

float harmonic_mean(const Room& room, const SplatPoint& point, std::uint32_t seed) {
  std::mt19937 random(seed);
  std::uniform_real_distribution<double> number;
  constexpr int rays = 64;
  const Vec n = {point.normal[0], point.normal[1], point.normal[2]};
  const Vec p = along({point.position[0], point.position[1], point.position[2]}, n, 1e-6);
  double nearness = 0;
  for (int k = 0; k < rays; ++k) {
    const double z = 2 * number(random) - 1, turn = 2 * std::numbers::pi * number(random),
                 across = std::sqrt(1 - z * z);
    // A point of the unit sphere that stands on the surface: cosine-weighted.
    nearness += 1 / first_hit(room, p, unit(along(n, {across * std::cos(turn), across * std::sin(turn), z}, 1))).t;
  }
  return static_cast<float>(rays / nearness);
}

worker::ProbePoints probe_of(const Room& room, const std::vector<SplatPoint>& points) {
  return [&](std::span<const std::uint32_t> asked) {
    std::vector<worker::Surroundings> found;
    for (const std::uint32_t point : asked) found.push_back({.mean = harmonic_mean(room, points[point], point)});
    return found;
  };
}

// Eq. 2 to 4, in double precision; `slack` of the accuracy is forgiven.
bool covers(const Selection::Place& place, const SplatPoint& point, double accuracy, double slack = 0) {
  Vec d{}, n{}, m{};
  for (std::size_t k = 0; k < 3; ++k) {
    d[k] = double{point.position[k]} - place.point.position[k];
    n[k] = point.normal[k];
    m[k] = place.point.normal[k];
  }
  const double away = std::sqrt(dot(d, d));
  if (away / place.radius + std::sqrt(std::max(0.0, 1 - dot(n, m))) > accuracy * (1 + slack)) return false;
  return (dot(d, n) + dot(d, m)) / 2 >= -double{SPLAT_MOST_DEPTH} * away * (1 - double{SPLAT_SLACK} + slack);
}

// Algorithm 2 of the paper: pixels one after the other, row by row; where the records so far do not suffice, another.
// `clamps`: no mean distance exceeds a neighbour's by more than 3/2 of the way to it; the paper's may.
std::size_t serial_records(const SelectSettings& s, const std::vector<SplatPoint>& points,
                           const worker::ProbePoints& probe, bool clamps) {
  std::vector<Selection::Place> places;
  const auto bounded = [&](const SplatPoint& point, float mean) {
    return std::clamp(mean, s.least_radius * point.footprint, s.most_radius * point.footprint);
  };
  const auto apart = [](const SplatPoint& a, const SplatPoint& b) {
    float squared = 0;
    for (std::size_t k = 0; k < 3; ++k) squared += (a.position[k] - b.position[k]) * (a.position[k] - b.position[k]);
    return std::sqrt(squared);
  };
  const auto add = [&](std::uint32_t at) {
    const std::uint32_t asked[] = {at};
    Selection::Place added{.point = points[at], .mean = probe(asked)[0].mean};
    if (clamps)
      for (Selection::Place& other : places) {
        const float distance = 1.5f * apart(other.point, added.point);
        added.mean = std::min(added.mean, other.mean + distance);
      }
    if (clamps)
      for (Selection::Place& other : places) {
        other.mean = std::min(other.mean, added.mean + 1.5f * apart(other.point, added.point));
        other.radius = bounded(other.point, other.mean);
      }
    added.radius = bounded(added.point, added.mean);
    places.push_back(added);
  };
  const std::uint32_t columns = worker::splat_tiles(s.width);
  for (std::size_t before = 1, after = 0; before != after;) {
    before = places.size();
    for (std::uint32_t y = 0; y < s.height; ++y)
      for (std::uint32_t x = 0; x < s.width; ++x)
        for (std::uint32_t sample = 0; sample < s.samples; ++sample) {
          const std::uint32_t tile = y / SPLAT_TILE * columns + x / SPLAT_TILE,
                              place = y % SPLAT_TILE * SPLAT_TILE + x % SPLAT_TILE,
                              at = (tile * SPLAT_TILE_PIXELS + place) * s.samples + sample;
          if (std::ranges::none_of(places, [&](const auto& one) { return covers(one, points[at], s.accuracy); }))
            add(at);
        }
    after = places.size();
  }
  return places.size();
}

SelectSettings settings_of(std::uint32_t size, std::uint32_t samples, float accuracy) {
  return {.width = size,
          .height = size,
          .samples = samples,
          .accuracy = accuracy,
          .least_radius = 10,
          .most_radius = 0.5f * static_cast<float>(size)};
}

void expect_covered(const SelectSettings& s, const Selection& selection, const std::vector<SplatPoint>& points) {
  EXPECT_TRUE(selection.whole);
  std::size_t bare = 0;
  for (const SplatPoint& point : points)
    if (point.exists() && std::ranges::none_of(selection.places, [&](const auto& place) {
          return covers(place, point, s.accuracy, 1e-3);
        }))
      ++bare;
  EXPECT_EQ(bare, 0u);
}

TEST(SplatSelect, AsFewRecordsAsTheSerialLoop) {
  for (const auto& [name, room] : {std::pair{"box", cornell()}, {"hall", hall()}})
    for (const float accuracy : {0.15f, 0.3f}) {
      const SelectSettings s = settings_of(120, 1, accuracy);
      const std::vector<SplatPoint> points = points_of(room, s);
      const auto probe = probe_of(room, points);
      const Selection ours = worker::select_places(s, points, {}, probe);
      expect_covered(s, ours, points);
      const std::size_t serial = serial_records(s, points, probe, true),
                        paper = serial_records(s, points, probe, false);
      std::printf(
          "  %s, accuracy %.2f: %zu records in %llu rounds, %zu by the serial loop, %zu without clamped neighbours\n",
          name, static_cast<double>(accuracy), ours.places.size(), static_cast<unsigned long long>(ours.rounds), serial,
          paper);
      EXPECT_NEAR(static_cast<double>(ours.places.size()) / static_cast<double>(serial), 1, 0.15)
          << name << ", " << accuracy;
      // One block is the serial loop but for the order of the pixels.
      SelectSettings one = s;
      one.block_tiles = 0;
      const Selection alone = worker::select_places(one, points, {}, probe);
      EXPECT_EQ(alone.rounds, alone.probes);
      EXPECT_NEAR(static_cast<double>(alone.places.size()) / static_cast<double>(serial), 1, 0.15)
          << name << ", " << accuracy;
    }
}

TEST(SplatSelect, PlacesAreTheSameByAnyNumberOfThreads) {
  const Room room = hall();
  SelectSettings s = settings_of(96, 2, 0.2f);
  const std::vector<SplatPoint> points = points_of(room, s);
  const auto probe = probe_of(room, points);
  const Selection one = worker::select_places(s, points, {}, probe);
  s.threads = 3;
  const Selection three = worker::select_places(s, points, {}, probe);
  EXPECT_EQ(one.probes, three.probes);
  ASSERT_EQ(one.places.size(), three.places.size());
  for (std::size_t i = 0; i < one.places.size(); ++i) {
    ASSERT_EQ(one.places[i].point.position, three.places[i].point.position) << i;
    ASSERT_EQ(one.places[i].radius, three.places[i].radius) << i;
  }
}

// What is covered gets no more records; what is given stays, first and in its order.
TEST(SplatSelect, GivenRecordsServe) {
  const Room room = hall();
  const SelectSettings s = settings_of(96, 2, 0.2f);
  const std::vector<SplatPoint> points = points_of(room, s);
  const auto probe = probe_of(room, points);
  const Selection first = worker::select_places(s, points, {}, probe);
  const Selection again = worker::select_places(s, points, first.places, probe);
  EXPECT_EQ(again.places.size(), first.places.size());
  EXPECT_EQ(again.probes, 0u);
  EXPECT_TRUE(again.whole);

  Room moved = room;
  moved.eye[0] += 0.3;
  moved.eye[2] -= 0.5;
  const std::vector<SplatPoint> others = points_of(moved, s);
  const Selection next = worker::select_places(s, others, first.places, probe_of(moved, others));
  const Selection alone = worker::select_places(s, others, {}, probe_of(moved, others));
  expect_covered(s, next, others);
  std::printf("  %zu records, %zu new ones from a step aside, %zu for that alone\n", first.places.size(),
              next.places.size() - first.places.size(), alone.places.size());
  ASSERT_GT(next.places.size(), first.places.size());
  EXPECT_LT(next.places.size() - first.places.size(), alone.places.size() / 2);
  for (std::size_t k = 0; k < first.places.size(); ++k) {
    EXPECT_EQ(next.places[k].point.position, first.places[k].point.position) << k;
    EXPECT_LE(next.places[k].radius, first.places[k].radius) << k;
  }
}

// A record that was chosen from far away reaches, from near by, no more pixels than one that is chosen there.
TEST(SplatSelect, RecordsSeenFromNearbyReachLess) {
  const Room room = hall();
  SelectSettings s = settings_of(64, 1, 0.3f);
  const std::vector<SplatPoint> points = points_of(room, s);
  const Selection far = worker::select_places(s, points, {}, probe_of(room, points));
  Room near = room;
  near.eye[2] = -21;
  const std::vector<SplatPoint> seen = points_of(near, s);
  const Selection made = worker::select_places(s, seen, far.places, probe_of(near, seen));
  std::size_t smaller = 0;
  for (std::size_t k = 0; k < far.places.size(); ++k) smaller += made.places[k].radius < 0.9f * far.places[k].radius;
  EXPECT_GT(smaller, 0u);
  expect_covered(s, made, seen);
}

TEST(SplatSelect, GivesUpBeyondSoManyNewOnes) {
  const Room room = cornell();
  SelectSettings s = settings_of(64, 1, 0.2f);
  const std::vector<SplatPoint> points = points_of(room, s);
  const auto probe = probe_of(room, points);
  const Selection all = worker::select_places(s, points, {}, probe);
  s.most_new = static_cast<std::uint32_t>(all.places.size()) - 1;
  EXPECT_FALSE(worker::select_places(s, points, {}, probe).whole);
  s.most_new = static_cast<std::uint32_t>(all.places.size());
  EXPECT_TRUE(worker::select_places(s, points, {}, probe).whole);
  // Given ones do not count.
  s.most_new = 1;
  EXPECT_TRUE(worker::select_places(s, points, all.places, probe).whole);
}

}  // namespace
}  // namespace gleaner::test

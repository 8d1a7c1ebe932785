// Records of a cache that are blended with their neighbours: less noise, nothing lost where there is none, and a noise
// that is told truly.

#include <gtest/gtest.h>

#include <cmath>
#include <cstring>
#include <functional>
#include <random>
#include <utility>
#include <vector>

#include "worker/stages/splat/reading.h"
#include "worker/stages/splat/smooth.h"

namespace gleaner::test {
namespace {

using worker::CacheRecord;

using Field = std::function<double(double x, double y)>;

// Records on a jittered grid of the unit square, as far apart as selection leaves them; each off by its own part of the
// light, and with a word of its noise that knows nothing of it.
std::vector<CacheRecord> records_of(const Field& field, double noise, unsigned seed = 1) {
  constexpr int kEdge = 40;
  constexpr float kSpacing = 1.0f / kEdge;
  std::mt19937 random(seed);
  std::uniform_real_distribution<float> place(-0.3f, 0.3f);
  std::normal_distribution<double> off(0, noise);
  std::vector<CacheRecord> records;
  for (int x = 0; x < kEdge; ++x)
    for (int y = 0; y < kEdge; ++y) {
      CacheRecord r{};
      r.position = {kSpacing * (static_cast<float>(x) + place(random)),
                    kSpacing * (static_cast<float>(y) + place(random)), 0};
      r.normal = {0, 0, 1};
      r.accuracy = 0.25f;
      r.radius = kSpacing / r.accuracy;
      const double p = r.position[0], q = r.position[1], step = 1e-3, factor = 1 + off(random);
      for (std::size_t c = 0; c < 3; ++c) {
        r.irradiance[c] = static_cast<float>(field(p, q) * factor);
        r.translation[3 * c] = static_cast<float>((field(p + step, q) - field(p - step, q)) / (2 * step) * factor);
        r.translation[3 * c + 1] = static_cast<float>((field(p, q + step) - field(p, q - step)) / (2 * step) * factor);
      }
      r.spare[CACHE_NOISE - CACHE_SPARE] = static_cast<float>(off(random));
      records.push_back(r);
    }
  return records;
}

struct Errors {
  double mean = 0, rms = 0, told = 0;  // over the light, of which `told` is what the records say of themselves
};

Errors errors_of(const std::vector<CacheRecord>& records, const Field& field) {
  Errors errors;
  for (const CacheRecord& r : records) {
    const double truth = field(r.position[0], r.position[1]), off = r.irradiance[0] / truth - 1;
    errors.mean += off / static_cast<double>(records.size());
    errors.rms += off * off;
    errors.told += std::pow(worker::splat::record_noise(r)[0] / truth, 2);
  }
  errors.rms = std::sqrt(errors.rms / static_cast<double>(records.size()));
  errors.told = std::sqrt(errors.told / static_cast<double>(records.size()));
  return errors;
}

double smooth_field(double x, double y) { return 1 + 0.5 * std::sin(2 * x) * std::cos(3 * y); }

TEST(SplatSmooth, NoiseFallsAndIsToldTruly) {
  for (const double noise : {0.02, 0.1, 0.3}) {
    const auto records = records_of(smooth_field, noise);
    const Errors before = errors_of(records, smooth_field),
                 after = errors_of(worker::smooth_cache(records, 2), smooth_field);
    EXPECT_LT(after.rms, 0.5 * before.rms) << noise;
    EXPECT_LT(std::abs(after.mean), 4 * noise / 40) << noise << ": four of its mean's deviations";
    EXPECT_NEAR(after.told / after.rms, 1, 0.25) << noise;
  }
}

TEST(SplatSmooth, WhereNothingIsNoisyNothingMoves) {
  const auto records = records_of([](double x, double y) { return 1 + x * x + std::sin(20 * y); }, 0);
  const auto smoothed = worker::smooth_cache(records, 2);
  for (std::size_t i = 0; i < records.size(); ++i)
    ASSERT_EQ(std::memcmp(&smoothed[i], &records[i], sizeof(CacheRecord)), 0) << i;
}

// Noise is no reason to blur what is larger than it.
TEST(SplatSmooth, AnEdgeStays) {
  const Field edge = [](double x, double) { return x < 0.5 ? 1.0 : 3.0; };
  const auto records = records_of(edge, 0.05), smoothed = worker::smooth_cache(records, 2);
  for (std::size_t i = 0; i < records.size(); ++i)
    EXPECT_LT(std::abs(smoothed[i].irradiance[0] - records[i].irradiance[0]), 0.05 * 3 * 2 * 4)
        << "two of its noise's deviations, which its own word may take for twice as large";
  EXPECT_LT(errors_of(smoothed, edge).rms, 0.8 * errors_of(records, edge).rms);
}

// Waves three records long, which these meet badly.
double wavy_field(double x, double y) { return 1 + 0.1 * std::sin(80 * x) * std::cos(80 * y); }

struct Around {
  Field field = smooth_field;
  double noise = 0.05;
  float clearance = 0;  // one over the distance of walls, 1/m
};

// Smoothed light of a record, over the truth, that is three times too bright and tells so much noise.
double bright_record(float told, const Around& around = {}) {
  auto records = records_of(around.field, around.noise);
  const std::size_t at = 40 * 20 + 20;
  CacheRecord& odd = records[at];
  for (float& light : odd.irradiance) light *= 3;
  odd.spare[0] = told;
  odd.clearance.fill(around.clearance);
  odd.least_clear = around.clearance;
  const double truth = around.field(odd.position[0], odd.position[1]);
  return worker::smooth_cache(std::move(records), 2)[at].irradiance[0] / truth;
}

// A single ray that finds a lamp: one half has it, the other one has not. Its record is told by its neighbours, for
// they know how noisy records are there.
TEST(SplatSmooth, ASingleBrightRecordIsTakenBack) { EXPECT_LT(bright_record(1), 1.7); }

// So it is where walls close about it, which leave it no neighbours.
TEST(SplatSmooth, ASingleBrightRecordAmongWallsIsTakenBack) { EXPECT_LT(bright_record(1, {.clearance = 1000}), 1.7); }

// So it is where its neighbours are quiet, and differ for other reasons.
TEST(SplatSmooth, ASingleBrightRecordAmongQuietOnesIsTakenBack) {
  EXPECT_LT(bright_record(0.67f, {.field = wavy_field, .noise = 0.01}), 1.7);
}

// What single rays find by chance is light of all records near them: none of it is lost.
TEST(SplatSmooth, WhatIsTakenBackIsNotLost) {
  auto records = records_of(wavy_field, 0.01);
  std::mt19937 random(2);
  for (CacheRecord& r : records)
    if (random() % 50 == 0) {
      for (float& light : r.irradiance) light *= 3;
      r.spare[0] = random() % 2 ? 0.67f : -0.67f;
    }
  const Errors before = errors_of(records, wavy_field), after = errors_of(worker::smooth_cache(records, 2), wavy_field);
  EXPECT_NEAR(after.mean / before.mean, 1, 0.1) << before.mean;
  EXPECT_LT(after.rms, 0.5 * before.rms);
}

// Light that falls on one record alone, and that both halves of its rays have seen.
TEST(SplatSmooth, ASingleBrightRecordOfLittleNoiseStays) {
  EXPECT_GT(bright_record(0.01f), 2.7);
  EXPECT_GT(bright_record(0.01f, {.field = wavy_field, .noise = 0.01}), 2.7);
}

TEST(SplatSmooth, BitsAreTheSameByAnyNumberOfThreads) {
  auto records = records_of(wavy_field, 0.1);
  for (std::size_t i = 0; i < records.size(); i += 37) records[i].irradiance.fill(5);  // some of it is taken back
  const auto one = worker::smooth_cache(records, 1), three = worker::smooth_cache(records, 3);
  EXPECT_EQ(std::memcmp(one.data(), three.data(), records.size() * sizeof(CacheRecord)), 0);
  EXPECT_NE(std::memcmp(one.data(), records.data(), records.size() * sizeof(CacheRecord)), 0);
}

// What lies in the mirror's depth, or on the other side of a wall, is no neighbour.
TEST(SplatSmooth, OtherLevelsAndSidesAreNoNeighbours) {
  auto near = records_of(smooth_field, 0.1);
  auto both = near;
  for (CacheRecord r : near) {
    for (float& light : r.irradiance) light *= 10;
    r.level = 1;
    both.push_back(r);
    r.level = 0;
    r.normal[2] = -1;
    both.push_back(r);
  }
  const auto alone = worker::smooth_cache(near, 2), among = worker::smooth_cache(both, 2);
  for (std::size_t i = 0; i < near.size(); ++i)
    ASSERT_EQ(std::memcmp(&alone[i], &among[i], sizeof(CacheRecord)), 0) << i;
}

}  // namespace
}  // namespace gleaner::test

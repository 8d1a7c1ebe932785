// What the selection of records stands on: mean distances that neighbours bound, beside all pairs of places.

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <random>
#include <vector>

#include "worker/stages/splat/clamped_means.h"
#include "worker/stages/splat/points.h"

namespace gleaner::test {
namespace {

using Vec = std::array<float, 3>;
using worker::distance;

// Every place beside every other one.
struct AllPairs {
  float slope;
  std::vector<Vec> positions{};
  std::vector<float> means{};

  float clamped(const Vec& p, float mean) const {
    for (std::size_t i = 0; i < means.size(); ++i) mean = std::min(mean, means[i] + slope * distance(positions[i], p));
    return mean;
  }
  std::size_t clamp_others(const Vec& p, float mean) {
    std::size_t changed = 0;
    for (std::size_t i = 0; i < means.size(); ++i) {
      const float most = mean + slope * distance(positions[i], p);
      if (means[i] > most) means[i] = most, ++changed;
    }
    return changed;
  }
};

TEST(SplatClampedMeans, AsAllPairsSay) {
  std::mt19937 random(3);
  std::uniform_real_distribution<float> place(-1, 1), size(-3, 1);
  worker::ClampedMeans means(1.5f);
  AllPairs pairs{1.5f};
  std::vector<float> told;
  std::size_t changes = 0, bounded = 0;
  for (std::uint32_t number = 0; number < 3000; ++number) {
    // Walls of a box, and what hangs in it; some places twice.
    Vec p = {place(random), place(random), place(random)};
    if (number % 3) p[number % 3] = number % 2 ? 1 : -1;
    if (number % 100 == 99) p = pairs.positions[number / 2];
    const float free = std::pow(10.0f, size(random));
    const float mean = pairs.clamped(p, free);
    ASSERT_EQ(means.clamped(p, free), mean) << "place " << number;
    bounded += mean < free;
    means.clamp_others(p, mean, [&](std::uint32_t other, float most) {
      ASSERT_LT(most, told[other]);
      told[other] = most;
      ++changes;
    });
    pairs.clamp_others(p, mean);
    ASSERT_EQ(told, pairs.means) << "place " << number;
    means.add(number, p, mean);
    pairs.positions.push_back(p);
    pairs.means.push_back(mean);
    told.push_back(mean);
  }
  std::printf("  3000 places, %zu of them bounded by others, %zu times one bounded another\n", bounded, changes);
  EXPECT_GT(bounded, 1000u);
  EXPECT_GT(changes, 1000u);
}

}  // namespace
}  // namespace gleaner::test

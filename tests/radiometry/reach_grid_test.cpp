// Places by the cells that they reach (worker/stages/photon/reach_grid.h).

#include "worker/stages/photon/reach_grid.h"

#include <gtest/gtest.h>

#include <cmath>
#include <random>
#include <set>
#include <vector>

namespace gleaner::test {
namespace {

using worker::ReachGrid;

// Of reaches from millimetres to a hundred metres, some of them 0, about places on both sides of the origin.
std::vector<ReachGrid::Entry> entries_of_all_sizes() {
  std::mt19937 random(7);
  std::uniform_real_distribution<float> place(-20, 20), power(-3, 2);
  std::vector<ReachGrid::Entry> entries(3000);
  for (ReachGrid::Entry& entry : entries) {
    for (float& x : entry.position) x = place(random);
    entry.reach = random() % 50 == 0 ? 0 : std::pow(10.0f, power(random));
  }
  return entries;
}

TEST(ReachGrid, AllThatReachAPlaceAreFound) {
  const auto entries = entries_of_all_sizes();
  const ReachGrid grid(entries);
  for (const ReachGrid::Entry& at : entries) {
    std::set<std::uint32_t> found;
    grid.near(at.position, [&](std::uint32_t i) { found.insert(i); });
    for (std::uint32_t i = 0; i < entries.size(); ++i) {
      double apart = 0;
      for (std::size_t k = 0; k < 3; ++k) apart += std::pow(double{entries[i].position[k]} - at.position[k], 2);
      if (std::sqrt(apart) <= entries[i].reach) {
        ASSERT_TRUE(found.contains(i)) << i << " reaches " << entries[i].reach << " m";
      }
    }
  }
}

// However unlike reaches are, a place is compared with few that do not reach it.
TEST(ReachGrid, FewOthersAreFound) {
  auto entries = entries_of_all_sizes();
  for (ReachGrid::Entry& entry : entries) entry.reach = std::min(entry.reach, 2.0f);
  const ReachGrid grid(entries);
  std::size_t found = 0;
  for (const ReachGrid::Entry& at : entries) grid.near(at.position, [&](std::uint32_t) { ++found; });
  EXPECT_LT(found, entries.size() * entries.size() / 20);
}

}  // namespace
}  // namespace gleaner::test

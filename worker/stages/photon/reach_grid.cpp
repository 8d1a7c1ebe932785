#include "worker/stages/photon/reach_grid.h"

#include <algorithm>
#include <cmath>

namespace gleaner::worker {
namespace {

// Of a cell's edge, in m: a micrometre, and beyond any scene.
constexpr int kLeastExponent = -20, kMostExponent = 60;

int exponent_of(float reach) {
  int exponent = kLeastExponent;
  std::frexp(2 * double{reach}, &exponent);
  return std::clamp(exponent, kLeastExponent, kMostExponent);
}

}  // namespace

std::uint64_t key_of(const GridCell& c) {
  return static_cast<std::uint64_t>(c[0]) * 73856093u ^ static_cast<std::uint64_t>(c[1]) * 19349663u ^
         static_cast<std::uint64_t>(c[2]) * 83492791u;
}

float median_of(std::vector<float> reaches) {
  reaches.push_back(1e-6f);
  const auto middle = reaches.begin() + static_cast<std::ptrdiff_t>(reaches.size() / 2);
  std::nth_element(reaches.begin(), middle, reaches.end());
  return std::max(*middle, 1e-6f);
}

ReachGrid::ReachGrid(std::span<const Entry> entries) {
  for (std::uint32_t i = 0; i < entries.size(); ++i) {
    const int exponent = exponent_of(entries[i].reach);
    auto level = std::ranges::find(levels_, exponent, &Level::exponent);
    if (level == levels_.end()) level = levels_.insert(level, Level{exponent});
    level->enter(i, entries[i]);
  }
}

std::int64_t ReachGrid::Level::cell_of(float x) const {
  return static_cast<std::int64_t>(std::floor(std::ldexp(double{x}, -exponent)));
}

void ReachGrid::Level::enter(std::uint32_t number, const Entry& entry) {
  std::int64_t lower[3], upper[3];
  for (std::size_t k = 0; k < 3; ++k) {
    lower[k] = cell_of(entry.position[k] - entry.reach);
    upper[k] = cell_of(entry.position[k] + entry.reach);
  }
  for (std::int64_t x = lower[0]; x <= upper[0]; ++x)
    for (std::int64_t y = lower[1]; y <= upper[1]; ++y)
      for (std::int64_t z = lower[2]; z <= upper[2]; ++z) cells[key_of({x, y, z})].push_back(number);
}

ReachGrid grid_of(std::span<const ClusterSample> samples) {
  std::vector<ReachGrid::Entry> entries;
  entries.reserve(samples.size());
  for (const ClusterSample& sample : samples) entries.push_back({sample.at.position, sample.reach});
  return ReachGrid(entries);
}

}  // namespace gleaner::worker

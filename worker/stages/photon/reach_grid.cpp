#include "worker/stages/photon/reach_grid.h"

#include <algorithm>
#include <cmath>

namespace gleaner::worker {
namespace {

// Cells that a place is entered in, at most; one that reaches farther is looked at for all points.
constexpr std::int64_t kMostCells = 64;

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

ReachGrid::ReachGrid(std::vector<Entry> entries) {
  std::vector<float> reaches;
  reaches.reserve(entries.size() + 1);
  for (const Entry& entry : entries) reaches.push_back(entry.reach);
  cell_ = 2 * double{median_of(std::move(reaches))};
  for (std::uint32_t i = 0; i < entries.size(); ++i) enter(i, entries[i]);
}

std::int64_t ReachGrid::cell_of(float x) const { return static_cast<std::int64_t>(std::floor(double{x} / cell_)); }

void ReachGrid::enter(std::uint32_t number, const Entry& entry) {
  std::int64_t lower[3], upper[3], cells = 1;
  for (std::size_t k = 0; k < 3; ++k) {
    lower[k] = cell_of(entry.position[k] - entry.reach);
    upper[k] = cell_of(entry.position[k] + entry.reach);
    cells = std::min(cells * (upper[k] - lower[k] + 1), kMostCells + 1);
  }
  if (cells > kMostCells) return wide_.push_back(number);
  for (std::int64_t x = lower[0]; x <= upper[0]; ++x)
    for (std::int64_t y = lower[1]; y <= upper[1]; ++y)
      for (std::int64_t z = lower[2]; z <= upper[2]; ++z) cells_[key_of({x, y, z})].push_back(number);
}

ReachGrid grid_of(std::span<const ClusterSample> samples) {
  std::vector<ReachGrid::Entry> entries;
  entries.reserve(samples.size());
  for (const ClusterSample& sample : samples) entries.push_back({sample.at.position, sample.reach});
  return ReachGrid(std::move(entries));
}

}  // namespace gleaner::worker

#pragma once
// Places by the cells that they reach, of grids as fine as they reach far: which of them may be read at a point.

#include <array>
#include <cstdint>
#include <span>
#include <unordered_map>
#include <vector>

#include "worker/stages/photon/clusters.h"

namespace gleaner::worker {

// A cell of a grid of places, and its hash: cells of equal hash share their entries.
using GridCell = std::array<std::int64_t, 3>;
std::uint64_t key_of(const GridCell& cell);

// The median, m; above 0.
float median_of(std::vector<float> reaches);

class ReachGrid {
 public:
  struct Entry {
    std::array<float, 3> position;
    float reach;  // m
  };
  explicit ReachGrid(std::span<const Entry> entries);

  // Calls see(number of the entry) for all that may reach the position, some perhaps twice, in an order of their own.
  template <typename See>
  void near(const std::array<float, 3>& position, const See& see) const {
    for (const Level& level : levels_) {
      GridCell at{};
      for (std::size_t k = 0; k < 3; ++k) at[k] = level.cell_of(position[k]);
      if (const auto found = level.cells.find(key_of(at)); found != level.cells.end())
        for (const std::uint32_t i : found->second) see(i);
    }
  }

 private:
  // Entries that are as wide as one cell at most, and wider than half of one: each lies in eight at most.
  struct Level {
    int exponent;  // of the cell's edge: 2^exponent m
    std::unordered_map<std::uint64_t, std::vector<std::uint32_t>> cells{};
    std::int64_t cell_of(float x) const;
    void enter(std::uint32_t number, const Entry& entry);
  };

  std::vector<Level> levels_;
};

// Of samples.
ReachGrid grid_of(std::span<const ClusterSample> samples);

}  // namespace gleaner::worker

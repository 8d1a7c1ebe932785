#pragma once
// The regular grid over clusters' centres that kernels/cluster_grid.h looks up.

#include <cstdint>
#include <span>
#include <vector>

namespace gleaner::worker {

struct ClusterGrid {
  std::vector<float> header;         // GRID_HEADER words
  std::vector<std::uint32_t> cells;  // first seed of each, and their number
  std::vector<float> seeds;          // SEED_WORDS each, in the order of cells, then of rows; room for 16 words more
};

// A grid over the rows of `stride` words (position, normal first) of which `used` says that they take part. The cells'
// edge is chosen so that a cell that holds any holds about so many, and larger where the cells would be too many.
ClusterGrid make_cluster_grid(std::span<const float> rows, std::size_t stride, const std::vector<bool>& used,
                              double seeds_per_cell = 3);

}  // namespace gleaner::worker

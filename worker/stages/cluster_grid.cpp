#include "worker/stages/cluster_grid.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <numeric>

#include "kernels/cluster_grid.h"

namespace gleaner::worker {
namespace {

constexpr double kMostCells = 1 << 21;

struct Extent {
  std::array<double, 3> lower{1e300, 1e300, 1e300}, upper{-1e300, -1e300, -1e300};
};

std::array<std::uint64_t, 3> cells_of(const Extent& extent, double edge) {
  std::array<std::uint64_t, 3> n{};
  for (int k = 0; k < 3; ++k)
    n[k] = static_cast<std::uint64_t>(std::min(1e6, std::floor((extent.upper[k] - extent.lower[k]) / edge))) + 1;
  return n;
}

double product(const std::array<std::uint64_t, 3>& n) {
  return static_cast<double>(n[0]) * static_cast<double>(n[1]) * static_cast<double>(n[2]);
}

}  // namespace

ClusterGrid make_cluster_grid(std::span<const float> rows, std::size_t stride, const std::vector<bool>& used,
                              double seeds_per_cell) {
  const std::size_t count = used.size();
  Extent extent;
  std::vector<std::uint32_t> members;
  for (std::size_t i = 0; i < count; ++i)
    if (used[i]) {
      members.push_back(static_cast<std::uint32_t>(i));
      for (int k = 0; k < 3; ++k) {
        extent.lower[k] = std::min(extent.lower[k], double{rows[i * stride + k]});
        extent.upper[k] = std::max(extent.upper[k], double{rows[i * stride + k]});
      }
    }
  ClusterGrid grid;
  grid.header.assign(GRID_HEADER, 0.0f);
  if (members.empty()) {
    const std::uint32_t one = 1;
    for (int k = 0; k < 3; ++k) std::memcpy(&grid.header[GRID_SIZE + k], &one, 4);
    grid.header[GRID_INVERSE] = 1;
    grid.cells.assign(2, 0);
    grid.seeds.assign(SEED_WORDS + 16, 0.0f);
    return grid;
  }
  double diagonal = 0;
  for (int k = 0; k < 3; ++k) diagonal = std::max(diagonal, extent.upper[k] - extent.lower[k]);
  // A single place: any edge will do.
  diagonal = std::max(diagonal, 1e-6 * (1 + std::abs(extent.upper[0])));
  const auto index_of = [&](std::uint32_t i, double size, const std::array<std::uint64_t, 3>& n) {
    std::array<std::uint64_t, 3> c{};
    for (int k = 0; k < 3; ++k) {
      // As the kernels compute it, in float.
      const float x =
          std::floor((rows[i * stride + k] - static_cast<float>(extent.lower[k])) * static_cast<float>(1 / size));
      c[k] = static_cast<std::uint64_t>(std::clamp<double>(x, 0, static_cast<double>(n[k] - 1)));
    }
    return (c[2] * n[1] + c[1]) * n[0] + c[0];
  };
  // Seeds lie on surfaces: cells that hold any are as the square of 1 / edge. A few steps of that rule.
  double size = diagonal / std::sqrt(static_cast<double>(members.size()) / seeds_per_cell);
  for (int step = 0; step < 4; ++step) {
    while (product(cells_of(extent, size)) > kMostCells) size *= 1.1;
    const auto n = cells_of(extent, size);
    std::vector<std::uint64_t> held;
    for (auto i : members) held.push_back(index_of(i, size, n));
    std::sort(held.begin(), held.end());
    const double occupied = static_cast<double>(std::unique(held.begin(), held.end()) - held.begin());
    const double density = static_cast<double>(members.size()) / occupied;
    size *= std::clamp(std::sqrt(seeds_per_cell / density), 0.5, 2.0);
  }
  while (product(cells_of(extent, size)) > kMostCells) size *= 1.1;
  const auto n = cells_of(extent, size);
  for (int k = 0; k < 3; ++k) {
    grid.header[GRID_ORIGIN + k] = static_cast<float>(extent.lower[k]);
    const auto words = static_cast<std::uint32_t>(n[k]);
    std::memcpy(&grid.header[GRID_SIZE + k], &words, 4);
  }
  grid.header[GRID_INVERSE] = static_cast<float>(1 / size);
  grid.cells.assign(n[0] * n[1] * n[2] + 1, 0);
  std::vector<std::uint64_t> cell(members.size());
  for (std::size_t i = 0; i < members.size(); ++i) {
    cell[i] = index_of(members[i], size, n);
    ++grid.cells[cell[i] + 1];
  }
  std::partial_sum(grid.cells.begin(), grid.cells.end(), grid.cells.begin());
  grid.seeds.assign(members.size() * SEED_WORDS + 16, 0.0f);
  std::vector<std::uint32_t> next(grid.cells.begin(), grid.cells.end() - 1);
  for (std::size_t i = 0; i < members.size(); ++i) {
    float* seed = &grid.seeds[std::size_t{next[cell[i]]++} * SEED_WORDS];
    std::copy_n(&rows[members[i] * stride], 6, seed);
    std::memcpy(seed + SEED_ROW, &members[i], 4);
  }
  return grid;
}

}  // namespace gleaner::worker

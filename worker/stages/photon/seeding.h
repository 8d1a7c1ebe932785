#pragma once
// Seeds of shading clusters, by how much geometry varies over the picture (Wang et al. 2009, section 3.2).

#include <cstdint>
#include <span>
#include <vector>

namespace gleaner::worker {

// A shading point on the screen: its place on a grid of pixels, at most 2^16 a side, and its row of the data.
struct ScreenPoint {
  std::uint32_t x = 0, y = 0, row = 0;
};

// Rows of up to `clusters` points, none of them twice. A quadtree over the screen: each node deals its seeds out to its
// children in proportion to their geometric variation, the sum of eq. 2 over their points from their mean; a node with
// one seed takes one of its points at random, by `key`. `data`: rows of `stride` words, position (multiplied by alpha)
// and normal first.
std::vector<std::uint32_t> seeds_by_variation(std::span<const float> data, std::size_t stride,
                                              std::span<const ScreenPoint> points, std::uint32_t clusters,
                                              std::uint64_t key);

}  // namespace gleaner::worker

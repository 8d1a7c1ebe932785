#pragma once
// Records of a cache by where they may be read.

#include <algorithm>
#include <array>
#include <cstdint>
#include <span>
#include <utility>
#include <vector>

#include "worker/stages/photon/reach_grid.h"
#include "worker/stages/splat/reading.h"

namespace gleaner::worker::splat {

class RecordGrid {
 public:
  // `stretch`: as that of record_weight().
  RecordGrid(std::span<const CacheRecord> records, float stretch) : grid_(entries(records, stretch)) {}

  // The numbers of the records that may count at a place, in their order.
  std::vector<std::uint32_t> near(const std::array<float, 3>& position) const {
    std::vector<std::uint32_t> near;
    grid_.near(position, [&](std::uint32_t k) { near.push_back(k); });
    std::ranges::sort(near);
    near.erase(std::unique(near.begin(), near.end()), near.end());
    return near;
  }

 private:
  static std::vector<ReachGrid::Entry> entries(std::span<const CacheRecord> records, float stretch) {
    std::vector<ReachGrid::Entry> entries;
    entries.reserve(records.size());
    for (const CacheRecord& r : records)
      entries.push_back({r.position, stretch * r.accuracy * r.radius * (1 + SPLAT_SLACK)});
    return entries;
  }

  ReachGrid grid_;
};

}  // namespace gleaner::worker::splat

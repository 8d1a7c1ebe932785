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
  // A record and what it counts with, above 0.
  struct Near {
    std::uint32_t record;
    double weight;
  };

  // `stretch`: as that of record_weight().
  RecordGrid(std::span<const CacheRecord> records, float stretch) : grid_(entries(records, stretch)) {}

  // The records that count at a place by `weight_of`, which gets a record's number, in their order.
  template <typename WeightOf>
  std::vector<Near> near(const std::array<float, 3>& position, const WeightOf& weight_of) const {
    std::vector<Near> near;
    grid_.near(position, [&](std::uint32_t k) {
      if (const double weight = weight_of(k); weight > 0) near.push_back({k, weight});
    });
    std::ranges::sort(near, {}, &Near::record);
    const auto again = std::ranges::unique(near, {}, &Near::record);
    near.erase(again.begin(), again.end());
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

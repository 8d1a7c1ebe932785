#pragma once
// Which samples shading clusters have, and how far each of them is read (Wang et al. 2009, section 3.2).

#include <array>
#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "worker/stages/photon/seeding.h"
#include "worker/stages/splat/points.h"
#include "worker/wavefront/stage_task.h"

namespace gleaner::worker {

// The pixels' points as kernels/splat_records.h lays them out, and a grid of every step-th pixel of both axes.
struct PointScreen {
  std::uint32_t width = 0, height = 0, samples = 0;
  std::uint32_t step = 1;

  std::uint32_t columns() const { return (width + step - 1) / step; }
  std::uint32_t rows() const { return (height + step - 1) / step; }
  // The first of a pixel's points.
  std::size_t point_of(std::uint32_t x, std::uint32_t y) const {
    const std::size_t tile = std::size_t{y / SPLAT_TILE} * splat_tiles(width) + x / SPLAT_TILE;
    return (tile * SPLAT_TILE_PIXELS + std::size_t{y % SPLAT_TILE} * SPLAT_TILE + x % SPLAT_TILE) * samples;
  }
};

// A point where light is gathered, and where it may be read: up to `reach` metres away, by points whose normals give
// sqrt(1 - n.m) up to `turn`. `spacing`: of its cluster's members, m.
struct ClusterSample {
  std::uint32_t point = 0;
  float reach = 0, turn = 0, spacing = 0;
};

// A point of the grid and the sample of its cluster.
struct ClusterMember {
  ScreenPoint screen{};
  std::uint32_t point = 0, sample = 0;
};

// How a point lies to a sample's.
struct PointOffset {
  float distance = 0, turn = 0;  // m; sqrt(1 - n.m)
  bool hidden = false;           // below the sample's surface
};
PointOffset point_offset(const std::array<float, 3>& position, const std::array<float, 3>& normal,
                         const SplatPoint& to);

// A sample at a point that is too unlike all others near it: it is read a few pixels around.
ClusterSample stray_sample(std::uint32_t point, float footprint);

// The samples as rows of places (kernels/splat_records.h), in one item.
BatchResult sample_places(const std::vector<ClusterSample>& samples, std::span<const SplatPoint> points);

// Records that were gathered at samples: their reach and turn are `spare`. Throws Error::bad_input.
std::vector<CacheRecord> read_cluster_records(const StageTask& task, const std::string& input);
// Of such records, m; above 0.
float median_reach(const std::vector<CacheRecord>& records);

// A cell of a grid of places, and its hash: cells of equal hash share their entries.
using GridCell = std::array<std::int64_t, 3>;
std::uint64_t key_of(const GridCell& cell);

// Gives the samples (whose points are set) their extents, such that each point that a pixel shows may read one: where
// it is too unlike all near it, it becomes a sample itself, or reads one that did. Returns how many did.
std::uint64_t extend_samples(const PointScreen& screen, std::span<const SplatPoint> points,
                             std::span<const ClusterMember> members, std::vector<ClusterSample>& samples);

}  // namespace gleaner::worker

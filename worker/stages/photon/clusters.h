#pragma once
// Which samples shading clusters have, and how far each of them is read (Wang et al. 2009, section 3.2).

#include <array>
#include <cstdint>
#include <functional>
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

// How much farther than its own members a sample is read. More: smoother, and less of what changes fast.
inline constexpr float kOverlap = 2;

// A point where light is gathered, and where it may be read: up to `reach` metres away, by points whose normals give
// sqrt(1 - n.m) up to `turn`. `spacing`: of its cluster's members, m.
struct ClusterSample {
  SplatPoint at{};
  float reach = 0, turn = 0, spacing = 0;
};

// A point of the grid and the sample of its cluster.
struct ClusterMember {
  ScreenPoint screen{};
  std::uint32_t point = 0, sample = GLEANER_NONE;
};

// How a point lies to a sample's.
struct PointOffset {
  float distance = 0, turn = 0;  // m; sqrt(1 - n.m)
  bool hidden = false;           // below the sample's surface
};
PointOffset point_offset(const std::array<float, 3>& position, const std::array<float, 3>& normal,
                         const SplatPoint& to);

// A sample at a point that is too unlike all others near it: it is read a few pixels around.
ClusterSample stray_sample(const SplatPoint& point);
// Whether a point may read the sample, `part` of its extents away at most.
bool covers(const ClusterSample& sample, const SplatPoint& point, float part = 1);

// The samples as rows of places (kernels/splat_records.h), in one item.
BatchResult sample_places(const std::vector<ClusterSample>& samples);
// Such rows; none where the task has no such input. Throws Error::bad_input.
std::vector<ClusterSample> read_samples(const StageTask& task, const std::string& input);

// R and a of eq. 2 of Gautron et al. 2005 (kernels/splat/weight.h) for a record of a sample, with which all points that
// `reach` and `turn` let read it do. `mean`: the distance of the surfaces about it, m, which R is within its bounds.
struct RecordExtent {
  float radius, accuracy;
};
RecordExtent record_extent(float mean, float reach, float turn);

// Records that were gathered at samples, inputs "records.0", "records.1" and so on: their reach and turn are `spare`.
// Throws Error::bad_input.
std::vector<CacheRecord> read_cluster_records(const StageTask& task);

// The same as points read them: each averaged with its neighbours, its radius and accuracy set (cluster_smooth.cpp).
std::vector<CacheRecord> smoothed_records(std::vector<CacheRecord> records);

// Distances to the next surface ahead of these places, m (nearness.h).
using LookAhead = std::function<std::vector<float>(std::span<const SplatPoint>)>;

// Gives the samples from `kept` on (whose points are set) their extents, such that each point that a pixel shows may
// read one: where it is too unlike all near it, it becomes a sample itself, or reads one that did. Members that lie
// farther than `most_pixels` from their sample do not widen it, and those that something covers close by, but not their
// sample, become samples as well. Returns how many points became samples.
std::uint64_t extend_samples(const PointScreen& screen, std::span<const SplatPoint> points,
                             std::span<const ClusterMember> members, std::vector<ClusterSample>& samples,
                             std::size_t kept, float most_pixels, const LookAhead& ahead);

}  // namespace gleaner::worker

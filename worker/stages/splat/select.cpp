#include "worker/stages/splat/select.h"

#include <algorithm>
#include <cmath>

#include "worker/stages/splat/clamped_means.h"
#include "worker/stages/splat/coverage.h"
#include "worker/stages/splat/reading.h"
#include "worker/stages/splat/shape.h"
#include "worker/wavefront/work_queue.h"

namespace gleaner::worker {
namespace {

// How fast a mean distance may grow away from a neighbour's: as the harmonic mean does before a wall, 3/2 times as fast
// as the distance (the cosine-weighted mean of the cosine is 2/3). Beside a wall that stands on the surface it grows 3
// pi / 2 times as fast, but there light changes fastest: for as many records, 3/2 errs least
// (docs/explanation/splat.md).
constexpr float kMostSlope = 1.5f;

// Given places shape those within so many times their reach.
constexpr float kShapeStretch = 3;

// Blocks that a thread takes at a time.
constexpr std::uint64_t kBlocksAtOnce = 16;

using Vec = std::array<float, 3>;

class Selector {
 public:
  Selector(const SelectSettings& settings, std::span<const SplatPoint> points)
      : settings_(settings),
        points_(points),
        tile_points_(SPLAT_TILE_PIXELS * settings.samples),
        coverage_(settings, points),
        means_(kMostSlope) {
    const std::uint32_t columns = splat_tiles(settings.width), rows = splat_tiles(settings.height);
    const std::uint32_t edge = settings.block_tiles ? settings.block_tiles : std::max(columns, rows);
    for (auto& tiles : squares_of_tiles(columns, rows, edge)) blocks_.push_back({std::move(tiles)});
    made_.points = coverage_.existing_points();
  }

  Selection run(std::span<const Selection::Place> given, const ProbePoints& probe) {
    for (const Selection::Place& place : given) take(place);
    // A record whose radius shrinks uncovers points that were passed: another turn finds them.
    for (bool found = true; found;) {
      found = false;
      for (Block& block : blocks_) block.at = 0;
      for (;;) {
        const std::vector<std::uint32_t> asked = next_uncovered();
        if (asked.empty()) break;
        found = true;
        ++made_.rounds;
        made_.probes += asked.size();
        const std::vector<Surroundings> about = probe(asked);
        for (std::size_t i = 0; i < asked.size(); ++i)
          if (!coverage_.covers(asked[i])) add(points_[asked[i]], about[i]);
        if (settings_.most_new && made_.places.size() - given.size() > settings_.most_new) return std::move(made_);
      }
    }
    made_.whole = true;
    return std::move(made_);
  }

 private:
  static constexpr std::uint32_t kNone = 0xffffffffu;
  struct Block {
    std::vector<std::uint32_t> tiles;
    std::uint32_t at = 0;  // points of the block that were visited
  };

  // The next points that no record covers, one of each block that has any, in their order.
  std::vector<std::uint32_t> next_uncovered() {
    std::vector<std::uint32_t> next(blocks_.size());
    // A block's points know no other block's.
    for_each_item(blocks_.size(), settings_.threads, kBlocksAtOnce,
                  [&](std::uint64_t i) { next[i] = next_uncovered(blocks_[i]); });
    std::erase(next, kNone);
    return next;
  }

  // The block's first point from where it stands that no record covers.
  std::uint32_t next_uncovered(Block& block) {
    const auto count = static_cast<std::uint32_t>(block.tiles.size()) * tile_points_;
    for (; block.at < count; ++block.at) {
      const std::uint32_t point = block.tiles[block.at / tile_points_] * tile_points_ + block.at % tile_points_;
      if (points_[point].exists() && !coverage_.covers(point)) return point;
    }
    return kNone;
  }

  // R_k of a mean distance, within its bounds.
  float bounded(const SplatPoint& point, float mean) const {
    return std::clamp(mean, settings_.least_radius * point.footprint, settings_.most_radius * point.footprint);
  }

  // A record that exists. Its bounds are those of the picture that shows it from nearest by.
  void take(const Selection::Place& given) {
    const auto number = static_cast<std::uint32_t>(made_.places.size());
    made_.places.push_back(given);
    Selection::Place& place = made_.places.back();
    coverage_.add(place);
    // Of the pixels that it lights: no less than at its own place, where the picture shows that.
    const float widest = coverage_.widest_footprint(number);
    if (widest > 0) place.point.footprint = std::min(place.point.footprint, widest);
    if (!place.shaped) set_shape(number, {std::min(place.radius, bounded(place.point, place.mean)), place.narrow});
    shaped_ = shaped_ || place.shaped;
    means_.add(number, place.point.position, place.mean);
  }

  void add(const SplatPoint& point, const Surroundings& about) {
    const Vec& p = point.position;
    float mean = about.mean;
    if (!(mean > 0)) mean = settings_.most_radius * point.footprint;
    mean = means_.clamped(p, mean);
    means_.clamp_others(p, mean, [&](std::uint32_t number, float most) { clamp(number, most); });
    Selection::Place place{.point = point, .mean = mean, .radius = bounded(point, mean), .clearance = about.clearance};
    if (shaped_) shape(place);
    means_.add(static_cast<std::uint32_t>(made_.places.size()), p, mean);
    made_.places.push_back(place);
    coverage_.add(place);
  }

  void clamp(std::uint32_t number, float mean) {
    Selection::Place& place = made_.places[number];
    place.mean = mean;
    set_shape(number, place.shaped ? within_bounds(place, {place.radius, place.narrow})
                                   : RecordShape{std::min(place.radius, bounded(place.point, mean)), place.narrow});
  }

  void set_shape(std::uint32_t number, const RecordShape& shape) {
    Selection::Place& place = made_.places[number];
    if (shape.radius == place.radius && shape.narrow == place.narrow) return;
    place.radius = shape.radius;
    place.narrow = shape.narrow;
    coverage_.reshape(number, place);
  }

  ShapeBounds bounds_of(const Selection::Place& place) const {
    return shape_bounds(settings_.least_radius, settings_.most_radius, place.point.footprint, place.mean);
  }

  RecordShape within_bounds(const Selection::Place& place, const RecordShape& shape) const {
    const ShapeBounds bounds = bounds_of(place);
    if (double{shape.radius} <= bounds.most) return shape;
    return shape_of(in_plane(place.point.normal, metric_of(place.point.normal, shape)), bounds);
  }

  // As the given places about it are shaped, where there are any.
  void shape(Selection::Place& place) const {
    const SplatPoint& point = place.point;
    const Vec &p = point.position, &n = point.normal;
    WorldMatrix sum{};
    double weights = 0;
    for (const Selection::Place& other : made_.places) {
      if (!other.shaped || other.point.level() != point.level()) continue;
      const Vec &center = other.point.position, &m = other.point.normal;
      const float accuracy = kShapeStretch * settings_.accuracy;
      if (distance(center, p) > accuracy * other.radius) continue;
      const float x = p[0] - center[0], y = p[1] - center[1], z = p[2] - center[2];
      const float error = splat::splat_error(x, y, z, n[0], n[1], n[2], m[0], m[1], m[2], other.radius,
                                             splat::across_of(m, other.narrow, {x, y, z}));
      if (!(error < accuracy)) continue;
      const double weight = 1 / double{error} - 1 / double{accuracy};
      const WorldMatrix metric = metric_of(m, {other.radius, other.narrow});
      for (std::size_t k = 0; k < sum.size(); ++k) sum[k] += weight * metric[k];
      weights += weight;
    }
    if (!(weights > 0)) return;
    for (double& value : sum) value /= weights;
    const RecordShape shape = shape_of(in_plane(n, sum), bounds_of(place));
    place.radius = shape.radius;
    place.narrow = shape.narrow;
  }

  const SelectSettings settings_;
  const std::span<const SplatPoint> points_;
  const std::uint32_t tile_points_;
  Coverage coverage_;
  ClampedMeans means_;
  std::vector<Block> blocks_;
  Selection made_;
  bool shaped_ = false;  // given places are
};

}  // namespace

Selection select_places(const SelectSettings& settings, std::span<const SplatPoint> points,
                        std::span<const Selection::Place> given, const ProbePoints& probe) {
  return Selector(settings, points).run(given, probe);
}

}  // namespace gleaner::worker

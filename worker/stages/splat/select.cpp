#include "worker/stages/splat/select.h"

#include <algorithm>
#include <cmath>

#include "worker/stages/splat/reading.h"
#include "worker/stages/splat/shape.h"
#include "worker/wavefront/wanted.h"

namespace gleaner::worker {
namespace {

// Edge of groups of tiles that are passed over together, in tiles.
constexpr std::uint32_t kGroupTiles = 8;
// How fast a mean distance may grow away from a neighbour's: as the harmonic mean does before a wall, 3/2 times as fast
// as the distance (the cosine-weighted mean of the cosine is 2/3). Beside a wall that stands on the surface it grows 3
// pi / 2 times as fast, but there light changes fastest: for as many records, 3/2 errs least
// (docs/explanation/splat.md).
constexpr float kMostSlope = 1.5f;

// Given places shape those within so many times their reach.
constexpr float kShapeStretch = 3;

using Vec = std::array<float, 3>;

float distance(const Vec& a, const Vec& b) {
  float squared = 0;
  for (std::size_t k = 0; k < 3; ++k) squared += (a[k] - b[k]) * (a[k] - b[k]);
  return std::sqrt(squared);
}

// Tiles of a square of `edge` tiles, one square after the other.
std::vector<std::vector<std::uint32_t>> squares_of_tiles(std::uint32_t columns, std::uint32_t rows,
                                                         std::uint32_t edge) {
  const std::uint32_t across = (columns + edge - 1) / edge, down = (rows + edge - 1) / edge;
  std::vector<std::vector<std::uint32_t>> squares(std::size_t{across} * down);
  for (std::uint32_t y = 0; y < rows; ++y)
    for (std::uint32_t x = 0; x < columns; ++x) squares[y / edge * across + x / edge].push_back(y * columns + x);
  return squares;
}

class Selector {
 public:
  Selector(const SelectSettings& settings, std::span<const SplatPoint> points)
      : settings_(settings),
        points_(points),
        tile_points_(SPLAT_TILE_PIXELS * settings.samples),
        covers_(points.size()),
        boxes_(points.size() / tile_points_) {
    const std::uint32_t columns = splat_tiles(settings.width), rows = splat_tiles(settings.height);
    constexpr float far = std::numeric_limits<float>::infinity();
    surfaces_.reserve(points.size());
    for (std::size_t i = 0; i < points.size(); ++i) {
      surfaces_.push_back({points[i].exists() ? points[i].position : Vec{far, far, far}, points[i].normal});
      if (!points[i].exists()) continue;
      boxes_[i / tile_points_].add(points[i].position);
      ++made_.points;
    }
    for (auto& tiles : squares_of_tiles(columns, rows, kGroupTiles)) {
      Group group;
      for (const std::uint32_t tile : tiles) group.box.add(boxes_[tile]);
      group.tiles = std::move(tiles);
      groups_.push_back(std::move(group));
    }
    const std::uint32_t edge = settings.block_tiles ? settings.block_tiles : std::max(columns, rows);
    for (auto& tiles : squares_of_tiles(columns, rows, edge)) blocks_.push_back({std::move(tiles)});
  }

  Selection run(std::span<const Selection::Place> given, const ProbePoints& probe) {
    for (const Selection::Place& place : given) take(place);
    std::vector<std::uint32_t> asked;
    // A record whose radius shrinks uncovers points that were passed: another turn finds them.
    for (bool found = true; found;) {
      found = false;
      for (Block& block : blocks_) block.at = 0;
      for (;;) {
        check_wanted();
        asked.clear();
        for (Block& block : blocks_)
          if (const std::uint32_t point = next_uncovered(block); point != kNone) asked.push_back(point);
        if (asked.empty()) break;
        found = true;
        ++made_.rounds;
        made_.probes += asked.size();
        const std::vector<float> radii = probe(asked);
        for (std::size_t i = 0; i < asked.size(); ++i)
          if (covers_[asked[i]] == 0) add(points_[asked[i]], radii[i]);
        if (settings_.most_new && made_.places.size() - given.size() > settings_.most_new) return std::move(made_);
      }
    }
    made_.whole = true;
    return std::move(made_);
  }

 private:
  static constexpr std::uint32_t kNone = 0xffffffffu;
  struct Group {
    PointBox box{};
    std::vector<std::uint32_t> tiles{};
  };
  struct Block {
    std::vector<std::uint32_t> tiles;
    std::uint32_t at = 0;  // points of the block that were visited
  };

  // The block's first point from where it stands that no record covers.
  std::uint32_t next_uncovered(Block& block) const {
    const auto count = static_cast<std::uint32_t>(block.tiles.size()) * tile_points_;
    for (; block.at < count; ++block.at) {
      const std::uint32_t point = block.tiles[block.at / tile_points_] * tile_points_ + block.at % tile_points_;
      if (points_[point].exists() && covers_[point] == 0) return point;
    }
    return kNone;
  }

  // R_k of a mean distance, within its bounds.
  float bounded(const SplatPoint& point, float mean) const {
    return std::clamp(mean, settings_.least_radius * point.footprint, settings_.most_radius * point.footprint);
  }

  // A record that exists. Its bounds are those of the picture that shows it from nearest by.
  void take(const Selection::Place& given) {
    Selection::Place place = given;
    float widest = 0;  // of the pixels that it lights: no less than at its own place, where the picture shows that
    each_covered(place, [&](std::size_t i) { widest = std::max(widest, points_[i].footprint); });
    if (widest > 0) place.point.footprint = std::min(place.point.footprint, widest);
    if (!place.shaped) place.radius = std::min(place.radius, bounded(place.point, place.mean));
    shaped_ = shaped_ || place.shaped;
    made_.places.push_back(place);
    cover(place, 1);
  }

  // A surface that is near a record is near its neighbours too, though their rays may have missed it: neighbour
  // clamping, after Krivanek et al. 2006, "Making Radiance and Irradiance Caching Practical".
  void add(const SplatPoint& point, float mean) {
    if (!(mean > 0)) mean = settings_.most_radius * point.footprint;
    for (const Selection::Place& place : made_.places)
      mean = std::min(mean, place.mean + kMostSlope * distance(place.point.position, point.position));
    for (Selection::Place& place : made_.places) {
      const float most = mean + kMostSlope * distance(place.point.position, point.position);
      if (place.mean <= most) continue;
      place.mean = most;
      const RecordShape shape = place.shaped
                                    ? within_bounds(place, {place.radius, place.narrow})
                                    : RecordShape{std::min(place.radius, bounded(place.point, most)), place.narrow};
      if (shape.radius == place.radius && shape.narrow == place.narrow) continue;
      cover(place, -1);
      place.radius = shape.radius;
      place.narrow = shape.narrow;
      cover(place, 1);
    }
    Selection::Place place{.point = point, .mean = mean, .radius = bounded(point, mean)};
    if (shaped_) shape(place);
    made_.places.push_back(place);
    cover(made_.places.back(), 1);
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

  void cover(const Selection::Place& place, int change) {
    each_covered(place, [&](std::size_t i) { covers_[i] += static_cast<std::uint32_t>(change); });
  }

  // Calls call(point) for each point that the record covers.
  template <typename Call>
  void each_covered(const Selection::Place& place, Call call) const {
    const Vec& center = place.point.position;
    const float reach = settings_.accuracy * place.radius;
    for (const Group& group : groups_) {
      if (!group.box.meets(center, reach)) continue;
      for (const std::uint32_t tile : group.tiles)
        if (boxes_[tile].meets(center, reach)) each_covered_of(tile, place, call);
    }
  }

  template <typename Call>
  void each_covered_of(std::uint32_t tile, const Selection::Place& place, Call call) const {
    const Vec &center = place.point.position, &m = place.point.normal;
    const float reach = settings_.accuracy * place.radius, reach2 = reach * reach;
    const std::array<double, 3> narrow = splat::narrow_of(m, place.narrow);
    const bool round = place.narrow[0] == 0 && place.narrow[1] == 0;
    for (std::size_t i = std::size_t{tile} * tile_points_; i < (std::size_t{tile} + 1) * tile_points_; ++i) {
      const Surface& point = surfaces_[i];
      const float x = point.position[0] - center[0], y = point.position[1] - center[1],
                  z = point.position[2] - center[2];
      // Eq. 4.
      if (!(x * x + y * y + z * z <= reach2) || points_[i].level() != place.point.level()) continue;
      const Vec& n = point.normal;
      const float across = round ? 0 : static_cast<float>(x * narrow[0] + y * narrow[1] + z * narrow[2]);
      if (splat::splat_error(x, y, z, n[0], n[1], n[2], m[0], m[1], m[2], place.radius, across) > settings_.accuracy)
        continue;
      if (splat::splat_is_hidden(x, y, z, n[0], n[1], n[2], m[0], m[1], m[2], SPLAT_MOST_DEPTH * (1 - SPLAT_SLACK)))
        continue;
      call(i);
    }
  }

  // What is read of a point over and over. One that does not exist is infinitely far.
  struct Surface {
    Vec position, normal;
  };

  const SelectSettings settings_;
  const std::span<const SplatPoint> points_;
  const std::uint32_t tile_points_;
  std::vector<Surface> surfaces_;
  std::vector<std::uint32_t> covers_;  // records that cover each point
  std::vector<PointBox> boxes_;        // about each tile's points
  std::vector<Group> groups_;
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

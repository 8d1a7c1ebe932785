#include "worker/stages/splat/coverage.h"

#include <algorithm>
#include <ranges>
#include <utility>

#include "worker/stages/splat/reading.h"

namespace gleaner::worker {
namespace {

// Edge of groups of tiles that are passed over together, in tiles.
constexpr std::uint32_t kGroupTiles = 8;

}  // namespace

std::vector<std::vector<std::uint32_t>> squares_of_tiles(std::uint32_t columns, std::uint32_t rows,
                                                         std::uint32_t edge) {
  const std::uint32_t across = (columns + edge - 1) / edge, down = (rows + edge - 1) / edge;
  std::vector<std::vector<std::uint32_t>> squares(std::size_t{across} * down);
  for (std::uint32_t y = 0; y < rows; ++y)
    for (std::uint32_t x = 0; x < columns; ++x) squares[y / edge * across + x / edge].push_back(y * columns + x);
  return squares;
}

Coverage::Coverage(const SelectSettings& settings, std::span<const SplatPoint> points)
    : accuracy_(settings.accuracy),
      tile_points_(SPLAT_TILE_PIXELS * settings.samples),
      points_(points),
      boxes_(points.size() / tile_points_),
      near_(boxes_.size()),
      witnesses_(points.size(), GLEANER_NONE) {
  for (std::size_t i = 0; i < points.size(); ++i) {
    if (!points[i].exists()) continue;
    boxes_[i / tile_points_].add(points[i].position);
    ++existing_;
  }
  for (auto& tiles : squares_of_tiles(splat_tiles(settings.width), splat_tiles(settings.height), kGroupTiles)) {
    Group group;
    for (const std::uint32_t tile : tiles) group.box.add(boxes_[tile]);
    group.tiles = std::move(tiles);
    groups_.push_back(std::move(group));
  }
}

bool Coverage::covers(std::uint32_t point) {
  std::uint32_t& witness = witnesses_[point];
  if (witness != GLEANER_NONE && covers(records_[witness], point)) return true;
  const std::uint32_t tile = point / tile_points_;
  if (point > tile * tile_points_) {
    const std::uint32_t neighbour = witnesses_[point - 1];
    if (neighbour != GLEANER_NONE && covers(records_[neighbour], point)) {
      witness = neighbour;
      return true;
    }
  }
  // What was added last is nearest to where points are asked for.
  for (const std::uint32_t record : near_[tile] | std::views::reverse)
    if (covers(records_[record], point)) {
      witness = record;
      return true;
    }
  return false;
}

void Coverage::add(const Selection::Place& place) {
  const auto number = static_cast<std::uint32_t>(records_.size());
  std::uint32_t standing = GLEANER_NONE;
  if (splat::splat_stands_near(least_clear(place.clearance), accuracy_ * place.radius)) {
    standing = static_cast<std::uint32_t>(standing_.size());
    standing_.push_back({place.clearance, TangentFrame(place.point.normal)});
  }
  records_.push_back(record_of(place, standing));
  each_tile(records_.back(), [&](std::uint32_t tile) { near_[tile].push_back(number); });
}

void Coverage::reshape(std::size_t record, const Selection::Place& place) {
  records_[record] = record_of(place, records_[record].standing);
}

float Coverage::widest_footprint(std::size_t number) const {
  const Record& record = records_[number];
  float widest = 0;
  each_tile(record, [&](std::uint32_t tile) {
    for (std::uint32_t point = tile * tile_points_; point < (tile + 1) * tile_points_; ++point)
      if (points_[point].footprint > widest && covers(record, point)) widest = points_[point].footprint;
  });
  return widest;
}

Coverage::Record Coverage::record_of(const Selection::Place& place, std::uint32_t standing) const {
  return {.center = place.point.position,
          .normal = place.point.normal,
          .radius = place.radius,
          .level = place.point.level(),
          .narrow = splat::narrow_of(place.point.normal, place.narrow),
          .round = place.narrow[0] == 0 && place.narrow[1] == 0,
          .standing = standing};
}

bool Coverage::covers(const Record& record, std::uint32_t number) const {
  const SplatPoint& point = points_[number];
  const std::array<float, 3>&n = point.normal, &m = record.normal;
  const float x = point.position[0] - record.center[0], y = point.position[1] - record.center[1],
              z = point.position[2] - record.center[2], reach = accuracy_ * record.radius;
  // Eq. 4.
  if (!(x * x + y * y + z * z <= reach * reach) || point.level() != record.level) return false;
  const float across =
      record.round ? 0 : static_cast<float>(x * record.narrow[0] + y * record.narrow[1] + z * record.narrow[2]);
  if (!(splat::splat_error(x, y, z, n[0], n[1], n[2], m[0], m[1], m[2], record.radius, across) <= accuracy_) ||
      splat::splat_is_hidden(x, y, z, n[0], n[1], n[2], m[0], m[1], m[2], SPLAT_MOST_DEPTH * (1 - SPLAT_SLACK)))
    return false;
  if (record.standing == GLEANER_NONE) return true;
  const Standing& standing = standing_[record.standing];
  return !splat::behind_something(standing.clearance, standing.frame, {x, y, z}, 0);
}

template <typename Call>
void Coverage::each_tile(const Record& record, Call call) const {
  const float reach = accuracy_ * record.radius;
  for (const Group& group : groups_) {
    if (!group.box.meets(record.center, reach)) continue;
    for (const std::uint32_t tile : group.tiles)
      if (boxes_[tile].meets(record.center, reach)) call(tile);
  }
}

}  // namespace gleaner::worker

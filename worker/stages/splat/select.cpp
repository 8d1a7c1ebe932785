#include "worker/stages/splat/select.h"

#include <algorithm>
#include <cmath>

#include "worker/stages/splat/scalar.h"
#include "worker/wavefront/wanted.h"

namespace gleaner::worker {
namespace {

// Edges of blocks that are visited side by side, in tiles; and of groups of tiles that are passed over together.
constexpr std::uint32_t kBlockTiles = 2, kGroupTiles = 8;

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
    for (auto& tiles : squares_of_tiles(columns, rows, kBlockTiles)) blocks_.push_back({std::move(tiles)});
  }

  Selection run(const ProbePoints& probe) {
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
          if (covers_[asked[i]] == 0) add(asked[i], radii[i]);
        if (settings_.most_records && made_.places.size() > settings_.most_records) return std::move(made_);
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
  float bounded(std::uint32_t point, float mean) const {
    const float pixel = points_[point].footprint;
    return std::clamp(mean, settings_.least_radius * pixel, settings_.most_radius * pixel);
  }

  // A surface that is near a record is near its neighbours too, though their rays may have missed it: no mean distance
  // exceeds another's by more than the two are apart (neighbour clamping: Krivanek et al. 2006, "Making Radiance and
  // Irradiance Caching Practical").
  void add(std::uint32_t point, float mean) {
    const Vec& here = points_[point].position;
    if (!(mean > 0)) mean = settings_.most_radius * points_[point].footprint;
    for (std::size_t k = 0; k < means_.size(); ++k) {
      const float apart = distance(points_[made_.places[k].point].position, here);
      mean = std::min(mean, means_[k] + apart);
    }
    for (std::size_t k = 0; k < means_.size(); ++k) {
      const float most = mean + distance(points_[made_.places[k].point].position, here);
      if (means_[k] <= most) continue;
      means_[k] = most;
      Selection::Place& place = made_.places[k];
      const float radius = bounded(place.point, most);
      if (radius == place.radius) continue;
      cover(place, -1);
      place.radius = radius;
      cover(place, 1);
    }
    means_.push_back(mean);
    made_.places.push_back({point, bounded(point, mean)});
    cover(made_.places.back(), 1);
  }

  void cover(const Selection::Place& place, int change) {
    const Vec& center = points_[place.point].position;
    const float reach = settings_.accuracy * place.radius;
    for (const Group& group : groups_) {
      if (!group.box.meets(center, reach)) continue;
      for (const std::uint32_t tile : group.tiles)
        if (boxes_[tile].meets(center, reach)) cover_tile(place, tile, change);
    }
  }

  void cover_tile(const Selection::Place& place, std::uint32_t tile, int change) {
    const SplatPoint& record = points_[place.point];
    const Vec& m = record.normal;
    const float reach = settings_.accuracy * place.radius, reach2 = reach * reach;
    for (std::uint32_t i = tile * tile_points_; i < (tile + 1) * tile_points_; ++i) {
      const Surface& point = surfaces_[i];
      const float x = point.position[0] - record.position[0], y = point.position[1] - record.position[1],
                  z = point.position[2] - record.position[2];
      // Eq. 4.
      if (!(x * x + y * y + z * z <= reach2)) continue;
      const Vec& n = point.normal;
      if (splat::splat_error(x, y, z, n[0], n[1], n[2], m[0], m[1], m[2], place.radius) > settings_.accuracy) continue;
      if (splat::splat_is_hidden(x, y, z, n[0], n[1], n[2], m[0], m[1], m[2], SPLAT_MOST_DEPTH * (1 - SPLAT_SLACK)))
        continue;
      covers_[i] += static_cast<std::uint32_t>(change);
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
  std::vector<float> means_;  // of the places: mean distances without bounds, m
  Selection made_;
};

}  // namespace

Selection select_places(const SelectSettings& settings, std::span<const SplatPoint> points, const ProbePoints& probe) {
  return Selector(settings, points).run(probe);
}

}  // namespace gleaner::worker

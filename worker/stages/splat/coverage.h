#pragma once
// Which points records cover (Gautron et al. 2005, eq. 2 to 4), as records are added and reach less far.
//
// A point that is covered has one record as its witness. It is looked at again when it is asked for: most often the
// witness still covers it, or that of the point before does; else all records are tried that may reach its tile. A
// point is covered by dozens of records, of which none but the witness is looked at.

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "worker/stages/splat/points.h"
#include "worker/stages/splat/select.h"
#include "worker/stages/splat/tangent_frame.h"

namespace gleaner::worker {

class Coverage {
 public:
  // `points`: of whole tiles, as kernels/splat_records.h has them. They are kept by reference.
  Coverage(const SelectSettings& settings, std::span<const SplatPoint> points);

  std::uint64_t existing_points() const { return existing_; }
  // Whether a record covers the point, which exists.
  bool covers(std::uint32_t point);

  // The next record. Records have numbers in the order in which they are added.
  void add(const Selection::Place& place);
  // The record has another shape, and reaches no farther than before.
  void reshape(std::size_t record, const Selection::Place& place);
  // The largest footprint of the points that a record covers, m; 0: it covers none.
  float widest_footprint(std::size_t record) const;

 private:
  struct Record {
    std::array<float, 3> center, normal;
    float radius;
    std::uint32_t level;
    std::array<double, 3> narrow;  // CACHE_NARROW in the world
    bool round;                    // equally far along both tangents
    std::uint32_t standing;        // of standing_, where something stands near it; else GLEANER_NONE
  };
  // What stands about a record.
  struct Standing {
    Clearance clearance;
    TangentFrame frame;
  };
  struct Group {
    PointBox box{};
    std::vector<std::uint32_t> tiles{};
  };

  Record record_of(const Selection::Place& place, std::uint32_t standing) const;
  bool covers(const Record& record, std::uint32_t point) const;
  // Calls call(tile) for each tile of which the record may cover a point.
  template <typename Call>
  void each_tile(const Record& record, Call call) const;

  float accuracy_;
  std::uint32_t tile_points_;
  std::span<const SplatPoint> points_;
  std::uint64_t existing_ = 0;
  std::vector<PointBox> boxes_;  // about each tile's points
  std::vector<Group> groups_;    // of tiles that are passed over together
  std::vector<Record> records_;
  std::vector<Standing> standing_;
  std::vector<std::vector<std::uint32_t>> near_;  // records that may cover a point of the tile
  std::vector<std::uint32_t> witnesses_;          // a record that covered the point
};

// Tiles of a picture, in squares of `edge` tiles, one square after the other.
std::vector<std::vector<std::uint32_t>> squares_of_tiles(std::uint32_t columns, std::uint32_t rows, std::uint32_t edge);

}  // namespace gleaner::worker

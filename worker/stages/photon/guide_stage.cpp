// Stage kind "photon_guide": an emission guide (guide.h) of a pilot's photons, by whether they lie where photons are of
// use: near a point that a pixel shows, or near where a ray from one ends. Solo.

#include <algorithm>
#include <cmath>
#include <numbers>
#include <unordered_map>

#include "kernels/photon_records.h"
#include "scene/model/error.h"
#include "scene/model/limits.h"
#include "scene/model/order.h"
#include "worker/stages/photon/guide.h"
#include "worker/stages/photon/nearness.h"
#include "worker/stages/photon/packed.h"
#include "worker/stages/photon/reach_grid.h"
#include "worker/stages/photon/stages.h"
#include "worker/stages/splat/stages.h"
#include "worker/stages/vectors.h"
#include "worker/stages/vpl/rows.h"
#include "worker/wavefront/counters.h"
#include "worker/wavefront/input_rows.h"

namespace gleaner::worker {
namespace {

using kernels::PhotonGuideFacts;
using kernels::PhotonGuideParameters;
using Vector = std::array<float, 3>;

// Points that are looked at, or send a ray each.
constexpr std::size_t kMostPoints = 1u << 16;
// A normal is within an octant of directions where it is turned less than 73 degrees from the middle.
constexpr float kInOctant = 0.3f;

// Octants that a side of a surface faces, a bit each: opposite sides have none in common.
std::uint8_t octants_of(const Vector& normal) {
  std::uint8_t bits = 0;
  for (unsigned o = 0; o < 8; ++o) {
    const float edge = 1 / std::numbers::sqrt3_v<float>;
    const Vector middle = {o & 1 ? edge : -edge, o & 2 ? edge : -edge, o & 4 ? edge : -edge};
    if (dot(normal, middle) > kInOctant) bits = static_cast<std::uint8_t>(bits | 1u << o);
  }
  return bits;
}

// Where photons are of use, and on which sides of surfaces: cells of a grid.
class UsefulPlaces {
 public:
  explicit UsefulPlaces(float edge) : edge_(edge) {}

  // And half an edge about it.
  void add(const Vector& place, std::uint8_t octants) {
    for (unsigned corner = 0; corner < 8; ++corner) {
      Vector at = place;
      for (unsigned k = 0; k < 3; ++k) at[k] += (corner >> k & 1 ? 0.5f : -0.5f) * edge_;
      cells_[key_of(cell_at(at))] |= octants;
    }
  }
  bool hold(const Vector& place, const Vector& normal) const {
    const auto found = cells_.find(key_of(cell_at(place)));
    return found != cells_.end() && (found->second & octants_of(normal)) != 0;
  }

 private:
  GridCell cell_at(const Vector& p) const {
    GridCell cell;
    for (std::size_t k = 0; k < 3; ++k) cell[k] = static_cast<std::int64_t>(std::floor(p[k] / edge_));
    return cell;
  }

  float edge_;
  std::unordered_map<std::uint64_t, std::uint8_t> cells_;
};

// Every n-th of the points that exist.
std::vector<SplatPoint> looked_at(const std::vector<SplatPoint>& points) {
  std::vector<SplatPoint> shown;
  for (const SplatPoint& point : points)
    if (point.exists()) shown.push_back(point);
  const std::size_t step = shown.size() / kMostPoints + 1;
  std::vector<SplatPoint> some;
  for (std::size_t i = 0; i < shown.size(); i += step) some.push_back(shown[i]);
  return some;
}

// Cosine-distributed about the normal.
Vector random_direction(const Vector& n, std::uint64_t key) {
  const double turn = 2 * std::numbers::pi * scene::unit_hash(key), across = scene::unit_hash(key ^ 0x5bd1e995u);
  // A point on the unit sphere about the normal's tip (Malley).
  const double z = 1 - 2 * across, r = std::sqrt(std::max(0.0, 1 - z * z));
  const std::array<double, 3> d = {n[0] + r * std::cos(turn), n[1] + r * std::sin(turn), n[2] + z};
  const double length = std::sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2]);
  if (!(length > 1e-3)) return n;
  return {static_cast<float>(d[0] / length), static_cast<float>(d[1] / length), static_cast<float>(d[2] / length)};
}

UsefulPlaces useful_places(const StageRun& run, const PhotonGuideParameters& p, std::vector<SplatPoint> points,
                           BatchResult& counters) {
  UsefulPlaces places(p.near);
  if (!p.gathers) {
    for (const SplatPoint& point : points) places.add(point.position, octants_of(point.geometric));
    return places;
  }
  const std::uint64_t key = wide(p.seed_high, p.seed_low);
  for (std::size_t i = 0; i < points.size(); ++i)
    points[i].geometric = random_direction(points[i].geometric, key + 0x9e3779b97f4a7c15ull * (i + 1));
  const std::vector<float> ahead = distances_ahead(run, points, counters);
  for (std::size_t i = 0; i < points.size(); ++i) {
    if (!std::isfinite(ahead[i])) continue;
    Vector end = points[i].position, back = points[i].geometric;
    for (std::size_t k = 0; k < 3; ++k) {
      end[k] += ahead[i] * back[k];
      back[k] = -back[k];
    }
    places.add(end, octants_of(back));
  }
  return places;
}

// The paths of which a photon lies at such a place, once each.
std::vector<PathNumbers> useful_paths(const StageTask& task, std::uint32_t classes, const UsefulPlaces& places) {
  std::vector<PathNumbers> paths;
  const InputRows input(task, "photons", std::size_t{PHOTON_WORDS} * 4);
  input.visit(0, input.rows(), [&](std::uint64_t row, std::span<const std::byte> piece) {
    for (std::size_t at = 0; at < piece.size(); at += std::size_t{PHOTON_WORDS} * 4, ++row) {
      const std::byte* photon = &piece[at];
      const auto surface = row_word<std::uint32_t>(photon, PHOTON_SURFACE);
      if (!(classes & PHOTON_CLASS_BIT(surface >> PHOTON_CLASS_SHIFT & PHOTON_CLASS_MASK))) continue;
      Vector place;
      for (unsigned k = 0; k < 3; ++k) {
        place[k] = row_word<float>(photon, PHOTON_POSITION + k);
        if (!(std::abs(place[k]) <= 2 * scene::kMaxCoordinate))
          input.fail(row, "position", "a finite number of a scene's size", std::to_string(place[k]));
      }
      if (!places.hold(place, unpack_unit(surface, 12))) continue;
      const auto light = row_word<std::uint32_t>(photon, PILOT_LIGHT),
                 point = row_word<std::uint32_t>(photon, PILOT_POINT);
      const auto low = [](std::uint32_t word) { return static_cast<std::uint16_t>(word & 0xffffu); };
      const PathNumbers path = {low(light), low(light >> 16), low(point), low(point >> 16),
                                low(row_word<std::uint32_t>(photon, PILOT_DIRECTION))};
      // A path's photons follow each other.
      if (paths.empty() || paths.back() != path) paths.push_back(path);
    }
  });
  return paths;
}

}  // namespace

BatchResult run_photon_guide_stage(const StageRun& run) {
  const auto p = run.parameters<PhotonGuideParameters>();
  check_splat_points(run, p.width, p.height, p.samples);
  if (!(p.near > 0) || !std::isfinite(p.near))
    throw Error::bad_input(run.where(), "near", "metres above 0", std::to_string(p.near));
  run.check_range(1);
  const double start = seconds_now();
  BatchResult result;
  const UsefulPlaces places =
      useful_places(run, p, looked_at(read_splat_points(run, p.width, p.height, p.samples)), result);
  std::vector<PathNumbers> paths = useful_paths(run.task, p.classes, places);
  PhotonGuideFacts facts{.useful = paths.size()};
  const std::vector<GuideRow> guide = make_guide(std::move(paths));
  for (const GuideRow& row : guide) {
    if (row.child) continue;
    ++facts.cells;
    facts.most = std::max(facts.most, row.density());
  }
  result.records = guide_bytes(guide);
  result.counts = {static_cast<std::uint32_t>(guide.size())};
  set_facts(result, facts);
  result.counters.seconds = seconds_now() - start;
  return result;
}

}  // namespace gleaner::worker

// Points to be clustered: some of one camera's, or those that a trajectory's cameras see between them.

#include <algorithm>
#include <array>
#include <cmath>
#include <unordered_map>

#include "kernels/vpl_host_records.h"
#include "kernels/vpl_records.h"
#include "worker/stages/curve.h"
#include "worker/stages/vpl/host_stages.h"
#include "worker/stages/vpl/rows.h"
#include "worker/wavefront/wanted.h"

namespace gleaner::worker {
namespace {

using kernels::Camera;
using kernels::VplMergePointsFacts;
using kernels::VplMergePointsParameters;
using kernels::VplSamplePointsParameters;

// Of a cell's edge over the points' spacing, at most: cells must hold several points of a camera, or cameras that see a
// surface through different pixels would each have some cells to themselves.
constexpr double kCellSpacings = 4;

// The words of a row that decide its cell.
using Place = std::array<float, POINT_TABLE>;

// A cell of the grid. Points of the camera that is being counted, and of the one that has most so far.
struct Cell {
  std::uint32_t camera = 0, count = 0, best_camera = 0, best = 0;
  void end_camera() {
    if (count > best) {
      best = count;
      best_camera = camera;
    }
    count = 0;
  }
};

// Whether there is a point to be shaded in the row, and where.
bool read_place(const float* row, Place& place) {
  if (!is_point(row)) return false;
  std::memcpy(place.data(), row, sizeof place);
  return std::all_of(place.begin(), place.end(), [](float value) { return std::isfinite(value); });
}

// The point's cell as a number, never 0: its level (log2 of its edge), its place on that level's grid, its side. Should
// two cells of some millions share a number, they are one cell in two places.
// `spacing`: of the camera's points, in metres; for a perspective camera at a distance of one metre.
std::uint64_t key_of(const Place& place, const Camera& camera, double spacing) {
  if (camera.type == GLEANER_CAMERA_PERSPECTIVE) {
    double square = 0;
    for (std::size_t k = 0; k < 3; ++k) {
      const double d = double{place[POINT_POSITION + k]} - camera.origin[k];
      square += d * d;
    }
    spacing *= std::sqrt(square);
  }
  // A camera may stand on a surface.
  const int level = std::ilogb(std::max(kCellSpacings * spacing, 1e-30));
  const double inverse = std::ldexp(1.0, -level);
  std::uint64_t key = 0x9e3779b97f4a7c15ull;
  const auto add = [&](std::int64_t number) {
    key = (key ^ static_cast<std::uint64_t>(number)) * 0xbf58476d1ce4e5b9ull;
    key ^= key >> 29;
  };
  add(level);
  add(side_of(&place[POINT_NORMAL]));
  for (std::size_t k = 0; k < 3; ++k)
    add(static_cast<std::int64_t>(std::clamp(std::floor(place[POINT_POSITION + k] * inverse), -9e18, 9e18)));
  return std::max<std::uint64_t>(key, 1);
}

// What stage kind vpl_points made for one camera.
struct CameraPoints {
  Camera camera{};
  std::vector<float> rows;
};

std::vector<CameraPoints> read_cameras(const StageTask& task, std::uint32_t count) {
  const auto cameras = task.inputs.find("cameras");
  if (cameras == task.inputs.end() || cameras->second.bytes() != count * sizeof(Camera))
    throw Error::bad_input("stage vpl_merge_points", "input cameras", std::to_string(count * sizeof(Camera)) + " bytes",
                           cameras == task.inputs.end() ? "none" : std::to_string(cameras->second.bytes()));
  std::vector<CameraPoints> points(count);
  for (std::uint32_t k = 0; k < count; ++k) {
    cameras->second.source->read(k * sizeof(Camera), std::as_writable_bytes(std::span(&points[k].camera, 1)));
    points[k].rows = input_rows(task, "points." + std::to_string(k), POINT_WORDS);
  }
  return points;
}

// All cameras' points, no place more densely than by the camera that sees it most densely: of each cell of a grid the
// points of the camera that has most there are kept (of several, of the first), in the cameras' order. A cell is some
// two to four points' spacing wide, which grows with the distance from a perspective camera, and holds normals of one
// dominant direction. Points that are not finite are left out.
std::vector<float> merge(const std::vector<CameraPoints>& cameras, VplMergePointsFacts& facts) {
  std::unordered_map<std::uint64_t, Cell> cells;
  std::vector<std::uint64_t> keys;  // of every row, camera after camera; 0: nothing to shade
  for (std::uint32_t number = 0; number < cameras.size(); ++number) {
    check_wanted();
    const Camera& camera = cameras[number].camera;
    const std::size_t rows = cameras[number].rows.size() / POINT_WORDS;
    const double spacing =
        std::sqrt(4.0 * camera.half_width * camera.half_height / static_cast<double>(std::max<std::size_t>(rows, 1)));
    std::uint64_t points = 0;
    for (std::size_t row = 0; row < rows; ++row) {
      Place place;
      keys.push_back(read_place(&cameras[number].rows[row * POINT_WORDS], place) ? key_of(place, camera, spacing) : 0);
      if (keys.back() == 0) continue;
      Cell& cell = cells[keys.back()];
      if (cell.camera != number) cell.end_camera();
      cell.camera = number;
      ++cell.count;
      ++points;
    }
    facts.most_of_a_camera = std::max(facts.most_of_a_camera, points);
  }
  for (auto& [key, cell] : cells) {
    cell.end_camera();
    facts.points += cell.best;
  }
  std::vector<float> merged;
  merged.reserve(facts.points * POINT_WORDS);
  std::size_t next = 0;
  for (std::uint32_t number = 0; number < cameras.size(); ++number) {
    check_wanted();
    const std::vector<float>& rows = cameras[number].rows;
    for (std::size_t at = 0; at + POINT_WORDS <= rows.size(); at += POINT_WORDS) {
      const std::uint64_t key = keys[next++];
      if (key == 0 || cells.at(key).best_camera != number) continue;
      const auto row = rows.begin() + static_cast<std::ptrdiff_t>(at);
      merged.insert(merged.end(), row, row + POINT_WORDS);
    }
  }
  return merged;
}

}  // namespace

BatchResult sample_points(const StageTask& task) {
  const auto p = host_parameters<VplSamplePointsParameters>(task);
  const std::vector<float> points = input_rows(task, "points", POINT_WORDS);
  const std::size_t rows = points.size() / POINT_WORDS;
  if (p.count == 0 || rows == 0)
    throw Error::bad_input("stage vpl_sample_points", "count, input points", "1 or more of both",
                           std::to_string(p.count) + ", " + std::to_string(rows));
  BatchResult result;
  result.records.resize(std::size_t{p.count} * POINT_WORDS * 4);
  for (std::size_t k = 0; k < p.count; ++k) {
    const std::size_t row = random_row(k, k, rows, p.count);
    std::memcpy(result.records.data() + k * POINT_WORDS * 4, &points[row * POINT_WORDS], POINT_WORDS * 4);
  }
  return result;
}

BatchResult merge_points(const StageTask& task) {
  const auto p = host_parameters<VplMergePointsParameters>(task);
  if (p.cameras == 0) throw Error::bad_input("stage vpl_merge_points", "cameras", "1 or more", "0");
  VplMergePointsFacts facts;
  BatchResult result = counted_rows(merge(read_cameras(task, p.cameras), facts), POINT_WORDS);
  set_facts(result, facts);
  return result;
}

BatchResult count_skipped_queries(const StageTask& task) {
  const auto p = host_parameters<kernels::VplSkippedParameters>(task);
  const std::size_t words = p.lights / 32 + VISIBILITY_COUNTS;
  // The source holds the batch's own rows alone.
  const std::vector<float> rows = input_rows(task, "visibility", words);
  BatchResult result;
  result.records.resize(rows.size() / words * sizeof(kernels::VplSkippedRecord));
  for (std::size_t row = 0; row < rows.size() / words; ++row)
    std::memcpy(result.records.data() + row * sizeof(kernels::VplSkippedRecord), &rows[row * words + p.lights / 32],
                sizeof(kernels::VplSkippedRecord));
  return result;
}

}  // namespace gleaner::worker

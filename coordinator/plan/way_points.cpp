#include "coordinator/plan/way_points.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>

#include "kernels/vpl_records.h"

namespace gleaner::coordinator {
namespace {

// Of a cell's edge over the points' spacing, at most: cells must hold several points of a camera, or cameras that see a
// surface through different pixels would each have some cells to themselves.
constexpr double kSpacings = 4;

bool same(const scene::Camera& a, const scene::Camera& b) { return std::memcmp(&a, &b, sizeof a) == 0; }

constexpr std::size_t kRowBytes = POINT_WORDS * 4;
// What of a row tells its cell.
using Place = std::array<float, POINT_TABLE>;

// A cell of the grid. Points of the camera that is being counted, and of the one that has most so far.
struct Cell {
  std::uint64_t key = 0;  // of key_of(); 0: none yet
  std::uint32_t camera = 0, count = 0, best_camera = 0, best = 0;
  void settle() {
    if (count > best) {
      best = count;
      best_camera = camera;
    }
    count = 0;
  }
};

// Open addressing: millions of points are looked up while a frame waits.
class Cells {
 public:
  Cells() : cells_(std::size_t{1} << 12) {}

  // The cell's number holds until the next call.
  std::size_t at(std::uint64_t key) {
    if (used_ * 2 > cells_.size()) grow();
    const std::size_t found = find(key);
    if (cells_[found].key == 0) {
      cells_[found].key = key;
      ++used_;
    }
    return found;
  }
  std::size_t find(std::uint64_t key) const {
    std::size_t at = key & (cells_.size() - 1);
    while (cells_[at].key != 0 && cells_[at].key != key) at = (at + 1) & (cells_.size() - 1);
    return at;
  }
  Cell& operator[](std::size_t number) { return cells_[number]; }
  auto begin() { return cells_.begin(); }
  auto end() { return cells_.end(); }

 private:
  void grow() {
    std::vector<Cell> old(cells_.size() * 4);
    old.swap(cells_);
    for (const Cell& cell : old)
      if (cell.key != 0) cells_[find(cell.key)] = cell;
  }

  std::vector<Cell> cells_;
  std::size_t used_ = 0;
};

std::int32_t side_of(const float* n) {
  std::int32_t axis = 0;
  for (std::int32_t k = 1; k < 3; ++k)
    if (std::abs(n[k]) > std::abs(n[axis])) axis = k;
  return 2 * axis + (n[axis] < 0 ? 1 : 0);
}

// Whether there is a point to be shaded in the row, and where.
bool read_place(const std::byte* row, Place& place) {
  std::uint32_t triangle = GLEANER_NONE;
  std::memcpy(&triangle, row + POINT_TRIANGLE * 4, 4);
  if (triangle == GLEANER_NONE) return false;
  std::memcpy(place.data(), row, sizeof place);
  return std::all_of(place.begin(), place.end(), [](float value) { return std::isfinite(value); });
}

// The point's cell as a number, never 0: its level (log2 of its edge), its place on that level's grid, its side. Should
// two cells of some millions share a number, they are one cell in two places.
// `spacing`: of the camera's points, in metres; for a perspective camera at a distance of one metre.
std::uint64_t key_of(const Place& place, const scene::Camera& camera, double spacing) {
  if (camera.type == GLEANER_CAMERA_PERSPECTIVE) {
    double square = 0;
    for (std::size_t k = 0; k < 3; ++k) {
      const double d = double{place[POINT_POSITION + k]} - camera.origin[k];
      square += d * d;
    }
    spacing *= std::sqrt(square);
  }
  // A camera may stand on a surface.
  const int level = std::ilogb(std::max(kSpacings * spacing, 1e-30));
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

}  // namespace

std::vector<scene::Camera> way_of(const std::vector<scene::Camera>& frames, std::size_t most) {
  std::vector<scene::Camera> way;
  if (std::all_of(frames.begin(), frames.end(), [&](const auto& camera) { return same(camera, frames.front()); }))
    return way;
  const std::size_t count = std::min(frames.size(), most);
  for (std::size_t k = 0; k < count; ++k) {
    const scene::Camera& camera = frames[k * (frames.size() - 1) / (count - 1)];
    if (way.empty() || !same(way.back(), camera)) way.push_back(camera);
  }
  return way;
}

WayPoints merge_points(const std::vector<CameraPoints>& cameras) {
  WayPoints merged;
  Cells cells;
  std::vector<std::uint64_t> keys;  // of every row, camera after camera; 0: nothing to shade
  for (std::uint32_t number = 0; number < cameras.size(); ++number) {
    const auto& [camera, bytes] = cameras[number];
    const std::size_t rows = bytes->size() / kRowBytes;
    const double spacing =
        std::sqrt(4.0 * camera.half_width * camera.half_height / static_cast<double>(std::max<std::size_t>(rows, 1)));
    std::uint64_t points = 0;
    for (std::size_t row = 0; row < rows; ++row) {
      Place place;
      keys.push_back(read_place(bytes->data() + row * kRowBytes, place) ? key_of(place, camera, spacing) : 0);
      if (keys.back() == 0) continue;
      Cell& cell = cells[cells.at(keys.back())];
      if (cell.camera != number) cell.settle();
      cell.camera = number;
      ++cell.count;
      ++points;
    }
    merged.most_of_a_camera = std::max(merged.most_of_a_camera, points);
  }
  for (Cell& cell : cells) {
    cell.settle();
    merged.points += cell.best;
  }
  merged.rows.reserve(merged.points * kRowBytes);
  std::size_t next = 0;
  for (std::uint32_t number = 0; number < cameras.size(); ++number) {
    const scene::Bytes& bytes = *cameras[number].rows;
    for (std::size_t at = 0; at + kRowBytes <= bytes.size(); at += kRowBytes) {
      const std::uint64_t key = keys[next++];
      if (key == 0 || cells[cells.find(key)].best_camera != number) continue;
      const auto row = bytes.begin() + static_cast<std::ptrdiff_t>(at);
      merged.rows.insert(merged.rows.end(), row, row + kRowBytes);
    }
  }
  return merged;
}

}  // namespace gleaner::coordinator

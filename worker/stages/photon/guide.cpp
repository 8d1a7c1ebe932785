#include "worker/stages/photon/guide.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <numeric>
#include <queue>

#include "worker/wavefront/input_rows.h"
#include "worker/wavefront/wanted.h"

namespace gleaner::worker {
namespace {

// A cell is looked at in so many slices along each of its numbers. It is divided where they differ by more than chance
// would have it: the sum of squares over what is expected, of 7 degrees of freedom, is above this in 1 of 10^6.
constexpr std::size_t kSlices = 8;
constexpr double kBeyondChance = 40;
// Cells at most, how often one of a number may be halved, and the useful paths of one that is divided, at least.
constexpr std::size_t kMostCells = 1024;
constexpr double kLeastExtent = 1.0 / 1024;
constexpr std::size_t kLeastPaths = 4 * kSlices;

// The paths in a row's box.
struct Part {
  std::uint32_t row = 0;
  std::size_t first = 0, last = 0;  // of the paths
  std::size_t axis = 0;             // along which it is divided next
  double unlike = 0;                // by how much its slices along that axis differ; 0: not by more than chance
};

double number(const PathNumbers& path, std::size_t axis) { return path[axis] * 0x1p-16; }

class Division {
 public:
  explicit Division(std::vector<PathNumbers> paths) : paths_(std::move(paths)) {}

  std::vector<GuideRow> guide() {
    rows_.resize(1);
    rows_[0].box.extent.fill(1);
    const auto later = [](const Part& a, const Part& b) {
      return a.unlike != b.unlike ? a.unlike < b.unlike : a.row > b.row;
    };
    std::priority_queue<Part, std::vector<Part>, decltype(later)> open(later);
    open.push(looked_at({.row = 0, .last = paths_.size()}));
    while (open.size() < kMostCells && open.top().unlike > 0) {
      check_wanted();
      const Part whole = open.top();
      open.pop();
      for (const Part& half : halves(whole)) open.push(looked_at(half));
    }
    std::vector<Part> cells;
    for (; !open.empty(); open.pop()) cells.push_back(open.top());
    share_out(cells);
    return std::move(rows_);
  }

 private:
  Part looked_at(Part part) const {
    const auto count = static_cast<double>(part.last - part.first);
    if (part.last - part.first < kLeastPaths) return part;
    const GuideBox& box = rows_[part.row].box;
    for (std::size_t axis = 0; axis < GUIDE_NUMBERS; ++axis) {
      if (box.extent[axis] <= kLeastExtent) continue;
      std::array<double, kSlices> slices{};
      for (std::size_t i = part.first; i < part.last; ++i) {
        const double at = (number(paths_[i], axis) - box.lower[axis]) / box.extent[axis];
        slices[std::min(kSlices - 1, static_cast<std::size_t>(at * kSlices))] += 1;
      }
      double unlike = 0;
      for (const double slice : slices) unlike += std::pow(slice - count / kSlices, 2) / (count / kSlices);
      if (unlike > std::max(part.unlike, kBeyondChance)) {
        part.unlike = unlike;
        part.axis = axis;
      }
    }
    return part;
  }

  std::array<Part, 2> halves(const Part& whole) {
    const auto child = static_cast<std::uint32_t>(rows_.size());
    const GuideBox lower = rows_[whole.row].box.half(whole.axis, false),
                   upper = rows_[whole.row].box.half(whole.axis, true);
    rows_[whole.row].child = child;
    rows_[whole.row].axis = whole.axis;
    rows_.push_back({.box = lower});
    rows_.push_back({.box = upper});
    const auto begin = paths_.begin();
    const auto middle = std::stable_partition(
        begin + static_cast<std::ptrdiff_t>(whole.first), begin + static_cast<std::ptrdiff_t>(whole.last),
        [&](const PathNumbers& path) { return number(path, whole.axis) < upper.lower[whole.axis]; });
    const auto cut = static_cast<std::size_t>(middle - begin);
    return {Part{.row = child, .first = whole.first, .last = cut},
            Part{.row = child + 1, .first = cut, .last = whole.last}};
  }

  void share_out(const std::vector<Part>& cells) {
    double sum = 0;
    for (const Part& cell : cells) {
      GuideRow& row = rows_[cell.row];
      row.share = std::sqrt(static_cast<double>(cell.last - cell.first) * row.box.volume());
      sum += row.share;
    }
    for (const Part& cell : cells) {
      GuideRow& row = rows_[cell.row];
      const double even = row.box.volume();
      row.share = sum > 0 ? (1 - kGuideEven) * row.share / sum + kGuideEven * even : even;
    }
    // Children stand behind their parents.
    for (std::size_t k = rows_.size(); k-- > 0;)
      if (rows_[k].child) rows_[k].share = rows_[rows_[k].child].share + rows_[rows_[k].child + 1].share;
  }

  std::vector<PathNumbers> paths_;
  std::vector<GuideRow> rows_;
};

std::uint32_t word_of(float value) { return std::bit_cast<std::uint32_t>(value); }

// Rows as they came, whose tree is sound: each row but the root has one parent, before it.
void check_tree(const InputRows& input, std::span<const float> words) {
  const std::size_t rows = words.size() / GUIDE_WORDS;
  if (rows == 0 || rows > GUIDE_MOST_ROWS)
    input.fail(0, "rows", "1 to " + std::to_string(GUIDE_MOST_ROWS), std::to_string(rows));
  std::vector<std::uint32_t> parents(rows, 0);
  parents[0] = 1;
  for (std::size_t k = 0; k < rows; ++k) {
    const float* row = &words[k * GUIDE_WORDS];
    const std::uint32_t axis = word_of(row[GUIDE_AXIS]), child = word_of(row[GUIDE_CHILD]);
    if (parents[k] != 1) input.fail(k, "parent", "one, before the row", std::to_string(parents[k]));
    if (axis == GLEANER_NONE) {
      bool sound = row[GUIDE_DENSITY] > 0 && std::isfinite(row[GUIDE_DENSITY]);
      for (std::size_t d = 0; d < GUIDE_NUMBERS; ++d)
        sound = sound && row[GUIDE_LOWER + d] >= 0 && row[GUIDE_EXTENT + d] > 0 &&
                row[GUIDE_LOWER + d] + row[GUIDE_EXTENT + d] <= 1;
      if (!sound) input.fail(k, "cell", "a box in the unit cube and a density", std::to_string(row[GUIDE_DENSITY]));
      continue;
    }
    const float share = row[GUIDE_SHARE];
    if (axis >= GUIDE_NUMBERS || !(share > 0 && share < 1) || child <= k || child >= rows - 1)
      input.fail(k, "halves", "an axis, a share and later rows",
                 std::to_string(axis) + ", " + std::to_string(share) + ", " + std::to_string(child));
    ++parents[child];
    ++parents[child + 1];
  }
}

}  // namespace

double GuideBox::volume() const { return std::accumulate(extent.begin(), extent.end(), 1.0, std::multiplies<>()); }

GuideBox GuideBox::half(std::size_t axis, bool upper) const {
  GuideBox box = *this;
  box.extent[axis] /= 2;
  if (upper) box.lower[axis] += box.extent[axis];
  return box;
}

std::vector<GuideRow> make_guide(std::vector<PathNumbers> useful) { return Division(std::move(useful)).guide(); }

scene::Bytes guide_bytes(const std::vector<GuideRow>& guide) {
  std::vector<float> words(guide.size() * GUIDE_WORDS);
  for (std::size_t k = 0; k < guide.size(); ++k) {
    const GuideRow& row = guide[k];
    float* to = &words[k * GUIDE_WORDS];
    to[GUIDE_AXIS] = std::bit_cast<float>(row.child ? static_cast<std::uint32_t>(row.axis) : GLEANER_NONE);
    to[GUIDE_CHILD] = std::bit_cast<float>(row.child);
    if (row.child) to[GUIDE_SHARE] = static_cast<float>(guide[row.child].share / row.share);
    to[GUIDE_DENSITY] = static_cast<float>(row.density());
    for (std::size_t d = 0; d < GUIDE_NUMBERS; ++d) {
      to[GUIDE_LOWER + d] = static_cast<float>(row.box.lower[d]);
      to[GUIDE_EXTENT + d] = static_cast<float>(row.box.extent[d]);
    }
  }
  scene::Bytes bytes(words.size() * sizeof(float));
  std::memcpy(bytes.data(), words.data(), bytes.size());
  return bytes;
}

cl::Buffer guide_table(const StageRun& run, cl::CommandQueue& queue) {
  const InputRows input(run.task, "emission", std::size_t{GUIDE_WORDS} * 4);
  std::vector<float> words;
  cl::Buffer buffer = input.to_device(run.device, queue, [&](std::uint64_t, std::span<const std::byte> piece) {
    const std::size_t before = words.size();
    words.resize(before + piece.size() / sizeof(float));
    std::memcpy(&words[before], piece.data(), piece.size());
  });
  check_tree(input, words);
  return buffer;
}

}  // namespace gleaner::worker

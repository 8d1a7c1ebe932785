// Stage kind "photon_cluster_refine": where records that a point reads differ much (a window's bright reveal beside a
// wall, a gap above a lamp), what it interpolates between them is neither. It becomes a sample point of its own, as
// adaptive sampling subdivides where its samples differ. Solo, on the host.

#include <algorithm>
#include <cmath>
#include <cstring>
#include <unordered_map>

#include "kernels/photon_records.h"
#include "scene/model/error.h"
#include "worker/stages/photon/clusters.h"
#include "worker/stages/photon/stages.h"
#include "worker/stages/splat/stages.h"
#include "worker/wavefront/counters.h"
#include "worker/wavefront/wanted.h"

namespace gleaner::worker {
namespace {

using kernels::PhotonClusterRefineParameters;

// The weighted standard deviation of the records that a point reads, over their mean: records of few rays differ by
// 0.05.
constexpr double kMostContrast = 0.4;
// Of the mean of all records: what is darker than this part of it is not looked at so closely.
constexpr double kDark = 0.05;
// Pixels that are looked at.
constexpr std::uint64_t kMostLooked = 1u << 16;
// A sample stands for points within this part of its reach.
constexpr float kOwn = 0.5f;
// Cells that a record is entered in, at most; one that reaches farther is looked at for all points.
constexpr std::int64_t kMostCells = 64;

// Records by the cells of a grid that they reach.
class RecordGrid {
 public:
  explicit RecordGrid(const std::vector<CacheRecord>& records) : records_(records) {
    cell_ = 2 * median_reach(records);
    for (std::uint32_t i = 0; i < records.size(); ++i) enter(i);
  }

  // Calls see(record) for all that may reach the point, some perhaps twice, in an order of their own.
  template <typename See>
  void near(const SplatPoint& point, const See& see) const {
    GridCell at{};
    for (std::size_t k = 0; k < 3; ++k) at[k] = cell_of(point.position[k]);
    if (const auto found = cells_.find(key_of(at)); found != cells_.end())
      for (const std::uint32_t i : found->second) see(records_[i]);
    for (const std::uint32_t i : wide_) see(records_[i]);
  }

 private:
  std::int64_t cell_of(float x) const { return static_cast<std::int64_t>(std::floor(double{x} / cell_)); }

  void enter(std::uint32_t i) {
    std::int64_t lower[3], upper[3], cells = 1;
    for (std::size_t k = 0; k < 3; ++k) {
      lower[k] = cell_of(records_[i].position[k] - records_[i].spare[0]);
      upper[k] = cell_of(records_[i].position[k] + records_[i].spare[0]);
      cells = std::min(cells * (upper[k] - lower[k] + 1), kMostCells + 1);
    }
    if (cells > kMostCells) return wide_.push_back(i);
    for (std::int64_t x = lower[0]; x <= upper[0]; ++x)
      for (std::int64_t y = lower[1]; y <= upper[1]; ++y)
        for (std::int64_t z = lower[2]; z <= upper[2]; ++z) cells_[key_of({x, y, z})].push_back(i);
  }

  const std::vector<CacheRecord>& records_;
  double cell_ = 1;
  std::unordered_map<std::uint64_t, std::vector<std::uint32_t>> cells_;
  std::vector<std::uint32_t> wide_;
};

double sum_of(const std::array<float, 3>& rgb) { return double{rgb[0]} + rgb[1] + rgb[2]; }

// Of the records that a point reads.
struct Spread {
  double mean = 0, deviation = 0;
};

Spread spread_at(const RecordGrid& grid, const SplatPoint& point) {
  double weights = 0, sum = 0, squares = 0;
  grid.near(point, [&](const CacheRecord& record) {
    const float reach = record.spare[0], turn = record.spare[1];
    const PointOffset off = point_offset(record.position, record.normal, point);
    if (off.hidden || off.distance > reach || off.turn > turn) return;
    // Nearly as kernels/splat/shade.cl weighs it, whose radius is known after smoothing.
    const double radius = std::min(record.radius, 10 * reach);
    const double w = 1 / std::max(off.distance / radius + off.turn, 1e-3) - 1 / (reach / radius + turn);
    if (!(w > 0)) return;
    const double value = sum_of(record.irradiance);
    weights += w;
    sum += w * value;
    squares += w * value * value;
  });
  if (!(weights > 0)) return {};
  const double mean = sum / weights;
  return {mean, std::sqrt(std::max(0.0, squares / weights - mean * mean))};
}

struct Candidate {
  double off = 0;  // by what the picture may be
  std::uint32_t point = 0;
};

// The pixels' points where records differ, most important first.
std::vector<Candidate> candidates(const PhotonClusterRefineParameters& p, std::span<const SplatPoint> points,
                                  const std::vector<CacheRecord>& records) {
  PointScreen screen{.width = p.width, .height = p.height, .samples = p.samples};
  while (std::uint64_t{screen.columns()} * screen.rows() > kMostLooked) screen.step *= 2;
  const RecordGrid grid(records);
  double dark = 0;
  for (const CacheRecord& record : records) dark += sum_of(record.irradiance);
  dark *= kDark / static_cast<double>(std::max<std::size_t>(1, records.size()));
  std::vector<Candidate> found;
  for (std::uint32_t y = 0; y < screen.rows(); ++y) {
    check_wanted();
    for (std::uint32_t x = 0; x < screen.columns(); ++x) {
      const std::size_t first = screen.point_of(x * screen.step, y * screen.step);
      for (std::size_t i = first; i < first + p.samples; ++i) {
        if (!points[i].exists()) continue;
        const Spread spread = spread_at(grid, points[i]);
        if (spread.deviation > kMostContrast * (spread.mean + dark))
          found.push_back({spread.deviation * sum_of(points[i].factor), static_cast<std::uint32_t>(i)});
        break;
      }
    }
  }
  std::ranges::sort(
      found, [](const Candidate& a, const Candidate& b) { return a.off != b.off ? a.off > b.off : a.point < b.point; });
  return found;
}

std::vector<ClusterSample> choose(const std::vector<Candidate>& candidates, std::span<const SplatPoint> points,
                                  std::uint32_t most) {
  std::vector<ClusterSample> samples;
  for (const Candidate& candidate : candidates) {
    if (samples.size() >= most) break;
    check_wanted();
    const SplatPoint& point = points[candidate.point];
    const bool stood_for = std::ranges::any_of(samples, [&](const ClusterSample& sample) {
      const SplatPoint& from = points[sample.point];
      const PointOffset off = point_offset(from.position, from.normal, point);
      return off.distance <= kOwn * sample.reach && off.turn <= kOwn * sample.turn && !off.hidden;
    });
    if (!stood_for) samples.push_back(stray_sample(candidate.point, point.footprint));
  }
  return samples;
}

}  // namespace

BatchResult run_photon_cluster_refine_stage(const StageRun& run) {
  const auto p = run.parameters<PhotonClusterRefineParameters>();
  check_splat_points(run, p.width, p.height, p.samples);
  if (p.most == 0 || p.most > 1u << 20)
    throw Error::bad_input(run.where(), "most", "1 to " + std::to_string(1u << 20), std::to_string(p.most));
  run.check_range(1);
  const double start = seconds_now();
  const std::vector<SplatPoint> points = read_splat_points(run, p.width, p.height, p.samples);
  const std::vector<CacheRecord> records = read_cluster_records(run.task, "records");
  const std::vector<ClusterSample> samples = choose(candidates(p, points, records), points, p.most);
  BatchResult result = sample_places(samples, points);
  result.counters.seconds = seconds_now() - start;
  return result;
}

}  // namespace gleaner::worker

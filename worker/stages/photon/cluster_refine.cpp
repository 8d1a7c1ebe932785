// Stage kind "photon_cluster_refine": where records that a point reads differ much (a window's bright reveal beside a
// wall, a gap above a lamp), what it interpolates between them is neither. It becomes a sample point of its own, as
// adaptive sampling subdivides where its samples differ. Solo, on the host.

#include <algorithm>
#include <cmath>
#include <cstring>

#include "kernels/photon_records.h"
#include "scene/model/error.h"
#include "worker/stages/photon/reach_grid.h"
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
double sum_of(const std::array<float, 3>& rgb) { return double{rgb[0]} + rgb[1] + rgb[2]; }

// Of the records that a point reads.
struct Spread {
  double mean = 0, deviation = 0;
  bool own = false;  // one of them was gathered for this point and those beside it
};

Spread spread_at(const std::vector<CacheRecord>& records, const ReachGrid& grid, const SplatPoint& point) {
  double weights = 0, sum = 0, squares = 0;
  const ClusterSample stray = stray_sample(point);
  bool own = false;
  grid.near(point.position, [&](std::uint32_t i) {
    const CacheRecord& record = records[i];
    const float reach = record.spare[0], turn = record.spare[1];
    const PointOffset off = point_offset(record.position, record.normal, point);
    if (off.hidden || off.distance > reach || off.turn > turn) return;
    own = own || (reach <= stray.reach && off.distance <= kOwn * reach && off.turn <= kOwn * turn);
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
  return {mean, std::sqrt(std::max(0.0, squares / weights - mean * mean)), own};
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
  const ReachGrid grid = grid_of(records);
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
        const Spread spread = spread_at(records, grid, points[i]);
        if (!spread.own && spread.deviation > kMostContrast * (spread.mean + dark))
          found.push_back({spread.deviation * sum_of(points[i].factor), static_cast<std::uint32_t>(i)});
        break;
      }
    }
  }
  std::ranges::sort(
      found, [](const Candidate& a, const Candidate& b) { return a.off != b.off ? a.off > b.off : a.point < b.point; });
  return found;
}

// Samples for the candidates, after those that other cameras' points have. No more than `most` of them are for this
// camera's points.
std::vector<ClusterSample> choose(const std::vector<Candidate>& candidates, std::span<const SplatPoint> points,
                                  std::uint32_t most, std::vector<ClusterSample> samples) {
  std::vector<bool> counted(samples.size(), false);
  std::uint32_t chosen = 0;
  for (const Candidate& candidate : candidates) {
    if (chosen >= most) break;
    check_wanted();
    const SplatPoint& point = points[candidate.point];
    const auto stands =
        std::ranges::find_if(samples, [&](const ClusterSample& sample) { return covers(sample, point, kOwn); });
    if (stands == samples.end()) {
      samples.push_back(stray_sample(point));
      ++chosen;
    } else if (const auto number = static_cast<std::size_t>(stands - samples.begin()); number < counted.size()) {
      chosen += counted[number] ? 0 : 1;
      counted[number] = true;
    }
  }
  return samples;
}

BatchResult refine(const StageRun& run, const PhotonClusterRefineParameters& p, std::span<const SplatPoint> points) {
  const std::vector<CacheRecord> records = read_cluster_records(run.task);
  return sample_places(choose(candidates(p, points, records), points, p.most, read_samples(run.task, "given")));
}

void check(const StageRun& run, const PhotonClusterRefineParameters& p) {
  check_splat_points(run, p.width, p.height, p.samples);
  if (p.most == 0 || p.most > 1u << 20)
    throw Error::bad_input(run.where(), "most", "1 to " + std::to_string(1u << 20), std::to_string(p.most));
  run.check_range(1);
}

}  // namespace

BatchResult run_photon_cluster_refine_stage(const StageRun& run) {
  const auto p = run.parameters<PhotonClusterRefineParameters>();
  check(run, p);
  const double start = seconds_now();
  BatchResult result = refine(run, p, read_splat_points(run, p.width, p.height, p.samples));
  result.counters.seconds = seconds_now() - start;
  return result;
}

BatchResult run_photon_extend_refine_stage(const StageRun& run) {
  const auto p = run.parameters<kernels::PhotonExtendRefineParameters>();
  check(run, p.refine);
  const double start = seconds_now();
  BatchResult counters;
  const std::vector<SplatPoint> points =
      find_camera_points(run, p.points, p.refine.width, p.refine.height, p.refine.samples, counters);
  BatchResult result = refine(run, p.refine, points);
  result.counters = counters.counters;
  result.counters.seconds = seconds_now() - start;
  return result;
}

}  // namespace gleaner::worker

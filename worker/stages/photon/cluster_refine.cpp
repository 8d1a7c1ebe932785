// Stage kinds "photon_cluster_refine" and "photon_extend_refine": more sample points where what records say of a point
// may be off most (prediction.h), as adaptive sampling subdivides where its samples differ. Solo, on the host's
// threads.

#include <algorithm>
#include <cmath>

#include "kernels/photon_records.h"
#include "scene/model/error.h"
#include "worker/stages/photon/prediction.h"
#include "worker/stages/photon/stages.h"
#include "worker/stages/splat/stages.h"
#include "worker/wavefront/counters.h"
#include "worker/wavefront/host_threads.h"
#include "worker/wavefront/wanted.h"
#include "worker/wavefront/work_queue.h"

namespace gleaner::worker {
namespace {

using kernels::PhotonClusterRefineParameters;

// What is off by less than so many times the records' noise is left as it is.
constexpr double kLeastOff = 1.2;
// Of the mean of all records: what is darker than this part of it is not looked at so closely.
constexpr double kDark = 0.05;
// Pixels that are looked at, and how many of them a thread takes at once.
constexpr std::uint64_t kMostLooked = 1u << 16, kLooked = 256;
// A new sample stands for what is nearer to it than this part of its distance to the nearest record, within bounds of
// pixels: rounds of refinement halve gaps. Nearer than this many pixels to a record there is none.
constexpr float kNearer = 0.5f, kLeastPixels = 1, kMostPixels = 4;

// A point that the pixels show, of each that is looked at the first.
struct Candidate {
  double off = 0;  // by what the picture may be off
  float spacing = 0;
  std::uint32_t point = 0;
};

class Refinement {
 public:
  Refinement(const PhotonClusterRefineParameters& p, std::span<const SplatPoint> points,
             std::vector<ClusterSample> given, unsigned threads)
      : p_(p),
        points_(points),
        samples_(std::move(given)),
        threads_(threads),
        screen_({.width = p.width, .height = p.height, .samples = p.samples}) {
    while (std::uint64_t{screen_.columns()} * screen_.rows() > kMostLooked) screen_.step *= 2;
    for (std::uint32_t y = 0; y < screen_.rows(); ++y)
      for (std::uint32_t x = 0; x < screen_.columns(); ++x) {
        const auto first = screen_.point_of(x * screen_.step, y * screen_.step);
        const auto of_pixel = points.subspan(first, p.samples);
        if (const auto shown = std::ranges::find_if(of_pixel, &SplatPoint::exists); shown != of_pixel.end())
          looked_.push_back(static_cast<std::uint32_t>(first + static_cast<std::size_t>(shown - of_pixel.begin())));
      }
  }

  std::vector<ClusterSample> refined(const std::vector<CacheRecord>& records) && {
    const std::size_t shown = shown_of_given();
    const std::size_t given = samples_.size();
    for (const Candidate& candidate : candidates(records)) {
      if (shown + samples_.size() - given >= p_.most) break;
      check_wanted();
      const SplatPoint& point = points_[candidate.point];
      const auto fresh = std::span(samples_).subspan(given);
      if (std::ranges::any_of(fresh, [&](const ClusterSample& s) { return covers(s, point, 1 / kOverlap); })) continue;
      ClusterSample sample = stray_sample(point);
      sample.spacing = candidate.spacing;
      sample.reach = kOverlap * candidate.spacing;
      samples_.push_back(sample);
    }
    return std::move(samples_);
  }

 private:
  // Of the samples that are given, how many stand for a point here.
  std::size_t shown_of_given() const {
    std::vector<bool> shown(samples_.size(), false);
    const ReachGrid grid = grid_of(samples_);
    for (const std::uint32_t i : looked_)
      grid.near(points_[i].position,
                [&](std::uint32_t k) { shown[k] = shown[k] || covers(samples_[k], points_[i], 1 / kOverlap); });
    return static_cast<std::size_t>(std::ranges::count(shown, true));
  }

  // Most important first.
  std::vector<Candidate> candidates(const std::vector<CacheRecord>& records) const {
    const ClusterPrediction prediction(records, double{p_.noise});
    double dark = 0;
    for (const CacheRecord& record : records) dark += sum_of(record.irradiance);
    dark *= kDark / static_cast<double>(std::max<std::size_t>(1, records.size()));
    std::vector<std::vector<Candidate>> found(threads_);
    WorkQueue work(looked_.size(), threads_, kLooked);
    run_threads(threads_, [&](unsigned thread) {
      std::vector<ClusterPrediction::Read> reads;
      while (const WorkQueue::Block block = work.claim(kLooked))
        for (const std::uint32_t i : std::span(looked_).subspan(block.first, block.count)) {
          const Candidate candidate = candidate_at(i, prediction.at(points_[i], reads), dark);
          if (candidate.off > 0) found[thread].push_back(candidate);
        }
    });
    check_wanted();
    std::vector<Candidate> all;
    for (const std::vector<Candidate>& part : found) all.insert(all.end(), part.begin(), part.end());
    // Points are numbered, so that who found which does not matter.
    std::ranges::sort(
        all, [](const Candidate& a, const Candidate& b) { return a.off != b.off ? a.off > b.off : a.point < b.point; });
    return all;
  }

  // `off` is 0 where the point is told well enough, or nothing reaches it.
  Candidate candidate_at(std::uint32_t number, const Predicted& predicted, double dark) const {
    const SplatPoint& point = points_[number];
    const float pixel = point.footprint * static_cast<float>(screen_.step);
    if (!std::isfinite(predicted.nearest) || predicted.nearest < kNearer * pixel) return {};
    if (!(predicted.off > kLeastOff * double{p_.noise} * (predicted.irradiance + dark))) return {};
    return {.off = predicted.off * sum_of(point.factor),
            .spacing = std::clamp(kNearer * predicted.nearest, kLeastPixels * pixel, kMostPixels * pixel),
            .point = number};
  }

  static double sum_of(const std::array<float, 3>& rgb) { return double{rgb[0]} + rgb[1] + rgb[2]; }

  const PhotonClusterRefineParameters& p_;
  std::span<const SplatPoint> points_;
  std::vector<ClusterSample> samples_;
  unsigned threads_;
  PointScreen screen_;
  std::vector<std::uint32_t> looked_;  // of points
};

BatchResult refine(const StageRun& run, const PhotonClusterRefineParameters& p, std::span<const SplatPoint> points) {
  Refinement refinement(p, points, read_samples(run.task, "given"), host_threads(run.device));
  return sample_places(std::move(refinement).refined(read_cluster_records(run.task)));
}

void check(const StageRun& run, const PhotonClusterRefineParameters& p) {
  check_splat_points(run, p.width, p.height, p.samples);
  if (p.most == 0 || p.most > 1u << 20)
    throw Error::bad_input(run.where(), "most", "1 to " + std::to_string(1u << 20), std::to_string(p.most));
  if (!(p.noise >= 0) || !std::isfinite(p.noise))
    throw Error::bad_input(run.where(), "noise", "0 or more", std::to_string(p.noise));
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

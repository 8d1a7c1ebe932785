// Stage kind "splat_select": where records are needed (select.h), by probe rays on the device
// (kernels/splat/probe.cl). Solo.

#include <algorithm>
#include <cmath>
#include <cstring>

#include "kernels/rays.h"
#include "scene/model/error.h"
#include "worker/stages/splat/select.h"
#include "worker/stages/splat/stages.h"
#include "worker/stages/split_stage.h"
#include "worker/wavefront/path_wave.h"

namespace gleaner::worker {
namespace {

using kernels::SplatSelectFacts;
using kernels::SplatSelectParameters;

// Where there may be so many records and no more, the accuracy is raised in such steps until there are; not beyond
// this.
constexpr float kCoarser = 1.25f, kMostAccuracy = 8;
// Where every point has a record of its own, R_k in pixels: such a record reaches no other point.
constexpr float kOwnRadius = 1e-4f;

SplatSelectParameters read_parameters(const StageRun& run) {
  const auto p = run.parameters<SplatSelectParameters>();
  check_splat_points(run, p.width, p.height, p.samples);
  if (!(p.accuracy >= 0) || !(p.accuracy <= kMostAccuracy))
    throw Error::bad_input(run.where(), "accuracy", "0 to 8", std::to_string(p.accuracy));
  if (p.probe_rays == 0 || p.probe_rays % RAY_BLOCK != 0 || p.probe_rays > 4096)
    throw Error::bad_input(run.where(), "probe_rays", "a multiple of 16 up to 4096", std::to_string(p.probe_rays));
  if (!(p.least_radius > 0) || !(p.most_radius >= p.least_radius) || !std::isfinite(p.most_radius))
    throw Error::bad_input(run.where(), "radii", "pixels above 0", std::to_string(p.least_radius));
  run.check_range(1);
  return p;
}

// One host thread's rays of the places of a round.
class ProbeThread : public HostThread {
 public:
  ProbeThread(const StageRun& run, const Program& program, std::uint32_t rays, std::span<const SplatPoint> places,
              std::span<float> radii, WorkQueue& work, unsigned index)
      : HostThread(run.device, run.workspace, run.scene.tracer(), work, index),
        places_(places),
        radii_(radii),
        rays_each_(rays),
        capacity_(std::max(1u, (run.device.info().cpu ? 1u << 12 : 1u << 18) / rays)),
        rows_(take("splat.places", std::size_t{capacity_} * sizeof(SplatPoint))),
        hits_(take("paths", PathWave::bytes(capacity_ * rays, RAY_HIT_ROWS))),
        sums_(take("splat.radii", std::size_t{capacity_} * 4)),
        make_(run.device, program, "splat_probe_rays"),
        sum_(run.device, program, "splat_probe_sum") {
    make_.set("places", rows_).set("rays", rays).set("hits", hits_);
    sum_.set("hits", hits_).set("rays", rays).set("radii", sums_);
  }

  void run(BatchResult&) {
    while (const WorkQueue::Block block = work_.claim(capacity_)) {
      const auto count = static_cast<std::uint32_t>(block.count);
      queue_.enqueueWriteBuffer(rows_, CL_TRUE, 0, count * sizeof(SplatPoint), &places_[block.first]);
      make_.set("count", count * rays_each_);
      launch(make_, count * rays_each_, std::size_t{capacity_} * rays_each_);
      rays_.closest(hits_, single_rays(RAY_HIT_ROWS, count * rays_each_));
      counters.scatter += count * rays_each_;
      sum_.set("count", count);
      launch(sum_, count, capacity_, 1);
      queue_.enqueueReadBuffer(sums_, CL_TRUE, 0, count * 4, &radii_[block.first]);
    }
  }

 private:
  std::span<const SplatPoint> places_;
  std::span<float> radii_;
  std::uint32_t rays_each_, capacity_;
  cl::Buffer rows_, hits_, sums_;
  Kernel make_, sum_;
};

std::vector<float> probe(const StageRun& run, const SplatSelectParameters& p, const std::vector<SplatPoint>& points,
                         std::span<const std::uint32_t> asked, BatchResult& result) {
  std::vector<SplatPoint> places;
  places.reserve(asked.size());
  for (const std::uint32_t point : asked) places.push_back(points[point]);
  std::vector<float> radii(asked.size());
  const Program program = run.build("probe.cl");
  WorkQueue work(places.size(), host_threads(run.device), 0, run.task.given_up.get());
  run_host_threads(work, result, [&](unsigned index) {
    return std::make_unique<ProbeThread>(run, program, p.probe_rays, places, radii, work, index);
  });
  return radii;
}

Selection every_point(const std::vector<SplatPoint>& points) {
  Selection selection;
  for (std::size_t i = 0; i < points.size(); ++i)
    if (points[i].exists())
      selection.places.push_back({static_cast<std::uint32_t>(i), kOwnRadius * points[i].footprint});
  selection.points = selection.places.size();
  selection.whole = true;
  return selection;
}

// `accuracy` gets what the places are good for.
Selection select(const StageRun& run, const SplatSelectParameters& p, const std::vector<SplatPoint>& points,
                 double* accuracy, BatchResult& result) {
  *accuracy = 1;
  if (p.accuracy == 0) return every_point(points);
  SelectSettings settings{.width = p.width,
                          .height = p.height,
                          .samples = p.samples,
                          .accuracy = p.accuracy,
                          .least_radius = p.least_radius,
                          .most_radius = p.most_radius,
                          .most_records = p.records};
  for (;;) {
    if (settings.accuracy >= kMostAccuracy) settings.most_records = 0;
    Selection selection = select_places(
        settings, points, [&](std::span<const std::uint32_t> asked) { return probe(run, p, points, asked, result); });
    *accuracy = settings.accuracy;
    if (selection.whole) return selection;
    settings.accuracy = std::min(settings.accuracy * kCoarser, kMostAccuracy);
  }
}

}  // namespace

BatchResult run_splat_select_stage(const StageRun& run) {
  const SplatSelectParameters p = read_parameters(run);
  const double start = seconds_now();
  BatchResult result;
  const std::vector<SplatPoint> points = read_splat_points(run, p.width, p.height, p.samples);
  SplatSelectFacts facts;
  const Selection selection = select(run, p, points, &facts.accuracy, result);
  result.records.resize(selection.places.size() * sizeof(SplatPoint));
  std::byte* to = result.records.data();
  for (const Selection::Place& place : selection.places) {
    SplatPoint row = points[place.point];
    row.factor = {place.radius, static_cast<float>(facts.accuracy), 0};
    std::memcpy(to, &row, sizeof row);
    to += sizeof row;
  }
  facts.points = selection.points;
  facts.records = selection.places.size();
  facts.rounds = selection.rounds;
  facts.probes = selection.probes;
  result.counts = {static_cast<std::uint32_t>(selection.places.size())};
  result.facts.resize(sizeof facts);
  std::memcpy(result.facts.data(), &facts, sizeof facts);
  result.counters.seconds = seconds_now() - start;
  return result;
}

}  // namespace gleaner::worker

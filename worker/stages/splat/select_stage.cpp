// Stage kinds "splat_select" and "splat_extend": where records are needed (select.h), by probe rays on the device
// (kernels/splat/probe.cl). Solo.

#include <algorithm>
#include <cmath>
#include <cstring>
#include <unordered_map>

#include "kernels/rays.h"
#include "scene/model/error.h"
#include "worker/stages/splat/select.h"
#include "worker/stages/splat/stages.h"
#include "worker/stages/split_stage.h"
#include "worker/wavefront/host_threads.h"
#include "worker/wavefront/input_rows.h"
#include "worker/wavefront/path_wave.h"

namespace gleaner::worker {
namespace {

using kernels::SplatExtendParameters;
using kernels::SplatSelectFacts;
using kernels::SplatSelectParameters;

// Where there may be so many records and no more, the accuracy is raised in such steps until there are; not beyond
// this.
constexpr float kCoarser = 1.25f, kMostAccuracy = 8;
// Where every point has a record of its own, R_k in pixels: such a record reaches no other point.
constexpr float kOwnRadius = 1e-4f;

void check(const StageRun& run, const SplatSelectParameters& p) {
  check_splat_points(run, p.width, p.height, p.samples);
  if (!(p.accuracy >= 0) || !(p.accuracy <= kMostAccuracy))
    throw Error::bad_input(run.where(), "accuracy", "0 to 8", std::to_string(p.accuracy));
  if (p.probe_rays == 0 || p.probe_rays % RAY_BLOCK != 0 || p.probe_rays > 4096)
    throw Error::bad_input(run.where(), "probe_rays", "a multiple of 16 up to 4096", std::to_string(p.probe_rays));
  if (!(p.least_radius > 0) || !(p.most_radius >= p.least_radius) || !std::isfinite(p.most_radius))
    throw Error::bad_input(run.where(), "radii", "pixels above 0", std::to_string(p.least_radius));
  run.check_range(1);
}

// Rays of the places of rounds, by the calling thread: a round has so few that it is over before others have begun.
class ProbeRays : public HostThread {
 public:
  ProbeRays(const StageRun& run, const Program& program, std::uint32_t rays, WorkQueue& work)
      : HostThread(run.device, run.workspace, run.scene.tracer(), work, 0),
        rays_each_(rays),
        capacity_(std::max(1u, (run.device.info().cpu ? 1u << 12 : 1u << 18) / rays)),
        rows_(take("splat.places", std::size_t{capacity_} * sizeof(SplatPoint))),
        hits_(take("paths", PathWave::bytes(capacity_ * rays, RAY_HIT_ROWS))),
        sums_(take("splat.radii", std::size_t{capacity_} * 4)),
        clearances_(take("splat.clearances", std::size_t{capacity_} * sizeof(Clearance))),
        make_(run.device, program, "splat_probe_rays"),
        sum_(run.device, program, "splat_probe_sum"),
        clear_rays_(run.device, program, "splat_clear_rays"),
        clear_(run.device, program, "splat_clearances") {
    make_.set("places", rows_).set("rays", rays).set("hits", hits_);
    sum_.set("hits", hits_).set("rays", rays).set("radii", sums_);
    clear_rays_.set("places", rows_).set("hits", hits_);
    clear_.set("places", rows_).set("hits", hits_).set("clearances", clearances_);
  }

  void measure(std::span<const SplatPoint> places, std::span<Surroundings> found) {
    std::vector<float> radii(capacity_);
    std::vector<Clearance> clearances(capacity_);
    for (std::size_t done = 0; done < places.size(); done += capacity_) {
      const auto count = static_cast<std::uint32_t>(std::min<std::size_t>(capacity_, places.size() - done));
      queue_.enqueueWriteBuffer(rows_, CL_TRUE, 0, count * sizeof(SplatPoint), &places[done]);
      make_.set("count", count * rays_each_);
      launch(make_, count * rays_each_, std::size_t{capacity_} * rays_each_);
      rays_.closest(hits_, single_rays(RAY_HIT_ROWS, count * rays_each_));
      counters.scatter += count * rays_each_;
      sum_.set("count", count);
      launch(sum_, count, capacity_, 1);
      queue_.enqueueReadBuffer(sums_, CL_TRUE, 0, count * 4, radii.data());
      constexpr std::uint32_t directions = SPLAT_DIRECTIONS;
      clear_rays_.set("count", count * directions);
      launch(clear_rays_, count * directions, std::size_t{capacity_} * rays_each_);
      rays_.closest(hits_, single_rays(RAY_HIT_ROWS, count * directions));
      counters.scatter += count * directions;
      clear_.set("count", count * directions);
      launch(clear_, count * directions, std::size_t{capacity_} * rays_each_);
      queue_.enqueueReadBuffer(clearances_, CL_TRUE, 0, count * sizeof(Clearance), clearances.data());
      for (std::uint32_t i = 0; i < count; ++i) found[done + i] = {radii[i], clearances[i]};
    }
  }

 private:
  std::uint32_t rays_each_, capacity_;
  cl::Buffer rows_, hits_, sums_, clearances_;
  Kernel make_, sum_, clear_rays_, clear_;
};

class Probe {
 public:
  Probe(const StageRun& run, const SplatSelectParameters& p, std::span<const SplatPoint> points, BatchResult& result)
      : points_(points), result_(result), rays_(run, run.build("probe.cl"), p.probe_rays, work_) {}
  Probe(const Probe&) = delete;
  Probe& operator=(const Probe&) = delete;
  ~Probe() { rays_.counters.add_to(result_.counters, 1); }

  // What is about these points. Each is measured once, however often a selection begins anew.
  std::vector<Surroundings> operator()(std::span<const std::uint32_t> asked) {
    const double start = seconds_now();
    std::vector<SplatPoint> places;
    for (const std::uint32_t point : asked)
      if (known_.try_emplace(point, static_cast<std::uint32_t>(found_.size() + places.size())).second)
        places.push_back(points_[point]);
    const std::size_t before = found_.size();
    found_.resize(before + places.size());
    try {
      rays_.measure(places, std::span(found_).subspan(before));
    } catch (...) {
      work_.stop();
      throw;
    }
    std::vector<Surroundings> about;
    for (const std::uint32_t point : asked) about.push_back(found_[known_.at(point)]);
    rays_.counters.all += seconds_now() - start;
    return about;
  }

 private:
  std::span<const SplatPoint> points_;
  BatchResult& result_;
  WorkQueue work_{0, 1};
  ProbeRays rays_;
  std::unordered_map<std::uint32_t, std::uint32_t> known_;  // point -> its place in what was found
  std::vector<Surroundings> found_;
};

// The places of records that exist already, as this stage wrote them. `accuracy`: what they were chosen with; 0: there
// are none.
std::vector<Selection::Place> given_places(const StageRun& run, float* accuracy) {
  std::vector<Selection::Place> places;
  *accuracy = 0;
  if (!run.task.inputs.contains("given")) return places;
  const InputRows input(run.task, "given", sizeof(SplatPlace));
  places.reserve(input.rows());
  input.visit(0, input.rows(), [&](std::uint64_t first, std::span<const std::byte> piece) {
    for (std::size_t at = 0; at < piece.size(); at += sizeof(SplatPlace)) {
      SplatPlace row;
      std::memcpy(&row, piece.data() + at, sizeof row);
      const Selection::Place place{row.point,  row.point.factor[2], row.point.factor[0],
                                   row.narrow, row.shaped != 0,     row.clearance};
      *accuracy = std::max(*accuracy, place.point.factor[1]);
      bool sound = place.point.exists() && place.radius > 0 && place.mean > 0 && std::isfinite(place.narrow[0]) &&
                   std::isfinite(place.narrow[1]);
      for (std::size_t k = 0; k < 3; ++k)
        sound = sound && std::isfinite(place.point.position[k]) && std::isfinite(place.point.normal[k]) &&
                std::isfinite(place.point.factor[k]);
      for (const float one_over : place.clearance) sound = sound && one_over >= 0 && std::isfinite(one_over);
      if (!sound) input.fail(first + at / sizeof(SplatPlace), "radius", "a place with its distances", "another");
      places.push_back(place);
    }
  });
  return places;
}

Selection every_point(const std::vector<SplatPoint>& points) {
  Selection selection;
  for (const SplatPoint& point : points)
    if (point.exists())
      selection.places.push_back(
          {.point = point, .mean = kOwnRadius * point.footprint, .radius = kOwnRadius * point.footprint});
  selection.points = selection.places.size();
  selection.whole = true;
  return selection;
}

// What of `most_new` records the places of `covering` leave is spent on the next finer accuracy, as far as it goes, so
// that pictures that follow come to it. `settings`: what the places cover all points with.
Selection spend_the_rest(const SelectSettings& settings, const std::vector<SplatPoint>& points,
                         const Selection& covering, std::size_t given, std::uint32_t most_new,
                         const ProbePoints& probe) {
  const std::size_t most = given + most_new, rest = most - std::min(most, covering.places.size());
  // Places that shrink on the way cover less: some records are left for what that takes.
  for (std::size_t share = rest * 3 / 4; share > 0; share /= 2) {
    SelectSettings finer = settings;
    finer.accuracy /= kCoarser;
    finer.most_new = static_cast<std::uint32_t>(share);
    Selection more = select_places(finer, points, covering.places, probe);
    more.places.resize(std::min(more.places.size(), covering.places.size() + share));
    SelectSettings again = settings;
    again.most_new = 0;
    Selection whole = select_places(again, points, more.places, probe);
    if (whole.places.size() <= most) return whole;
  }
  return covering;
}

// `accuracy` gets what the places are good for.
Selection select(const StageRun& run, const SplatSelectParameters& p, const std::vector<SplatPoint>& points,
                 std::span<const Selection::Place> given, float given_accuracy, double* accuracy, BatchResult& result) {
  *accuracy = 1;
  if (p.accuracy == 0) return every_point(points);
  const float finest = std::max(p.accuracy, p.keep_accuracy ? given_accuracy : 0);
  SelectSettings settings{.width = p.width,
                          .height = p.height,
                          .samples = p.samples,
                          .accuracy = finest,
                          .least_radius = p.least_radius,
                          .most_radius = p.most_radius,
                          .block_tiles = p.block_tiles,
                          .most_new = p.most_new,
                          .threads = host_threads(run.device)};
  Probe probe(run, p, points, result);
  for (;;) {
    if (settings.accuracy >= kMostAccuracy) settings.most_new = 0;
    Selection selection = select_places(settings, points, given, std::ref(probe));
    *accuracy = settings.accuracy;
    if (selection.whole)
      return p.most_new && settings.accuracy > finest
                 ? spend_the_rest(settings, points, selection, given.size(), p.most_new, std::ref(probe))
                 : selection;
    settings.accuracy = std::min(settings.accuracy * kCoarser, kMostAccuracy);
  }
}

void choose_places(const StageRun& run, const SplatSelectParameters& p, const std::vector<SplatPoint>& points,
                   BatchResult& result) {
  SplatSelectFacts facts;
  float given_accuracy = 0;
  const std::vector<Selection::Place> given = given_places(run, &given_accuracy);
  const Selection selection = select(run, p, points, given, given_accuracy, &facts.accuracy, result);
  result.records.resize(selection.places.size() * sizeof(SplatPlace));
  std::byte* to = result.records.data();
  for (const Selection::Place& place : selection.places) {
    SplatPlace row{.point = place.point,
                   .narrow = place.narrow,
                   .shaped = place.shaped,
                   .reserved = 0,
                   .clearance = place.clearance};
    row.point.factor = {place.radius, static_cast<float>(facts.accuracy), place.mean};
    std::memcpy(to, &row, sizeof row);
    to += sizeof row;
  }
  facts.points = selection.points;
  facts.records = selection.places.size();
  facts.given = p.accuracy > 0 ? given.size() : 0;
  facts.rounds = selection.rounds;
  facts.probes = selection.probes;
  result.counts = {static_cast<std::uint32_t>(selection.places.size())};
  result.facts.resize(sizeof facts);
  std::memcpy(result.facts.data(), &facts, sizeof facts);
}

}  // namespace

BatchResult run_splat_select_stage(const StageRun& run) {
  const auto p = run.parameters<SplatSelectParameters>();
  check(run, p);
  const double start = seconds_now();
  BatchResult result;
  choose_places(run, p, read_splat_points(run, p.width, p.height, p.samples), result);
  result.counters.seconds = seconds_now() - start;
  return result;
}

BatchResult run_splat_extend_stage(const StageRun& run) {
  const auto p = run.parameters<SplatExtendParameters>();
  check(run, p.select);
  const double start = seconds_now();
  BatchResult result;
  const std::vector<SplatPoint> points =
      find_camera_points(run, p.points, p.select.width, p.select.height, p.select.samples, result);
  choose_places(run, p.select, points, result);
  result.counters.seconds = seconds_now() - start;
  return result;
}

}  // namespace gleaner::worker

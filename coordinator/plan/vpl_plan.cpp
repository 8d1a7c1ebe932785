#include "coordinator/plan/vpl_plan.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <limits>
#include <nlohmann/json.hpp>
#include <optional>

#include "coordinator/plan/graph.h"
#include "coordinator/plan/path_sampler.h"
#include "coordinator/plan/spread_points.h"
#include "coordinator/plan/trajectory.h"
#include "coordinator/plan/vpl_pilot.h"
#include "coordinator/plan/vpl_settings.h"
#include "kernels/cluster_records.h"
#include "kernels/path_records.h"
#include "kernels/vpl_host_records.h"
#include "kernels/vpl_records.h"
#include "scene/model/error.h"
#include "scene/model/order.h"

namespace gleaner::coordinator {
namespace {

using namespace kernels;
using Artifact = Graph::Artifact;
using Shape = VplPilotShape;

constexpr std::uint32_t kIterations = 6;
// Points looked at for each point cluster (the paper's down-sampling).
constexpr std::uint64_t kPointsPerCluster = 8;
constexpr std::uint32_t kMostPaths = 1u << 16;
// Of a trajectory's cameras together, so that they are soon merged; but of no camera less than a few points a cluster.
constexpr std::uint64_t kMostTrajectoryPoints = std::uint64_t{1} << 20;
constexpr std::uint64_t kFewPointsPerCluster = 4;
// Where these are more than so many (256 MiB), fewer cameras stand for the trajectory.
constexpr std::uint64_t kTrajectoryPointsLimit = 4 * kMostTrajectoryPoints;
// How many times a single camera's point clusters a trajectory may have, and how much all passes' visibility may take.
constexpr std::uint64_t kMostGrowth = 16;
constexpr std::uint64_t kMostPointClusters = std::uint64_t{1} << 22;  // as of vpl.point_clusters
constexpr std::uint64_t kMostVisibilityBytes = std::uint64_t{128} << 20;
// The pilot's bounds of the geometry term, in units of the VPLs' density at their usual number: on the Cornell boxes
// and on sponza, at the usual counts, the least error lies between them.
constexpr std::array<double, Shape::bounds> kPilotBounds = {0.0125, 0.025, 0.05, 0.1};
// Camera paths of the pilot: two chunks of samples in a part of the pixels.
constexpr std::uint64_t kPilotPart = 256, kLeastPilotPixels = 256, kMostPilotPixels = 1024;
constexpr float kUnbounded = std::numeric_limits<float>::infinity();

// Records of these stages stay with the workers; those of the pixels alone are collected.
constexpr Placement kRetain = Placement::retain;
constexpr Extent kOwnItems = Extent::own_items;

StageOutput retained(std::size_t record_bytes, bool reusable) {
  return {.record_bytes = static_cast<std::uint32_t>(record_bytes), .placement = kRetain, .reusable = reusable};
}
// Of one item, as many rows as it makes, up to `most`.
StageOutput retained_rows(std::size_t words, std::uint64_t most, bool reusable) {
  StageOutput output = retained(words * 4, reusable);
  output.counted = true;
  output.most_records = static_cast<std::uint32_t>(most);
  return output;
}
// These read their inputs alone.
StageSpec solo(const std::string& name, const char* kind, std::uint64_t items, const StageOutput& output) {
  return {.name = name,
          .kind = kind,
          .items = items,
          .solo = true,
          .scene_parts = kNoScene,
          .priority = kFirst,
          .output = output};
}
StageSpec split(const std::string& name, const char* kind, std::uint64_t items, std::uint32_t tile, unsigned parts,
                const StageOutput& output) {
  return {.name = name,
          .kind = kind,
          .items = items,
          .tile = tile,
          .scene_parts = parts,
          .priority = kFirst,
          .output = output};
}

StageSpec with_work(StageSpec spec, double work) {
  spec.work = work;
  return spec;
}

class VplPlan final : public GraphPlan {
 public:
  VplPlan(const FrameSettings& settings, const SceneSummary& scene);

  bool conclude(const std::vector<CutStage>& cut) override;
  // A single pass is in both halves of the samples; several tell of each other.
  double shared_squared_error() const override { return prediction_ && film_.passes() == 1 ? prediction_->vpl() : 0; }
  double predicted_work() const override {
    return paths_.predicted_work() + work_to_come(own_work(), paths_.asked_work());
  }
  std::vector<Skip> skips() const override;
  std::vector<std::string> warnings() const override { return paths_.warnings(); }
  std::string parameters_json() const override;
  std::vector<std::string> outline() const override;

 private:
  struct Pass {
    Artifact traced;         // VPLs of the light paths
    Artifact lights;         // resampled
    Artifact table;          // ordered, and their members
    std::uint32_t rows = 0;  // of the table, without members
    std::uint32_t made = 0, kept = 0, clusters = 0;
  };
  double shade_work(double lights) const {
    return static_cast<double>(pixels()) * (vpl_.samples * VplWork::sample + lights * VplWork::shade);
  }
  double own_work() const;

  // While the pilot runs.
  struct Pilot {
    Artifact lights, points, queried_lights, queried_points;
    std::array<double, Shape::bounds> bounds{};
  };

  std::uint64_t pixels() const { return std::uint64_t{settings_.width} * settings_.height; }
  bool indirect() const { return settings_.depth != 1; }
  bool on_trajectory() const { return !settings_.trajectory.empty(); }

  void begin() override;
  void begin_paths();

  void trace(std::uint32_t pass);
  Artifact resample(const std::string& name, const Artifact& traced, std::uint32_t pass);
  void cluster_lights(std::uint32_t pass);
  void order_lights(std::uint32_t pass, const Artifact& clusters);
  void query_visibility(std::uint32_t pass);
  void shade(std::uint32_t pass, const Artifact& visibility);
  void leave_dark(std::uint32_t pass);
  void begin_next(std::uint32_t pass);

  VplPointParameters point_parameters() const;
  std::uint64_t points_of_a_camera() const;
  std::uint64_t most_trajectory_clusters() const;
  VplPointParameters points_parameters() const;
  Artifact ask_points(const std::string& name, const scene::Camera& camera);
  void ask_point_clusters();
  void merge_points();
  void cluster_points(const Artifact& points);

  void begin_pilot(const Artifact& traced);
  void measure_pilot();
  Artifact pilot_paths(std::uint32_t number);
  void choose(const VplPilotFacts& facts);
  void end_pilot();

  FrameSettings settings_;
  VplSettings vpl_;
  PathSampler paths_;
  std::uint32_t light_paths_ = 0;  // of a pass
  std::vector<Pass> passes_;
  float clamp_ = 0;                   // bound of the geometry term, 1/m^2
  std::uint32_t point_clusters_ = 0;  // asked for; of a trajectory: known when its points are merged
  std::uint64_t merged_points_ = 0;
  Artifact points_;               // the point clusters; none where there are none
  std::uint64_t point_rows_ = 0;  // of them
  Artifact points_known_;         // an event: from then on the two above hold
  Pilot pilot_;
  std::optional<VplPrediction> prediction_;
  std::uint64_t faced_away_ = 0, negligible_ = 0, queried_ = 0;
};

VplPlan::VplPlan(const FrameSettings& settings, const SceneSummary& scene)
    : GraphPlan(settings, scene),
      settings_(settings),
      vpl_(make_vpl_settings(settings)),
      paths_(graph_, film_, settings),
      light_paths_(std::clamp(vpl_.count, 1024u, kMostPaths)),
      passes_(vpl_.passes),
      point_clusters_(vpl_.point_clusters) {
  const std::uint64_t cameras =
      std::max<std::uint64_t>(2, kTrajectoryPointsLimit / std::min(pixels(), points_of_a_camera()));
  if (settings_.trajectory.size() > cameras) settings_.trajectory = trajectory_of(settings_.trajectory, cameras);
  skips_ = path_skips(scene.needs);
}

void VplPlan::begin() {
  if (!indirect()) {
    begin_paths();
    return;
  }
  // One pass after another, each begun while the one before is shaded: a frame whose time is up has whole passes.
  points_known_ = graph_.event();
  trace(0);
  if (vpl_.piloted) {
    begin_pilot(passes_[0].traced);
    return;
  }
  cluster_lights(0);
  ask_point_clusters();
}

void VplPlan::begin_paths() {
  paths_.begin({.classes = indirect() ? PATH_CLASS_DIFFUSE : 0,
                .limit = vpl_.compensate ? clamp_ : kUnbounded,
                .compensates = indirect(),
                .mean = prediction_ ? prediction_->vpl_mean : 0,
                .squared_error = prediction_ ? kVplCaution * prediction_->vpl() : 0});
}

// All that the VPLs take, by the counts as they are known; what is next to nothing is left out.
double VplPlan::own_work() const {
  if (!indirect()) return 0;
  const auto passes = static_cast<double>(passes_.size());
  const double traced = passes * VplWork::path * light_paths_;
  // A pilot chooses counts that are worth as much work as the paths, but takes no fewer VPLs than these.
  if (vpl_.piloted && !prediction_)
    return traced + static_cast<double>(pixels()) * settings_.method_spp() + passes * VplWork::light * kLeastChosen;
  const double kept = vpl_.count, lights = vpl_.clusters ? std::min(vpl_.clusters, vpl_.count) : vpl_.count;
  const double of_pass =
      (lights < kept ? VplWork::light * kept : 0) + VplWork::pair * lights * vpl_.point_clusters + shade_work(lights);
  return traced + passes * of_pass + VplWork::point * static_cast<double>(kPointsPerCluster) * vpl_.point_clusters;
}

// --- Virtual point lights ---

void VplPlan::trace(std::uint32_t pass) {
  VplTraceParameters p{};
  // Several times the VPLs that are kept: which they are is then decided by what they carry.
  p.items_low = light_paths_;
  p.depth = settings_.depth ? settings_.depth - 1 : 0;
  p.pass = pass;
  p.seed_low = low(settings_.seed);
  p.seed_high = high(settings_.seed);
  StageOutput output = retained(VPL_WORDS * 4, true);  // another camera sees the same lights
  output.counted = true;
  output.most_records = VPL_PATH_SLOTS;
  passes_[pass].traced =
      graph_.add(with_work(split(numbered("vpl.trace", pass), "vpl_trace", light_paths_, 16, kWholeScene, output),
                           VplWork::path * light_paths_),
                 p);
}

Artifact VplPlan::resample(const std::string& name, const Artifact& traced, std::uint32_t pass) {
  return graph_.add(solo(name, "vpl_resample", 1, retained_rows(VPL_WORDS, vpl_.count, true)),
                    VplResampleParameters{.paths = light_paths_,
                                          .count = vpl_.count,
                                          .seed_low = low(settings_.seed),
                                          .seed_high = high(settings_.seed),
                                          .pass = pass},
                    {{"paths", traced}});
}

// Clusters of the pass's VPLs, once they are drawn; and of the first pass, the bound of the geometry term.
void VplPlan::cluster_lights(std::uint32_t pass) {
  Pass& s = passes_[pass];
  s.lights = resample(numbered("vpl.resample", pass), s.traced, pass);
  s.traced = {};
  graph_.when({s.lights}, [this, pass] {
    Pass& drawn = passes_[pass];
    const auto facts = drawn.lights.facts<VplResampleFacts>();
    drawn.lights.check_facts(
        facts.kept == drawn.lights.record_count() && std::isfinite(facts.density),
        std::to_string(facts.kept) + " VPLs, and " + std::to_string(drawn.lights.record_count()) + " records");
    drawn.made = low(facts.made);
    drawn.kept = low(facts.kept);
    if (!paths_.begun()) {
      // Where the bound is that many times the VPLs' density, a VPL's own spot is that many times as bright as the
      // light of all its neighbours together: free of the scene's scale.
      clamp_ = vpl_.clamp > 0 && facts.density > 0 ? static_cast<float>(vpl_.clamp * facts.density) : kUnbounded;
      begin_paths();
    }
    if (drawn.kept == 0) {
      leave_dark(pass);
      return;
    }
    Artifact clusters;
    if (vpl_.clusters != 0 && vpl_.clusters < drawn.kept) {
      ClusterParameters p{};
      p.clusters = vpl_.clusters;
      p.iterations = kIterations;
      p.least_cosine = CLUSTER_LEAST_COSINE;
      p.random_representative = vpl_.random_representative ? low(settings_.seed) * 4096 + pass + 1 : 0;
      p.lights = drawn.kept;
      const std::uint64_t items = p.clusters + (std::uint64_t{p.lights} + VPL_WORDS - 1) / VPL_WORDS;
      clusters =
          graph_.add(with_work(solo(numbered("vpl.cluster", pass), "vpl_cluster", items, retained(VPL_WORDS * 4, true)),
                               VplWork::light * drawn.kept),
                     p, {{"lights", drawn.lights}});
    }
    order_lights(pass, clusters);
  });
}

void VplPlan::order_lights(std::uint32_t pass, const Artifact& clusters) {
  Pass& s = passes_[pass];
  // A slice is padded to 32 rows; a member lies behind its cluster.
  const std::uint64_t most = 2 * std::uint64_t{s.kept} + 64 * std::uint64_t{vpl_.samples};
  std::vector<Graph::Input> inputs = {{"lights", s.lights}};
  if (clusters) inputs.push_back({"clusters", clusters});
  s.table = graph_.add(solo(numbered("vpl.order", pass), "vpl_order", 1, retained_rows(VPL_WORDS, most, true)),
                       VplOrderParameters{.slices = vpl_.samples, .clusters = clusters ? vpl_.clusters : 0},
                       std::move(inputs));
  s.lights = {};
  graph_.when({s.table, points_known_}, [this, pass] {
    const auto facts = passes_[pass].table.facts<VplOrderFacts>();
    const std::uint64_t slice = 32 * std::uint64_t{vpl_.samples};
    if (facts.rows == 0 || facts.rows % slice != 0 || facts.clusters > facts.rows || facts.clusters == 0 ||
        facts.rows + facts.members != passes_[pass].table.record_count())
      throw Error::failed("stage " + passes_[pass].table.stage() + ": facts of " + std::to_string(facts.rows) +
                          " rows, " + std::to_string(facts.clusters) + " of them clusters, and " +
                          std::to_string(facts.members) + " members, with " +
                          std::to_string(passes_[pass].table.record_count()) + " records");
    passes_[pass].rows = low(facts.rows);
    passes_[pass].clusters = low(facts.clusters);
    if (point_rows_ == 0)
      shade(pass, {});
    else
      query_visibility(pass);
  });
}

// No light: the paths alone make the picture.
void VplPlan::leave_dark(std::uint32_t pass) {
  skips_.push_back({"visibility and shading of pass " + std::to_string(pass), "no light reached a diffuse surface", 1});
  add_pass({});
  begin_next(pass);
}

void VplPlan::query_visibility(std::uint32_t pass) {
  Pass& s = passes_[pass];
  VisibilityParameters p{};
  p.clusters = s.rows;
  p.point_clusters = low(point_rows_);
  p.clamp = clamp_;
  p.cutoff = static_cast<float>(vpl_.contribution_cutoff);
  const std::size_t row_bytes = (s.rows / 32 + VISIBILITY_COUNTS) * 4;
  const Artifact visibility =
      graph_.add(with_work(split(numbered("vpl.visibility", pass), "vpl_visibility", point_rows_, 1, kSurfaces,
                                 retained(row_bytes, on_trajectory())),
                           VplWork::pair * static_cast<double>(point_rows_) * s.clusters),
                 p, {{"lights", s.table}, {"points", points_}});
  const Artifact skipped = graph_.add(split(numbered("vpl.skipped", pass), "vpl_skipped", point_rows_, 1, kNoScene,
                                            {.record_bytes = sizeof(VplSkippedRecord), .reusable = on_trajectory()}),
                                      VplSkippedParameters{.lights = s.rows}, {{"visibility", visibility, kOwnItems}});
  graph_.on_records(skipped, [this](auto, auto count, const Bytes& records) {
    for (std::uint64_t k = 0; k < count; ++k) {
      VplSkippedRecord row;
      std::memcpy(&row, records.data() + k * sizeof row, sizeof row);
      faced_away_ += row.faced_away;
      negligible_ += row.negligible;
    }
  });
  graph_.when({visibility}, [this, pass, visibility] {
    queried_ += point_rows_ * passes_[pass].clusters;
    shade(pass, visibility);
  });
}

void VplPlan::shade(std::uint32_t pass, const Artifact& visibility) {
  Pass& s = passes_[pass];
  VplPointParameters p = point_parameters();
  p.pass = pass;
  p.items_low = static_cast<std::uint32_t>(pixels());
  p.clusters = s.rows;
  p.point_clusters = low(point_rows_);
  p.fuzziness = vpl_.fuzziness;
  p.equal_weights = vpl_.equal_weights ? 1 : 0;
  p.clamp = clamp_;
  p.residual_threshold = static_cast<float>(vpl_.residual_threshold);
  std::vector<Graph::Input> inputs = {{"lights", s.table}};
  if (visibility) {
    inputs.push_back({"points", points_});
    inputs.push_back({"visibility", visibility});
  }
  const Artifact shaded = graph_.add(with_work(split(numbered("vpl.shade", pass), "vpl_shade", pixels(), 16,
                                                     kWholeScene, {.record_bytes = 12, .floats = true}),
                                               shade_work(s.clusters)),
                                     p, std::move(inputs));
  s.table = {};
  preview_pass(shaded);
  add_pass(shaded);
  begin_next(pass);
}

void VplPlan::begin_next(std::uint32_t pass) {
  own_stages_asked_ = pass + 1 == passes_.size();
  if (own_stages_asked_) return;
  trace(pass + 1);
  cluster_lights(pass + 1);
}

// --- Points ---

VplPointParameters VplPlan::point_parameters() const {
  VplPointParameters p{};
  p.camera = settings_.camera;
  p.width = settings_.width;
  p.height = settings_.height;
  p.samples = vpl_.samples;
  p.seed_low = low(settings_.seed);
  p.seed_high = high(settings_.seed);
  p.depth = settings_.depth;
  p.stride = 1;
  p.clamp = kUnbounded;
  return p;
}

// How many points are wanted of one camera.
std::uint64_t VplPlan::points_of_a_camera() const {
  const std::uint64_t clusters = vpl_.point_clusters, cameras = std::max<std::size_t>(1, settings_.trajectory.size());
  const std::uint64_t most = std::max(kMostTrajectoryPoints / cameras, kFewPointsPerCluster * clusters);
  const std::uint64_t all = kPointsPerCluster * clusters;
  return std::max<std::uint64_t>(1, on_trajectory() ? std::min(all, most) : all);
}

// How many point clusters a trajectory may have.
std::uint64_t VplPlan::most_trajectory_clusters() const {
  const std::uint64_t lights = std::uint64_t{vpl_.passes} * (vpl_.clusters ? vpl_.clusters : vpl_.count);
  const std::uint64_t most =
      std::min({kMostGrowth * vpl_.point_clusters, kMostVisibilityBytes * 8 / lights, kMostPointClusters});
  return std::max<std::uint64_t>(most, vpl_.point_clusters);
}

VplPointParameters VplPlan::points_parameters() const {
  VplPointParameters p = point_parameters();
  // A pilot needs some even where every point queries all lights.
  const std::uint64_t wanted = vpl_.piloted && !vpl_.point_clusters ? Shape::mean_points : points_of_a_camera();
  spread_points(p, wanted);
  return p;
}

Artifact VplPlan::ask_points(const std::string& name, const scene::Camera& camera) {
  VplPointParameters p = points_parameters();
  p.camera = camera;
  return graph_.add(split(name, "vpl_points", p.items_low, 16, kSurfaces, retained(POINT_WORDS * 4, true)), p);
}

void VplPlan::ask_point_clusters() {
  if (!vpl_.point_clusters)
    graph_.announce(points_known_);
  else if (on_trajectory())
    merge_points();
  else
    cluster_points(ask_points("vpl.points", settings_.camera));
}

void VplPlan::merge_points() {
  const auto cameras = static_cast<std::uint32_t>(settings_.trajectory.size());
  std::vector<Graph::Input> inputs = {{"cameras", graph_.data(settings_.trajectory)}};
  // Of each camera: nothing in them depends on which frame asks.
  for (std::uint32_t k = 0; k < cameras; ++k)
    inputs.push_back({numbered("points", k), ask_points(numbered("vpl.points", k), settings_.trajectory[k])});
  const std::uint64_t most = std::uint64_t{cameras} * points_parameters().items_low;
  const Artifact merged =
      graph_.add(solo("vpl.merge_points", "vpl_merge_points", 1, retained_rows(POINT_WORDS, most, true)),
                 VplMergePointsParameters{.cameras = cameras}, std::move(inputs));
  graph_.when({merged}, [this, merged] {
    const auto facts = merged.facts<VplMergePointsFacts>();
    merged.check_facts(facts.points == merged.record_count() && facts.most_of_a_camera <= facts.points,
                       std::to_string(facts.points) + " points, " + std::to_string(facts.most_of_a_camera) +
                           " of a camera, and " + std::to_string(merged.record_count()) + " records");
    merged_points_ = facts.points;
    if (facts.points == 0) {
      graph_.announce(points_known_);
      return;
    }
    // As many points a cluster as of the camera that sees most.
    const std::uint64_t densest = std::max<std::uint64_t>(1, facts.most_of_a_camera);
    const double grown =
        static_cast<double>(vpl_.point_clusters) * static_cast<double>(facts.points) / static_cast<double>(densest);
    point_clusters_ = static_cast<std::uint32_t>(std::lround(
        std::clamp(grown, static_cast<double>(vpl_.point_clusters), static_cast<double>(most_trajectory_clusters()))));
    cluster_points(merged);
  });
}

void VplPlan::cluster_points(const Artifact& points) {
  const std::uint64_t wanted = kPointsPerCluster * std::uint64_t{point_clusters_};
  Artifact some = points;
  if (vpl_.piloted && wanted < points.record_count())  // more were looked at than so few clusters need
    some = graph_.add(solo("vpl.sample_points", "vpl_sample_points", wanted, retained(POINT_WORDS * 4, true)),
                      VplSamplePointsParameters{.count = low(wanted)}, {{"points", points}});
  ClusterParameters p{};
  p.clusters = point_clusters_;
  p.iterations = kIterations;
  p.least_cosine = CLUSTER_LEAST_COSINE;
  StageOutput output = retained(POINT_WORDS * 4, true);
  output.counted = true;  // a cluster without members has no record
  const Artifact clusters =
      graph_.add(with_work(solo("vpl.point_cluster", "point_cluster", point_clusters_, output),
                           VplWork::point * static_cast<double>(kPointsPerCluster) * point_clusters_),
                 p, {{"points", some}});
  graph_.when({clusters}, [this, clusters] {
    point_rows_ = clusters.record_count();
    if (point_rows_) points_ = clusters;
    graph_.announce(points_known_);
  });
}

// --- The pilot ---

void VplPlan::begin_pilot(const Artifact& traced) {
  pilot_.lights = resample("vpl.pilot.resample", traced, 0);
  pilot_.points = ask_points("vpl.points", settings_.camera);
  pilot_.queried_lights =
      graph_.add(solo("vpl.pilot.lights", "vpl_pilot_lights", 1, retained_rows(VPL_WORDS, Shape::lights, false)),
                 VplPilotRowsParameters{}, {{"lights", pilot_.lights}});
  pilot_.queried_points = graph_.add(
      solo("vpl.pilot.points", "vpl_pilot_points", 1, retained_rows(POINT_WORDS, Shape::queried_points, true)),
      VplPilotRowsParameters{}, {{"points", pilot_.points}});
  graph_.when({pilot_.lights, pilot_.queried_lights, pilot_.queried_points}, [this] { measure_pilot(); });
}

void VplPlan::measure_pilot() {
  const double density = pilot_.lights.facts<VplResampleFacts>().density;
  const std::uint64_t lights = pilot_.queried_lights.record_count(), points = pilot_.queried_points.record_count();
  if (!(density > 0) || !std::isfinite(density) || lights != Shape::lights || points == 0) {
    // No light, or nothing that it falls on: a frame with the usual counts is soon done.
    end_pilot();
    return;
  }
  std::ranges::transform(kPilotBounds, pilot_.bounds.begin(), [&](double bound) { return bound * density; });
  VisibilityParameters p{};
  p.clusters = Shape::lights;
  p.point_clusters = low(points);
  p.clamp = kUnbounded;
  const Artifact visibility = graph_.add(split("vpl.pilot.visibility", "vpl_visibility", points, 1, kSurfaces,
                                               retained((Shape::lights / 32 + VISIBILITY_COUNTS) * 4, false)),
                                         p, {{"lights", pilot_.queried_lights}, {"points", pilot_.queried_points}});
  VplPilotParameters parameters;
  std::ranges::copy(pilot_.bounds, parameters.bounds);
  StageOutput none = retained(4, false);
  none.counted = true;
  const Artifact measured = graph_.add(solo("vpl.pilot", "vpl_pilot", 1, none), parameters,
                                       {{"lights", pilot_.lights},
                                        {"points", pilot_.points},
                                        {"queried_lights", pilot_.queried_lights},
                                        {"queried_points", pilot_.queried_points},
                                        {"visibility", visibility},
                                        {"paths.0", pilot_paths(0)},
                                        {"paths.1", pilot_paths(1)}});
  graph_.when({measured}, [this, measured] {
    choose(measured.facts<VplPilotFacts>());
    end_pilot();
  });
}

// Camera paths beside VPLs of the pilot's least (0) or highest (1) bound.
Artifact VplPlan::pilot_paths(std::uint32_t number) {
  const std::uint64_t count =
      std::min(pixels(), std::clamp(pixels() / kPilotPart, kLeastPilotPixels, kMostPilotPixels));
  std::vector<PathItem> items;
  for (std::uint64_t k = 0; k < count; ++k) {
    const double place =
        (static_cast<double>(k) + scene::unit_hash(k)) * static_cast<double>(pixels()) / static_cast<double>(count);
    const std::uint32_t pixel = low(std::min(pixels() - 1, static_cast<std::uint64_t>(place)));
    for (std::uint32_t chunk = 0; chunk < 2; ++chunk) items.push_back({pixel, chunk});
  }
  PathParameters p{};
  p.camera = settings_.camera;
  p.width = settings_.width;
  p.height = settings_.height;
  p.samples_per_item = p.last_item_samples = Shape::path_samples;
  p.depth = settings_.depth;
  // Other random numbers than the picture's: its own samples must not decide how they are used.
  p.seed_low = low(settings_.seed) ^ 0x70696c6fu;
  p.seed_high = high(settings_.seed);
  p.items_low = static_cast<std::uint32_t>(items.size());
  p.filter = PATH_CLASS_DIFFUSE;
  p.clamp = static_cast<float>(number == 0 ? pilot_.bounds.front() : pilot_.bounds.back());
  return graph_.add(split(numbered("vpl.pilot.path", number), "path", items.size(), 16 / Shape::path_samples,
                          kWholeScene, retained(sizeof(PathRecord) + 12, false)),
                    p, {{"items", graph_.data(items), kOwnItems}});
}

void VplPlan::choose(const VplPilotFacts& facts) {
  const auto drawn = pilot_.lights.facts<VplResampleFacts>();
  const VplPilot pilot(facts, pilot_.bounds);
  VplTarget target;
  target.pixels = static_cast<double>(pixels());
  target.points = points_parameters().items_low;
  target.spp = settings_.method_spp();
  target.error = settings_.target_error;
  target.denoised = settings_.denoise != Denoise::off;
  target.made = low(drawn.made);
  target.samples = vpl_.samples;
  target.usual_point_clusters = vpl_.point_clusters;
  target.count = vpl_.given.count;
  target.clusters = vpl_.given.clusters;
  target.point_clusters = vpl_.given.point_clusters;
  target.passes = vpl_.given.passes;
  target.residual_threshold = vpl_.given.residual_threshold;
  // As many samples or as small an error: the more must points query.
  target.most_residual_threshold = target.error > 0 ? 4 * target.error : vpl_.residual_threshold;
  if (vpl_.given.clamp) target.clamp = *vpl_.given.clamp * drawn.density;
  prediction_ = choose_vpl(pilot, target);
  const VplCounts& counts = prediction_->counts;
  vpl_.count = counts.count;
  vpl_.clusters = counts.clusters;
  vpl_.point_clusters = point_clusters_ = counts.point_clusters;
  vpl_.passes = counts.passes;
  vpl_.residual_threshold = counts.residual_threshold;
  if (!vpl_.given.random_representative) vpl_.random_representative = counts.passes > 1;
  passes_.resize(counts.passes);
  if (!vpl_.given.clamp) {
    clamp_ = static_cast<float>(pilot_.bounds[counts.bound]);
    begin_paths();
  }
}

// The numbers are chosen, and what waited for them begins.
void VplPlan::end_pilot() {
  const Artifact points = pilot_.points;
  pilot_ = {};
  cluster_lights(0);
  if (vpl_.point_clusters)
    cluster_points(points);
  else
    graph_.announce(points_known_);
}

// --- The film and the report ---

bool VplPlan::conclude(const std::vector<CutStage>& cut) {
  // A first whole pass, and the paths' first samples: less is no picture.
  if (!paths_.begun() || (indirect() && film_.passes() == 0)) return false;
  if (!paths_.conclude(cut, skips_)) return false;
  if (indirect() && film_.passes() < passes_.size())
    skips_.push_back(
        {"passes of virtual point lights", "the time limit ended the frame", passes_.size() - film_.passes()});
  return true;
}

std::vector<Skip> VplPlan::skips() const {
  std::vector<Skip> skips = skips_;
  if (faced_away_) skips.push_back({"visibility queries", "the clusters face away from each other", faced_away_});
  if (negligible_) skips.push_back({"visibility queries", "the light could contribute next to nothing", negligible_});
  if (!indirect()) skips.push_back({"virtual point lights", "a depth of 1 is direct light alone", 1});
  if (indirect() && !vpl_.point_clusters)
    skips.push_back({"point clusters", "vpl.point_clusters is 0: every point queries all lights itself", 1});
  if (indirect() && !vpl_.clusters)
    skips.push_back({"VPL clusters", "vpl.clusters is 0: every VPL is its own cluster", 1});
  return skips;
}

nlohmann::json json_of(const VplPrediction& f) {
  const auto error = [&](double square) { return f.mean > 0 ? std::sqrt(square) / f.mean : 0.0; };
  return {{"error", error(f.vpl())},
          {"error_of_lights", error(f.lights)},
          {"error_of_clusters", error(f.clusters)},
          {"error_of_point_clusters", error(f.points)},
          {"error_of_paths", error(f.paths)},
          {"mean", f.mean},
          {"mean_of_lights", f.vpl_mean}};
}

std::string VplPlan::parameters_json() const {
  nlohmann::json vpl = {{"count", vpl_.count},
                        {"clusters", vpl_.clusters},
                        {"point_clusters", vpl_.point_clusters},
                        {"fuzziness", vpl_.fuzziness},
                        {"equal_weights", vpl_.equal_weights},
                        {"compensate", vpl_.compensate},
                        {"residual_threshold", vpl_.residual_threshold},
                        {"contribution_cutoff", vpl_.contribution_cutoff},
                        {"random_representative", vpl_.random_representative},
                        {"samples", vpl_.samples},
                        {"passes", vpl_.passes},
                        {"visibility_pairs", queried_}};
  if (std::isfinite(clamp_)) vpl["clamp_per_square_metre"] = clamp_;
  std::vector<std::uint32_t> made, kept, clusters;
  for (const Pass& s : passes_) {
    made.push_back(s.made);
    kept.push_back(s.kept);
    clusters.push_back(s.clusters);
  }
  vpl["made"] = made;
  vpl["kept"] = kept;
  vpl["light_clusters"] = clusters;
  if (prediction_) vpl["pilot"] = json_of(*prediction_);
  if (merged_points_)
    vpl["trajectory"] = {
        {"cameras", settings_.trajectory.size()}, {"points", merged_points_}, {"point_clusters", point_clusters_}};
  nlohmann::json json = paths_.begun() ? paths_.parameters() : nlohmann::json::object();
  json["vpl"] = vpl;
  return json.dump();
}

std::vector<std::string> VplPlan::outline() const {
  std::vector<std::string> lines;
  if (indirect()) {
    if (vpl_.piloted)
      lines.push_back(
          "vpl.pilot: estimates from a few points, lights and paths choose the counts below that are not set");
    const std::string each = vpl_.passes > 1 ? ", for each of " + std::to_string(vpl_.passes) + " passes" : "";
    lines.push_back("vpl.trace: " + std::to_string(light_paths_) + " light paths, split" + each);
    lines.push_back("vpl.resample: " + std::to_string(vpl_.count) + " VPLs, solo" + each);
    if (vpl_.clusters)
      lines.push_back("vpl.cluster: " + std::to_string(vpl_.clusters) + " clusters of VPLs, solo" + each);
    if (vpl_.point_clusters) {
      const std::string cameras =
          on_trajectory() ? " for each of " + std::to_string(settings_.trajectory.size()) + " cameras of the trajectory"
                          : "";
      const std::string shared = on_trajectory() ? "; made once for all its frames" : "";
      const std::string clusters = std::to_string(vpl_.point_clusters) +
                                   (on_trajectory() ? " to " + std::to_string(most_trajectory_clusters()) : "");
      lines.push_back("vpl.points: " + std::to_string(points_parameters().items_low) + " points to be shaded" +
                      cameras + ", split" + shared);
      lines.push_back("vpl.point_cluster: " + clusters + " clusters of them, solo" + shared);
      lines.push_back("vpl.visibility: " + clusters + " point clusters, each against all of " +
                      (vpl_.clusters ? "the VPL clusters" : "the VPLs") + ", split" + each + shared);
    }
    lines.push_back("vpl.shade: " + std::to_string(pixels()) + " pixels of " + std::to_string(vpl_.samples) +
                    " samples, split" + each);
  }
  for (const std::string& line : paths_.outline()) lines.push_back(line);
  return lines;
}

}  // namespace

Method vpl_method() {
  return {
      .name = "vpl",
      .help =
          "Virtual point lights (VPLs) with fuzzy clusters, explained in docs/explanation/vpl.md. * A pilot chooses "
          "what is not set, for --spp or --target-error, unless vpl.count, vpl.clusters and vpl.point_clusters "
          "are all set.",
      .make = make_plan_of<VplPlan>,
      // Beside the paths: the passes' sum, its squares, the preview and two passes' records, all RGB.
      .bytes_a_pixel = kPathBytesAPixel + 5 * 3 * sizeof(float),
      .check = [](const FrameSettings& settings) { make_vpl_settings(settings); },
      .settings = vpl_setting_rules()};
}

}  // namespace gleaner::coordinator

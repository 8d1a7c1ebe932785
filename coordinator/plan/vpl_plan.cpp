#include "coordinator/plan/vpl_plan.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <limits>
#include <nlohmann/json.hpp>

#include "coordinator/blobs/sha256.h"
#include "kernels/cluster_records.h"
#include "kernels/path_records.h"
#include "kernels/vpl_records.h"
#include "scene/model/error.h"
#include "scene/model/order.h"

namespace gleaner::coordinator {
namespace {

using kernels::ClusterParameters;
using kernels::VisibilityParameters;
using kernels::VplPointParameters;
using kernels::VplTraceParameters;

constexpr std::uint32_t kIterations = 6;
// Points looked at for each point cluster (the paper's down-sampling).
constexpr std::uint64_t kPointsPerCluster = 8;
constexpr std::uint32_t kMostPaths = 1u << 16;
// Of a way's cameras together, so that their records stay well within what a coordinator keeps (64 MiB), and are soon
// merged; but of no camera less than a few points a cluster.
constexpr std::uint64_t kMostWayPoints = 1u << 20;
constexpr std::uint64_t kFewPointsPerCluster = 4;
// Where these are more than so many (256 MiB), fewer cameras stand for the way.
constexpr std::uint64_t kWayPointsLimit = 4 * kMostWayPoints;
// How many times a single camera's point clusters a way may have, and how much all sets' visibility may then take.
constexpr std::uint64_t kMostGrowth = 16;
constexpr std::uint64_t kMostPointClusters = std::uint64_t{1} << 22;  // as of vpl.point_clusters
constexpr std::uint64_t kMostVisibilityBytes = std::uint64_t{128} << 20;
// The pilot's bounds of the geometry term, in units of the VPLs' density at their usual number: on the Cornell boxes
// and on sponza, at the usual counts, the least error lies between them.
constexpr std::array<double, 4> kPilotBounds = {0.0125, 0.025, 0.05, 0.1};
// Camera paths of the pilot: two chunks of so many samples in a part of the pixels.
constexpr std::uint32_t kPilotSamples = 4;
constexpr std::uint64_t kPilotPart = 256, kLeastPilotPixels = 256, kMostPilotPixels = 1024;
// Samples go where the noise is, so that its square falls with that of the mean deviation, not with the mean of
// squares, which hangs on a few pixels at lamps' edges. Fitted on the scenes of `bench/vpl pilot` (3.2 to 4.3;
// white-room, whose lobes are noisy far out, 40).
constexpr double kNoiseFitted = 3.6;
// Lights' stages wait for each other, the paths for nothing: these fill what those leave free.
constexpr int kFirst = 1;

template <typename Parameters>
Parameters parameters_of(const Bytes& bytes) {
  Parameters parameters;
  std::memcpy(&parameters, bytes.data(), sizeof parameters);
  return parameters;
}

std::vector<float> floats_of(const Bytes& bytes) {
  std::vector<float> values(bytes.size() / 4);
  std::memcpy(values.data(), bytes.data(), values.size() * 4);
  return values;
}

// All that a light's row says of how bright it is.
void scale_flux(float* row, double by) {
  for (unsigned k = 0; k < 3; ++k) {
    row[VPL_FLUX + k] = static_cast<float>(row[VPL_FLUX + k] * by);
    row[VPL_SENT + k] = static_cast<float>(row[VPL_SENT + k] * by);
  }
}

double luminance(const float* c) { return 0.2126 * c[0] + 0.7152 * c[1] + 0.0722 * c[2]; }

// In [0, 1): the systematic resampling's offset, another one for each set.
double offset_of(std::uint64_t seed, std::uint32_t set) {
  return scene::unit_hash(seed + 0x9e3779b97f4a7c15ull * (set + 1));
}

// Lights a square metre where lights are: from how far a light's nearest neighbour is (0.5 / sqrt(density) in the mean
// for points strewn over a surface), of some of the lights.
double light_density(const std::vector<float>& rows) {
  const std::size_t count = rows.size() / VPL_WORDS;
  if (count < 2) return 0;
  std::vector<double> nearest;
  const std::size_t step = std::max<std::size_t>(1, count / 256);
  for (std::size_t i = 0; i < count; i += step) {
    double best = std::numeric_limits<double>::infinity();
    for (std::size_t j = 0; j < count; ++j) {
      if (i == j) continue;
      double d2 = 0;
      for (unsigned k = 0; k < 3; ++k) {
        const double d = double{rows[i * VPL_WORDS + k]} - rows[j * VPL_WORDS + k];
        d2 += d * d;
      }
      if (d2 > 0) best = std::min(best, d2);
    }
    if (std::isfinite(best)) nearest.push_back(best);
  }
  if (nearest.empty()) return 0;
  std::ranges::nth_element(nearest, nearest.begin() + static_cast<std::ptrdiff_t>(nearest.size() / 2));
  // The median of pi rho r^2 is log 2.
  return std::log(2.0) / (3.14159265358979 * nearest[nearest.size() / 2]);
}

ClusterParameters cluster_parameters(std::uint32_t clusters) {
  ClusterParameters p{};
  p.clusters = clusters;
  p.iterations = kIterations;
  p.least_cosine = CLUSTER_LEAST_COSINE;
  return p;
}

std::uint32_t set_of(const std::string& name) {
  return static_cast<std::uint32_t>(std::stoul(name.substr(name.rfind('.') + 1)));
}

}  // namespace

VplPlan::Table VplPlan::table_of(std::shared_ptr<const Bytes> bytes) {
  const ArtifactId id = sha256_hex(*bytes);
  return {id, std::move(bytes)};
}

VplPlan::VplPlan(const FrameSettings& settings, const SceneSummary& scene)
    : settings_(settings),
      scene_(scene),
      vpl_(make_vpl_settings(settings)),
      light_paths_(std::clamp(vpl_.count, 1024u, kMostPaths)),
      sets_(vpl_.passes) {
  const std::uint64_t cameras = std::max<std::uint64_t>(2, kWayPointsLimit / std::min(pixels(), points_of_a_camera()));
  if (settings_.way.size() > cameras) settings_.way = way_of(settings_.way, cameras);
  seen_.resize(settings_.way.size());
  point_clusters_ = vpl_.point_clusters;
  sum_.assign(pixels() * 3, 0.0f);
  preview_.assign(pixels() * 3, 0.0f);
  if (vpl_.passes > 1) square_.assign(pixels() * 3, 0.0f);
}

StageSpec VplPlan::trace(std::uint32_t set) const {
  VplTraceParameters p{};
  // Several times the VPLs that are kept: which they are is then decided by what they carry.
  p.items_low = light_paths_;
  p.depth = settings_.depth ? settings_.depth - 1 : 0;
  p.pass = set;
  p.seed_low = static_cast<std::uint32_t>(settings_.seed);
  p.seed_high = static_cast<std::uint32_t>(settings_.seed >> 32);
  StageSpec spec;
  spec.name = "vpl.trace." + std::to_string(set);
  spec.kind = "vpl_trace";
  spec.priority = kFirst;
  spec.items = p.items_low;
  spec.tile = 16;
  spec.parameters = bytes_of(p);
  spec.output.record_bytes = VPL_PATH_SLOTS * VPL_WORDS * 4;
  spec.output.reusable = true;  // another camera sees the same lights
  return spec;
}

namespace {

VplPointParameters point_parameters(const FrameSettings& settings, const VplSettings& vpl) {
  VplPointParameters p{};
  p.camera = settings.camera;
  p.width = settings.width;
  p.height = settings.height;
  p.samples = vpl.samples;
  p.seed_low = static_cast<std::uint32_t>(settings.seed);
  p.seed_high = static_cast<std::uint32_t>(settings.seed >> 32);
  p.depth = settings.depth;
  p.stride = 1;
  p.clamp = std::numeric_limits<float>::infinity();
  return p;
}

}  // namespace

// How many points are wanted of one camera.
std::uint64_t VplPlan::points_of_a_camera() const {
  const std::uint64_t clusters = vpl_.point_clusters, cameras = std::max<std::size_t>(1, settings_.way.size());
  const std::uint64_t most = std::max(kMostWayPoints / cameras, kFewPointsPerCluster * clusters);
  return std::max<std::uint64_t>(
      1, settings_.way.empty() ? kPointsPerCluster * clusters : std::min(kPointsPerCluster * clusters, most));
}

// How many point clusters a way may have.
std::uint64_t VplPlan::most_way_clusters() const {
  const std::uint64_t lights = std::uint64_t{vpl_.passes} * (vpl_.clusters ? vpl_.clusters : vpl_.count);
  const std::uint64_t most =
      std::min({kMostGrowth * vpl_.point_clusters, kMostVisibilityBytes * 8 / lights, kMostPointClusters});
  return std::max<std::uint64_t>(most, vpl_.point_clusters);
}

StageSpec VplPlan::points() const {
  VplPointParameters p = point_parameters(settings_, vpl_);
  // A pilot needs some even where every point asks for itself.
  const std::uint64_t wanted = vpl_.piloted && !vpl_.point_clusters ? VplPilot::kMeanPoints : points_of_a_camera();
  p.stride = static_cast<std::uint32_t>(std::max<std::uint64_t>(1, pixels() / wanted));
  // Neither even nor a divisor of the width: points in columns would leave the rest of the picture unseen.
  if (p.stride > 1) {
    p.stride |= 1;
    while (settings_.width % p.stride == 0) p.stride += 2;
  }
  p.items_low = static_cast<std::uint32_t>((pixels() + p.stride - 1) / p.stride);
  StageSpec spec;
  spec.name = "vpl.points";
  spec.kind = "vpl_points";
  spec.priority = kFirst;
  spec.items = p.items_low;
  spec.tile = 16;
  spec.parameters = bytes_of(p);
  spec.output.record_bytes = POINT_WORDS * 4;
  return spec;
}

// Of the way's camera of that number: nothing in it tells which frame asks.
StageSpec VplPlan::way_points(std::size_t camera) const {
  StageSpec spec = points();
  auto p = parameters_of<VplPointParameters>(spec.parameters);
  p.camera = settings_.way[camera];
  spec.name += '.';
  spec.name += std::to_string(camera);
  spec.parameters = bytes_of(p);
  spec.output.reusable = true;
  return spec;
}

VplPlan::Made VplPlan::made_of(const Bytes& records) {
  const std::size_t stride = VPL_WORDS * 4;
  const double paths = static_cast<double>(records.size() / (stride * VPL_PATH_SLOTS));
  Made made;
  for (std::size_t at = 0; at < records.size(); at += stride) {
    std::array<float, VPL_WORDS> row;
    std::memcpy(row.data(), records.data() + at, stride);
    scale_flux(row.data(), 1 / paths);
    const double sum = double{row[VPL_FLUX]} + row[VPL_FLUX + 1] + row[VPL_FLUX + 2];
    if (!(sum > 0)) continue;
    made.weight.push_back(std::max(luminance(&row[VPL_FLUX]), 1e-3 * sum));
    made.total += made.weight.back();
    made.rows.insert(made.rows.end(), row.begin(), row.end());
  }
  return made;
}

// The light paths' VPLs, drawn again in equal parts: a VPL of little flux costs as much as a bright one, and its chance
// to stay is its flux (systematic resampling; the mean picture is the same).
std::vector<float> VplPlan::draw_lights(std::uint32_t set, const Made& made) const {
  if (made.weight.size() <= vpl_.count) return made.rows;
  std::vector<float> rows;
  const double part = made.total / vpl_.count;
  double aim = part * offset_of(settings_.seed, set), sum = 0;
  for (std::size_t i = 0; i < made.weight.size(); ++i) {
    sum += made.weight[i];
    std::uint32_t times = 0;
    while (aim < sum) {
      ++times;
      aim += part;
    }
    if (!times) continue;
    const std::size_t at = rows.size();
    rows.insert(rows.end(), made.rows.begin() + static_cast<std::ptrdiff_t>(i * VPL_WORDS),
                made.rows.begin() + static_cast<std::ptrdiff_t>((i + 1) * VPL_WORDS));
    scale_flux(&rows[at], times * part / made.weight[i]);
  }
  return rows;
}

void VplPlan::absorb_lights(std::uint32_t set, const Bytes& records, Step& step) {
  Made made = made_of(records);
  sets_[set].made = static_cast<std::uint32_t>(made.weight.size());
  if (set == 0 && vpl_.piloted) {
    made_ = std::move(made);
    if (point_records_) begin_pilot(step);
    return;
  }
  take_lights(set, draw_lights(set, made), step);
}

void VplPlan::take_lights(std::uint32_t set, std::vector<float> rows, Step& step) {
  Set& s = sets_[set];
  s.kept = static_cast<std::uint32_t>(rows.size() / VPL_WORDS);
  // What was piloted has its bound.
  if (set == 0 && !paths_) density_ = light_density(rows);
  if (vpl_.clusters == 0 || vpl_.clusters >= s.kept) {
    settle_lights(set, std::move(rows), {}, step);
    return;
  }
  ClusterParameters p = cluster_parameters(vpl_.clusters);
  p.random_representative =
      vpl_.random_representative ? static_cast<std::uint32_t>(settings_.seed) * 4096 + set + 1 : 0;
  p.lights = s.kept;
  StageSpec spec = cluster(step, "lights", table_of(bytes_of(rows)), p);
  spec.name = "vpl.cluster." + std::to_string(set);
  spec.kind = "vpl_cluster";
  spec.items = p.clusters + (p.lights + VPL_WORDS - 1) / VPL_WORDS;
  spec.output.record_bytes = VPL_WORDS * 4;
  spec.output.reusable = true;
  step.stages.push_back(std::move(spec));
  s.vpls = std::move(rows);
}

// Of set 0's lights and of the points there are: what a few of them tell of the numbers to take.
void VplPlan::begin_pilot(Step& step) {
  const std::vector<float> lights = draw_lights(0, *made_);
  density_ = light_density(lights);
  std::vector<double> bounds;
  for (const double bound : kPilotBounds) bounds.push_back(bound * density_);
  if (density_ > 0) pilot_ = std::make_unique<VplPilot>(lights, floats_of(*point_records_), bounds);
  if (!pilot_ || pilot_->empty()) {
    // No light, or nothing that it falls on: what is there is soon done with the usual numbers.
    pilot_.reset();
    end_pilot(step);
    return;
  }
  VisibilityParameters p{};
  p.clusters = VplPilot::kLights;
  p.point_clusters = static_cast<std::uint32_t>(pilot_->asked_points().size() / POINT_WORDS);
  p.clamp = std::numeric_limits<float>::infinity();
  const Table asked_lights = table_of(bytes_of(pilot_->asked_lights())),
              asked_points = table_of(bytes_of(pilot_->asked_points()));
  StageSpec spec;
  spec.name = "vpl.pilot.visibility";
  spec.kind = "vpl_visibility";
  spec.priority = kFirst;
  spec.items = p.point_clusters;
  spec.parameters = bytes_of(p);
  spec.inputs = {{"lights", asked_lights.id}, {"points", asked_points.id}};
  spec.output.record_bytes = (p.clusters / 32 + VISIBILITY_COUNTS) * 4;
  put(step, asked_lights);
  put(step, asked_points);
  step.stages.push_back(std::move(spec));
  path_pilots_.resize(2);
  for (std::uint32_t k = 0; k < 2; ++k) step.stages.push_back(path_pilot(k, step));
  pilots_left_ = 3;
}

// Camera paths beside VPLs of the pilot's least (0) or highest (1) bound.
StageSpec VplPlan::path_pilot(std::uint32_t number, Step& step) const {
  const std::uint64_t count =
      std::min(pixels(), std::clamp(pixels() / kPilotPart, kLeastPilotPixels, kMostPilotPixels));
  auto list = std::make_shared<Bytes>(count * 2 * sizeof(kernels::PathItem));
  auto* item = reinterpret_cast<kernels::PathItem*>(list->data());
  for (std::uint64_t k = 0; k < count; ++k) {
    const double place =
        (static_cast<double>(k) + scene::unit_hash(k)) * static_cast<double>(pixels()) / static_cast<double>(count);
    const auto pixel = static_cast<std::uint32_t>(std::min(pixels() - 1, static_cast<std::uint64_t>(place)));
    for (std::uint32_t chunk = 0; chunk < 2; ++chunk) *item++ = {pixel, chunk};
  }
  kernels::PathParameters p{};
  p.camera = settings_.camera;
  p.width = settings_.width;
  p.height = settings_.height;
  p.samples_per_item = p.last_item_samples = kPilotSamples;
  p.depth = settings_.depth;
  // Other numbers than the picture's own: its samples are not to decide what is done with them.
  p.seed_low = static_cast<std::uint32_t>(settings_.seed) ^ 0x70696c6fu;
  p.seed_high = static_cast<std::uint32_t>(settings_.seed >> 32);
  p.items_low = static_cast<std::uint32_t>(count * 2);
  p.filter = PATH_CLASS_DIFFUSE;
  p.clamp = static_cast<float>(number == 0 ? pilot_->bounds().front() : pilot_->bounds().back());
  const Table items = table_of(std::move(list));
  StageSpec spec;
  spec.name = "vpl.pilot.path." + std::to_string(number);
  spec.kind = "path";
  spec.priority = kFirst;
  spec.items = p.items_low;
  spec.tile = 16 / kPilotSamples;
  spec.parameters = bytes_of(p);
  spec.inputs = {{"items", items.id}};
  spec.output.record_bytes = sizeof(kernels::PathRecord) + 12;
  put(step, items);
  return spec;
}

void VplPlan::absorb_path_pilot(std::uint32_t number, const Bytes& records) {
  const std::size_t stride = sizeof(kernels::PathRecord) + 12;
  PathForecast& forecast = path_pilots_.at(number);
  const double pairs = static_cast<double>(records.size() / (2 * stride));
  double deviation = 0;
  for (std::size_t at = 0; at + 2 * stride <= records.size(); at += 2 * stride) {
    kernels::PathRecord one, other;
    std::memcpy(&one, records.data() + at, sizeof one);
    std::memcpy(&other, records.data() + at + stride, sizeof other);
    for (unsigned k = 0; k < 3; ++k) {
      const double a = double{one.direct[k]} + one.indirect[k], b = double{other.direct[k]} + other.indirect[k];
      forecast.mean += (a + b) / (2 * kPilotSamples * 3 * pairs);
      deviation += std::abs(a - b) / (3 * pairs);
    }
  }
  // Two sums of n samples, of deviation s each, differ by 2 s sqrt(n / pi) on average.
  forecast.variance = kNoiseFitted * deviation * deviation * 3.14159265358979 / (4 * kPilotSamples);
}

// The numbers are chosen, and what waited for them begins.
void VplPlan::end_pilot(Step& step) {
  if (pilot_) {
    VplWish wish;
    wish.pixels = static_cast<double>(pixels());
    wish.points = static_cast<double>(point_records_->size() / (POINT_WORDS * 4));
    wish.spp = settings_.spp;
    wish.target = settings_.target_error;
    wish.made = sets_[0].made;
    wish.samples = vpl_.samples;
    wish.usual_point_clusters = vpl_.point_clusters;
    wish.count = vpl_.given.count;
    wish.clusters = vpl_.given.clusters;
    wish.point_clusters = vpl_.given.point_clusters;
    wish.sets = vpl_.given.passes;
    wish.doubt = vpl_.given.residual_threshold;
    // As many samples or as small an error: the more must points ask.
    wish.most_doubt = wish.target > 0 ? 4 * wish.target : vpl_.residual_threshold;
    if (vpl_.given.clamp) wish.clamp = *vpl_.given.clamp * density_;
    // Between the bounds, as a power of them.
    const PathForecast &low = path_pilots_[0], &high = path_pilots_[1];
    const std::vector<double>& bounds = pilot_->bounds();
    std::vector<PathForecast> paths;
    for (const double bound : bounds) {
      const double t = std::log(bound / bounds.front()) / std::log(bounds.back() / bounds.front());
      const auto blend = [&](double a, double b) { return a > 0 && b > 0 ? a * std::pow(b / a, t) : a + t * (b - a); };
      paths.push_back({blend(low.variance, high.variance), blend(low.mean, high.mean)});
    }
    forecast_ = choose_vpl(*pilot_, paths, wish);
    const VplCounts& counts = forecast_->counts;
    vpl_.count = counts.count;
    vpl_.clusters = counts.clusters;
    vpl_.point_clusters = point_clusters_ = counts.point_clusters;
    vpl_.passes = counts.sets;
    vpl_.residual_threshold = counts.doubt;
    if (!vpl_.given.random_representative) vpl_.random_representative = counts.sets > 1;
    sets_.resize(counts.sets);
    if (counts.sets > 1)
      square_.assign(pixels() * 3, 0.0f);
    else
      square_.clear();
    if (!vpl_.given.clamp) {
      clamp_ = static_cast<float>(bounds[counts.bound]);
      begin_paths(step);
    }
  }
  take_lights(0, draw_lights(0, *made_), step);
  made_.reset();
  const auto records = std::move(point_records_);
  if (vpl_.point_clusters) {
    absorb_points(records, step);
  } else {
    points_ready_ = true;
    if (sets_[0].traced && !sets_[0].shading) ask_visibility(0, step);
  }
}

// Clusters of the rows of `table`, which the stage knows as `input`.
StageSpec VplPlan::cluster(Step& step, const char* input, const Table& table, const ClusterParameters& p) const {
  StageSpec spec;
  spec.priority = kFirst;
  spec.items = p.clusters;
  spec.solo = true;
  spec.parameters = bytes_of(p);
  spec.inputs.push_back({input, table.id});
  put(step, table);
  return spec;
}

void VplPlan::absorb_light_clusters(std::uint32_t set, const Bytes& records, Step& step) {
  Set& s = sets_[set];
  const std::vector<float> rows = floats_of(records);
  std::vector<float> held;
  std::vector<std::uint32_t> place(vpl_.clusters, 0);
  for (std::uint32_t k = 0; k < vpl_.clusters; ++k) {
    const std::size_t at = std::size_t{k} * VPL_WORDS;
    if (!(rows[at + VPL_COUNT] > 0)) continue;
    place[k] = static_cast<std::uint32_t>(held.size() / VPL_WORDS);
    held.insert(held.end(), rows.begin() + static_cast<std::ptrdiff_t>(at),
                rows.begin() + static_cast<std::ptrdiff_t>(at + VPL_WORDS));
  }
  std::vector<std::vector<std::uint32_t>> members(held.size() / VPL_WORDS);
  for (std::uint32_t i = 0; i < s.kept; ++i) {
    std::uint32_t cluster = 0;
    std::memcpy(&cluster, &rows[std::size_t{vpl_.clusters} * VPL_WORDS + i], 4);
    if (cluster >= vpl_.clusters) throw Error::failed("plan vpl: a light is in no cluster");
    members[place[cluster]].push_back(i);
  }
  settle_lights(set, std::move(held), members, step);
}

// The order in which lights are asked: neighbours together, so that a packet of rays goes one way, and dealt out to the
// slices in turn, so that each slice is lit from everywhere. `members`: rows of Set::vpls, for each light; or nothing.
void VplPlan::settle_lights(std::uint32_t set, std::vector<float> rows,
                            const std::vector<std::vector<std::uint32_t>>& members, Step& step) {
  Set& s = sets_[set];
  const std::size_t count = rows.size() / VPL_WORDS;
  s.clusters = static_cast<std::uint32_t>(count);
  std::array<double, 3> lower{1e300, 1e300, 1e300}, upper{-1e300, -1e300, -1e300};
  for (std::size_t i = 0; i < count; ++i)
    for (unsigned k = 0; k < 3; ++k) {
      lower[k] = std::min(lower[k], double{rows[i * VPL_WORDS + k]});
      upper[k] = std::max(upper[k], double{rows[i * VPL_WORDS + k]});
    }
  double edge = 1e-30;
  for (unsigned k = 0; k < 3; ++k) edge = std::max(edge, upper[k] - lower[k]);
  std::vector<std::pair<std::uint32_t, std::uint32_t>> order(count);
  for (std::size_t i = 0; i < count; ++i) {
    std::array<std::uint32_t, 3> cell{};
    for (unsigned k = 0; k < 3; ++k)
      cell[k] = static_cast<std::uint32_t>(std::min(1023.0, (rows[i * VPL_WORDS + k] - lower[k]) / edge * 1023));
    order[i] = {scene::morton(cell), static_cast<std::uint32_t>(i)};
  }
  std::sort(order.begin(), order.end());
  const std::uint32_t slices = vpl_.samples;
  const auto width =
      static_cast<std::uint32_t>(std::max<std::size_t>(1, ((count + slices - 1) / slices + 31) / 32) * 32);
  s.rows = width * slices;
  std::vector<float> table(std::size_t{s.rows} * VPL_WORDS, 0.0f);
  std::vector<float> held;
  for (std::size_t i = 0; i < count; ++i) {
    const auto row = static_cast<std::uint32_t>((i % slices) * width + i / slices);
    float* light = &table[std::size_t{row} * VPL_WORDS];
    std::copy_n(&rows[order[i].second * VPL_WORDS], VPL_WORDS, light);
    if (!(light[VPL_RADIUS] > 0)) continue;
    const auto first = static_cast<std::uint32_t>(s.rows + held.size() / VPL_WORDS);
    std::memcpy(light + VPL_FIRST, &first, 4);
    for (const std::uint32_t member : members[order[i].second]) {
      const float* vpl = &s.vpls[std::size_t{member} * VPL_WORDS];
      held.insert(held.end(), vpl, vpl + VPL_WORDS);
      std::memcpy(&held[held.size() - VPL_WORDS + VPL_FIRST], &row, 4);
    }
  }
  s.vpls.clear();
  s.lights = table_of(bytes_of(table));
  s.members = table_of(bytes_of(held));
  s.traced = true;
  if (set == 0 && !paths_) {
    // Where the bound is that many times the lights' density, a light's own spot is that many times as bright as the
    // light of all its neighbours together: free of the scene's scale.
    clamp_ = vpl_.clamp > 0 && density_ > 0 ? static_cast<float>(vpl_.clamp * density_)
                                            : std::numeric_limits<float>::infinity();
    begin_paths(step);
  }
  if (count == 0) {
    // Nothing to be lit by: the paths alone make the picture.
    s.shading = true;
    ++shaded_sets_;
    skips_.push_back({"visibility and shading of set " + std::to_string(set), "no light reached a diffuse surface", 1});
    begin_set(set + 1, step);
    return;
  }
  if (points_ready_) ask_visibility(set, step);
}

void VplPlan::begin_set(std::uint32_t set, Step& step) const {
  if (set < sets_.size()) step.stages.push_back(trace(set));
}

// What the paths ask for becomes a part of the step; returns whether they are done.
bool VplPlan::take(Step paths, Step& step) {
  for (StageSpec& spec : paths.stages) step.stages.push_back(std::move(spec));
  step.artifacts.merge(paths.artifacts);
  step.released.insert(step.released.end(), paths.released.begin(), paths.released.end());
  return paths.done;
}

void VplPlan::begin_paths(Step& step) {
  paths_ = std::make_unique<PathPlan>(
      settings_, scene_,
      PathSampler::Complement{indirect(), vpl_.compensate ? clamp_ : std::numeric_limits<float>::infinity(),
                              forecast_ ? forecast_->vpl_mean : 0, forecast_ ? kVplCaution * forecast_->vpl() : 0});
  take(paths_->next(nullptr), step);
}

void VplPlan::absorb_points(std::shared_ptr<const Bytes> records, Step& step) {
  const std::size_t stride = POINT_WORDS * 4, rows = records->size() / stride,
                    wanted = kPointsPerCluster * std::uint64_t{point_clusters_};
  if (vpl_.piloted && wanted < rows) {
    // More were looked at than so few clusters need: one of each part of them, by lot.
    auto some = std::make_shared<Bytes>(wanted * stride);
    for (std::size_t k = 0; k < wanted; ++k) {
      const double place =
          (static_cast<double>(k) + scene::unit_hash(k)) * static_cast<double>(rows) / static_cast<double>(wanted);
      const std::size_t at = std::min(rows - 1, static_cast<std::size_t>(place));
      std::memcpy(some->data() + k * stride, records->data() + at * stride, stride);
    }
    records = std::move(some);
  }
  StageSpec spec = cluster(step, "points", table_of(std::move(records)), cluster_parameters(point_clusters_));
  spec.name = "vpl.point_cluster";
  spec.kind = "point_cluster";
  spec.output.record_bytes = POINT_WORDS * 4;
  spec.output.reusable = !settings_.way.empty();
  step.stages.push_back(std::move(spec));
}

void VplPlan::absorb_way_points(std::size_t camera, std::shared_ptr<const Bytes> records, Step& step) {
  if (camera >= seen_.size() || seen_[camera].rows)
    throw Error::failed("plan vpl: vpl.points." + std::to_string(camera) + " was not asked for");
  seen_[camera] = {settings_.way[camera], std::move(records)};
  if (++seen_cameras_ < seen_.size()) return;
  WayPoints merged = merge_points(seen_);
  seen_.clear();
  merged_points_ = merged.points;
  if (merged.points == 0) {
    absorb_point_clusters({}, step);
    return;
  }
  // As many points a cluster as of the camera that sees most.
  const std::uint64_t most = std::max<std::uint64_t>(1, merged.most_of_a_camera);
  const auto grown = static_cast<std::uint64_t>(std::llround(
      static_cast<double>(vpl_.point_clusters) * static_cast<double>(merged.points) / static_cast<double>(most)));
  point_clusters_ =
      static_cast<std::uint32_t>(std::clamp<std::uint64_t>(grown, vpl_.point_clusters, most_way_clusters()));
  absorb_points(std::make_shared<const Bytes>(std::move(merged.rows)), step);
}

void VplPlan::absorb_point_clusters(const Bytes& records, Step& step) {
  auto held = std::make_shared<Bytes>();
  for (std::size_t at = 0; at < records.size(); at += POINT_WORDS * 4) {
    std::uint32_t triangle = 0;
    std::memcpy(&triangle, records.data() + at + POINT_TRIANGLE * 4, 4);
    if (triangle != GLEANER_NONE)
      held->insert(held->end(), records.begin() + static_cast<std::ptrdiff_t>(at),
                   records.begin() + static_cast<std::ptrdiff_t>(at + POINT_WORDS * 4));
  }
  point_rows_ = static_cast<std::uint32_t>(held->size() / (POINT_WORDS * 4));
  points_ = table_of(std::move(held));
  points_ready_ = true;
  for (std::uint32_t set = 0; set < sets_.size(); ++set)
    if (sets_[set].traced && !sets_[set].shading) ask_visibility(set, step);
}

void VplPlan::ask_visibility(std::uint32_t set, Step& step) {
  Set& s = sets_[set];
  s.shading = true;
  if (point_rows_ == 0) {
    shade(set, step);
    return;
  }
  VisibilityParameters p{};
  p.clusters = s.rows;
  p.point_clusters = point_rows_;
  p.clamp = clamp_;
  p.cutoff = static_cast<float>(vpl_.contribution_cutoff);
  StageSpec spec;
  spec.name = "vpl.visibility." + std::to_string(set);
  spec.kind = "vpl_visibility";
  spec.priority = kFirst;
  spec.items = point_rows_;
  spec.parameters = bytes_of(p);
  spec.inputs = {{"lights", s.lights.id}, {"points", points_.id}};
  spec.output.record_bytes = (s.rows / 32 + VISIBILITY_COUNTS) * 4;
  spec.output.reusable = !settings_.way.empty();
  put(step, s.lights);
  put(step, points_);
  step.stages.push_back(std::move(spec));
}

void VplPlan::shade(std::uint32_t set, Step& step) {
  Set& s = sets_[set];
  VplPointParameters p = point_parameters(settings_, vpl_);
  p.pass = set;
  p.items_low = static_cast<std::uint32_t>(pixels());
  p.clusters = s.rows;
  p.point_clusters = point_rows_;
  p.fuzziness = vpl_.fuzziness;
  p.equal_weights = vpl_.equal_weights ? 1 : 0;
  p.clamp = clamp_;
  p.residual_threshold = static_cast<float>(vpl_.residual_threshold);
  StageSpec spec;
  spec.name = "vpl.shade." + std::to_string(set);
  spec.kind = "vpl_shade";
  spec.priority = kFirst;
  spec.items = pixels();
  spec.tile = 16;
  spec.parameters = bytes_of(p);
  spec.inputs = {{"lights", s.lights.id}, {"members", s.members.id}};
  put(step, s.lights);
  put(step, s.members);
  if (point_rows_) {
    spec.inputs.push_back({"points", points_.id});
    spec.inputs.push_back({"visibility", s.visibility.id});
    put(step, points_);
    put(step, s.visibility);
  }
  spec.output.record_bytes = 12;
  step.stages.push_back(std::move(spec));
  begin_set(set + 1, step);
}

void VplPlan::absorb_shade(std::uint32_t set, const Bytes& records) {
  for (std::size_t i = 0; i < sum_.size(); ++i) {
    float value = 0;
    std::memcpy(&value, records.data() + i * 4, 4);
    sum_[i] += value;
    if (!square_.empty()) square_[i] += value * value;
  }
  ++shaded_sets_;
  sets_[set].visibility = {};
  sets_[set].lights = {};
  sets_[set].members = {};
}

Step VplPlan::next(const FinishedStage* finished) {
  Step step;
  if (!finished) {
    if (!indirect()) {
      begin_paths(step);
      return step;
    }
    // One set after another, each begun while the one before is shaded: a frame whose time is up has whole sets.
    begin_set(0, step);
    if (!vpl_.point_clusters && !vpl_.piloted) {
      points_ready_ = true;
    } else if (settings_.way.empty()) {
      step.stages.push_back(points());
    } else {
      for (std::size_t camera = 0; camera < settings_.way.size(); ++camera) step.stages.push_back(way_points(camera));
    }
    return step;
  }
  const std::string& name = finished->name;
  const auto is = [&](const char* prefix) { return name.starts_with(prefix); };
  if (is("path.")) {
    paths_done_ = take(paths_->next(finished), step);
  } else if (is("vpl.trace.")) {
    absorb_lights(set_of(name), *finished->records, step);
  } else if (is("vpl.cluster.")) {
    absorb_light_clusters(set_of(name), *finished->records, step);
  } else if (name == "vpl.points") {
    if (vpl_.piloted) {
      point_records_ = finished->records;
      if (made_) begin_pilot(step);
    } else {
      absorb_points(finished->records, step);
    }
  } else if (is("vpl.points.")) {
    absorb_way_points(set_of(name), finished->records, step);
  } else if (is("vpl.pilot.")) {
    if (name == "vpl.pilot.visibility")
      pilot_->answer(*finished->records);
    else
      absorb_path_pilot(set_of(name), *finished->records);
    if (--pilots_left_ == 0) end_pilot(step);
  } else if (name == "vpl.point_cluster") {
    absorb_point_clusters(*finished->records, step);
  } else if (is("vpl.visibility.")) {
    Set& s = sets_[set_of(name)];
    const std::size_t row = (s.rows / 32 + VISIBILITY_COUNTS) * 4;
    for (std::size_t at = s.rows / 32 * 4; at < finished->records->size(); at += row) {
      std::uint32_t left_out[VISIBILITY_COUNTS];
      std::memcpy(left_out, finished->records->data() + at, sizeof left_out);
      faced_away_ += left_out[0];
      brought_little_ += left_out[1];
    }
    asked_ += std::uint64_t{point_rows_} * s.clusters;
    s.visibility = table_of(finished->records);
    shade(set_of(name), step);
  } else if (is("vpl.shade.")) {
    absorb_shade(set_of(name), *finished->records);
  } else {
    throw Error::failed("plan vpl: " + name + " was not asked for");
  }
  step.done = paths_done_ && (!indirect() || shaded_sets_ == sets_.size());
  return step;
}

bool VplPlan::conclude(const std::vector<CutStage>& cut) {
  // A first whole set, and the paths' first samples: less is no picture.
  if (!paths_ || (indirect() && shaded_sets_ == 0)) return false;
  if (!paths_done_ && !paths_->conclude(cut)) return false;
  if (shaded_sets_ < sets_.size() && indirect())
    skips_.push_back({"sets of virtual point lights", "the time limit ended the frame", sets_.size() - shaded_sets_});
  return true;
}

void VplPlan::preview(const std::string& stage, std::uint64_t first, std::uint64_t count, const Bytes& records) {
  if (stage.starts_with("path.") && paths_) paths_->preview(stage, first, count, records);
  if (!stage.starts_with("vpl.shade.") || (first + count) * 3 > preview_.size() || records.size() < count * 12) return;
  std::memcpy(&preview_[first * 3], records.data(), count * 12);
}

Film VplPlan::preview_film() const {
  Film film = paths_ ? paths_->preview_film() : Film{settings_.width, settings_.height, {}};
  static const char* const kColor[] = {"R", "G", "B"};
  for (std::size_t k = 0; k < 3; ++k) {
    std::vector<float>& values = film.channel(kColor[k]).values;
    for (std::size_t i = 0; i < values.size(); ++i) values[i] += preview_[3 * i + k];
  }
  return film;
}

// Adds what the sets bring to the paths' film.
Film VplPlan::with_lights(Film film) const {
  if (shaded_sets_ == 0) return film;
  static const char* const kColor[] = {"R", "G", "B"};
  const auto n = static_cast<float>(shaded_sets_);
  for (std::size_t k = 0; k < 3; ++k) {
    std::vector<float>& indirect = film.channel(std::string("indirect.") + kColor[k]).values;
    const std::vector<float>& direct = film.channel(std::string("direct.") + kColor[k]).values;
    std::vector<float>& all = film.channel(kColor[k]).values;
    std::vector<float>& variance = film.channel(std::string("variance.") + kColor[k]).values;
    for (std::size_t i = 0; i < all.size(); ++i) {
      const float sum = sum_[3 * i + k];
      indirect[i] += sum / n;
      all[i] = direct[i] + indirect[i];
      // Between the sets; a single one tells nothing of itself.
      if (shaded_sets_ > 1) variance[i] += std::max(0.0f, square_[3 * i + k] - sum * sum / n) / (n * (n - 1));
    }
  }
  return film;
}

std::vector<Skip> VplPlan::skips() const {
  std::vector<Skip> skips = paths_ ? paths_->skips() : std::vector<Skip>{};
  skips.insert(skips.end(), skips_.begin(), skips_.end());
  if (faced_away_) skips.push_back({"visibility queries", "the clusters face away from each other", faced_away_});
  if (brought_little_)
    skips.push_back({"visibility queries", "the light could bring next to nothing", brought_little_});
  if (!indirect()) skips.push_back({"virtual point lights", "a depth of 1 is direct light alone", 1});
  if (indirect() && !vpl_.point_clusters)
    skips.push_back({"point clusters", "vpl.point_clusters is 0: every point asks for itself", 1});
  if (indirect() && !vpl_.clusters)
    skips.push_back({"VPL clusters", "vpl.clusters is 0: every VPL stands for itself", 1});
  return skips;
}

std::string VplPlan::parameters_json() const {
  nlohmann::json json = paths_ ? nlohmann::json::parse(paths_->parameters_json()) : nlohmann::json::object();
  nlohmann::json vpl = {{"count", vpl_.count},
                        {"clusters", vpl_.clusters},
                        {"point_clusters", vpl_.point_clusters},
                        {"fuzziness", vpl_.fuzziness},
                        {"equal_weights", vpl_.equal_weights},
                        {"compensate", vpl_.compensate},
                        {"residual_threshold", vpl_.residual_threshold},
                        {"contribution_cutoff", vpl_.contribution_cutoff},
                        {"samples", vpl_.samples},
                        {"passes", vpl_.passes},
                        {"visibility_pairs", asked_}};
  if (std::isfinite(clamp_)) vpl["clamp_per_square_metre"] = clamp_;
  std::vector<std::uint32_t> made, kept, clusters;
  for (const Set& s : sets_) {
    made.push_back(s.made);
    kept.push_back(s.kept);
    clusters.push_back(s.clusters);
  }
  if (forecast_) {
    const VplForecast& f = *forecast_;
    const auto error = [&](double square) { return f.mean > 0 ? std::sqrt(square) / f.mean : 0.0; };
    vpl["pilot"] = {{"error", error(f.vpl())},
                    {"error_of_lights", error(f.lights)},
                    {"error_of_clusters", error(f.clusters)},
                    {"error_of_point_clusters", error(f.points)},
                    {"error_of_paths", error(f.paths)},
                    {"mean", f.mean},
                    {"mean_of_lights", f.vpl_mean}};
  }
  vpl["made"] = made;
  vpl["kept"] = kept;
  if (merged_points_)
    vpl["way"] = {{"cameras", settings_.way.size()}, {"points", merged_points_}, {"point_clusters", point_clusters_}};
  vpl["light_clusters"] = clusters;
  json["vpl"] = vpl;
  return json.dump();
}

std::vector<std::string> VplPlan::outline() const {
  std::vector<std::string> lines;
  if (indirect()) {
    if (vpl_.piloted)
      lines.push_back(
          "vpl.pilot: a few points, lights and paths; from what they tell, the counts below are chosen that "
          "are not set");
    const std::string sets = vpl_.passes > 1 ? ", for each of " + std::to_string(vpl_.passes) + " sets" : "";
    lines.push_back("vpl.trace: " + std::to_string(trace(0).items) + " light paths, split" + sets + "; " +
                    std::to_string(vpl_.count) + " VPLs are kept");
    if (vpl_.clusters)
      lines.push_back("vpl.cluster: " + std::to_string(vpl_.clusters) + " clusters of VPLs, solo" + sets);
    if (vpl_.point_clusters) {
      const bool way = !settings_.way.empty();
      const std::string cameras =
          way ? " for each of " + std::to_string(settings_.way.size()) + " cameras of the way" : "";
      const std::string shared = way ? "; made once for all its frames" : "";
      const std::string clusters =
          std::to_string(vpl_.point_clusters) + (way ? " to " + std::to_string(most_way_clusters()) : "");
      lines.push_back("vpl.points: " + std::to_string(points().items) + " points to be shaded" + cameras + ", split" +
                      shared);
      lines.push_back("vpl.point_cluster: " + clusters + " clusters of them, solo" + shared);
      lines.push_back("vpl.visibility: " + clusters + " point clusters, each against all of " +
                      (vpl_.clusters ? "the VPL clusters" : "the VPLs") + ", split" + sets + shared);
    }
    lines.push_back("vpl.shade: " + std::to_string(pixels()) + " pixels of " + std::to_string(vpl_.samples) +
                    " samples, split" + sets);
  }
  for (const std::string& line : PathPlan(settings_, scene_).outline()) lines.push_back(line);
  return lines;
}

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

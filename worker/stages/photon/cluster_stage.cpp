// Stage kinds "photon_cluster" and "photon_extend": shading points in clusters, and the point of each where light is
// gathered (Wang et al. 2009, section 3.2): seeds by geometric variation (seeding.h), k-means by eq. 2
// (kernels/cluster.cl), the member of least error. Solo.

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>

#include "kernels/photon_records.h"
#include "scene/model/error.h"
#include "worker/stages/k_means.h"
#include "worker/stages/photon/nearness.h"
#include "worker/stages/photon/reach_grid.h"
#include "worker/stages/photon/stages.h"
#include "worker/stages/splat/stages.h"
#include "worker/stages/vpl/rows.h"
#include "worker/wavefront/counters.h"

namespace gleaner::worker {
namespace {

using kernels::PhotonClusterFacts;
using kernels::PhotonClusterParameters;

// Eq. 2's alpha, where the box about all points has a diagonal of 1: clusters of flat surfaces grow until they are as
// wide as those of bent ones turn.
constexpr double kAlpha = 3;
// Normals farther apart share no cluster.
constexpr float kLeastCosine = 0.5f;
// k-means looks at a grid of pixels, no more than a cluster needs or so many; the others read the clusters as well.
constexpr std::uint64_t kDataOfACluster = 16, kEnoughData = 1u << 16, kMostData = 1u << 18;
constexpr std::size_t kDatumWords = 8;
// Of clusters beside kept ones, over the edge of a cluster's mean share of the picture.
constexpr float kMostEdges = 2;
// Where every point has a record of its own, its reach in pixels: such a record reaches no other point.
constexpr float kOwnReach = 1e-4f;

void check(const StageRun& run, const PhotonClusterParameters& p) {
  check_splat_points(run, p.width, p.height, p.samples);
  if (p.clusters == 0 || p.iterations > 1000)
    throw Error::bad_input(run.where(), "clusters and iterations", "clusters, at most 1000 iterations",
                           std::to_string(p.clusters) + " and " + std::to_string(p.iterations));
  if (!(p.kept_footprint >= 0) || !std::isfinite(p.kept_footprint))
    throw Error::bad_input(run.where(), "kept_footprint", "0 or more", std::to_string(p.kept_footprint));
  run.check_range(1);
}

// What k-means looks at: the first point of each of the grid's pixels.
struct Data {
  PointScreen screen;
  std::vector<ClusterMember> members;
  std::vector<float> rows;
};

Data data_of(const PhotonClusterParameters& p, std::span<const SplatPoint> points) {
  Data data{.screen = {.width = p.width, .height = p.height, .samples = p.samples}, .members = {}, .rows = {}};
  PointScreen& screen = data.screen;
  const std::uint64_t most = std::clamp(kDataOfACluster * p.clusters, kEnoughData, kMostData);
  while (std::uint64_t{screen.columns()} * screen.rows() > most) screen.step *= 2;
  PointBox box;
  for (std::uint32_t y = 0; y < screen.rows(); ++y)
    for (std::uint32_t x = 0; x < screen.columns(); ++x) {
      const std::size_t first = screen.point_of(x * screen.step, y * screen.step);
      for (std::size_t i = first; i < first + p.samples; ++i) {
        if (!points[i].exists()) continue;
        const auto row = static_cast<std::uint32_t>(data.members.size());
        data.members.push_back({.screen = {x, y, row}, .point = static_cast<std::uint32_t>(i)});
        box.add(points[i].position);
        break;
      }
    }
  double diagonal = 0;
  for (std::size_t k = 0; k < 3 && !box.empty(); ++k) diagonal += std::pow(double{box.upper[k]} - box.lower[k], 2);
  const double alpha = kAlpha / std::max(std::sqrt(diagonal), 1e-30);
  data.rows.reserve(data.members.size() * kDatumWords);
  for (const ClusterMember& member : data.members) {
    const SplatPoint& point = points[member.point];
    for (std::size_t k = 0; k < 3; ++k)
      data.rows.push_back(static_cast<float>(alpha * (double{point.position[k]} - box.lower[k])));
    data.rows.insert(data.rows.end(), point.normal.begin(), point.normal.end());
    data.rows.resize(data.rows.size() + 2);
  }
  return data;
}

// A sample stands for what its cluster had members of: no farther away and turned no more than the one of largest
// error (section 3.2, "Temporal Coherence"), and seen from not much nearer by than its cluster was.
bool stands_for(const ClusterSample& sample, const SplatPoint& point, float kept_footprint) {
  if (sample.at.footprint > kept_footprint * point.footprint) return false;
  const PointOffset off = point_offset(sample.at.position, sample.at.normal, point);
  return !off.hidden && off.distance <= sample.spacing && off.turn <= sample.turn / kOverlap;
}

// Gives members to the samples that exist. Returns the data of the others.
Data classify(const PhotonClusterParameters& p, std::span<const SplatPoint> points,
              std::span<const ClusterSample> given, Data& data) {
  Data others{.screen = data.screen, .members = {}, .rows = {}};
  const ReachGrid grid = grid_of(given);
  for (std::size_t i = 0; i < data.members.size(); ++i) {
    ClusterMember& member = data.members[i];
    const SplatPoint& point = points[member.point];
    float least = std::numeric_limits<float>::infinity();
    grid.near(point.position, [&](std::uint32_t k) {
      if (!stands_for(given[k], point, p.kept_footprint)) return;
      const float error = point_offset(given[k].at.position, given[k].at.normal, point).distance / given[k].spacing;
      if (error > least || (error == least && k >= member.sample)) return;
      least = error;
      member.sample = k;
    });
    if (member.sample != GLEANER_NONE) continue;
    ClusterMember other = member;
    other.screen.row = static_cast<std::uint32_t>(others.members.size());
    others.members.push_back(other);
    const auto row = data.rows.begin() + static_cast<std::ptrdiff_t>(i * kDatumWords);
    others.rows.insert(others.rows.end(), row, row + kDatumWords);
  }
  return others;
}

// The members' clusters, and of each the member of least error as a sample, behind those that exist.
void cluster(const StageRun& run, const PhotonClusterParameters& p, std::uint32_t clusters,
             std::span<const SplatPoint> points, Data& data, std::vector<ClusterSample>& samples) {
  std::vector<ScreenPoint> places;
  places.reserve(data.members.size());
  for (const ClusterMember& member : data.members) places.push_back(member.screen);
  const std::uint64_t key = wide(p.seed_high, p.seed_low);
  const std::vector<std::uint32_t> seeds = seeds_by_variation(data.rows, kDatumWords, places, clusters, key);
  constexpr ClusterMetric metric = ClusterMetric::distance_and_normal;
  KMeans means(run, data.rows, kDatumWords,
               {.clusters = static_cast<std::uint32_t>(seeds.size()),
                .iterations = p.iterations,
                .least_cosine = kLeastCosine,
                .metric = metric});
  const std::vector<std::uint32_t>& assigned = means.run(seeds);
  struct Best {
    double error = std::numeric_limits<double>::infinity();
    std::uint32_t point = GLEANER_NONE;
  };
  std::vector<Best> best(seeds.size());
  for (std::size_t i = 0; i < data.members.size(); ++i) {
    Best& least = best[assigned[i]];
    const double error = cluster_error2(metric, &data.rows[i * kDatumWords], means.centroid(assigned[i]));
    if (error < least.error) least = {error, data.members[i].point};
  }
  // Clusters without members have no sample.
  std::vector<std::uint32_t> sample_of(seeds.size(), GLEANER_NONE);
  for (std::size_t k = 0; k < best.size(); ++k) {
    if (best[k].point == GLEANER_NONE) continue;
    sample_of[k] = static_cast<std::uint32_t>(samples.size());
    samples.push_back({.at = points[best[k].point]});
  }
  for (std::size_t i = 0; i < data.members.size(); ++i) data.members[i].sample = sample_of[assigned[i]];
}

// Samples for what none that exists stands for: as many for a part of the picture as for all of it, in proportion.
void cluster_others(const StageRun& run, const PhotonClusterParameters& p, std::span<const SplatPoint> points,
                    Data& data, std::vector<ClusterSample>& samples) {
  Data others = classify(p, points, samples, data);
  if (others.members.empty()) return;
  const std::uint64_t share = std::uint64_t{p.clusters} * others.members.size() / data.members.size();
  if (others.members.size() == 1) {
    others.members[0].sample = static_cast<std::uint32_t>(samples.size());
    samples.push_back({.at = points[others.members[0].point]});
  } else {
    cluster(run, p, std::max(1u, static_cast<std::uint32_t>(share)), points, others, samples);
  }
  // Both are in the data's order.
  auto from = others.members.begin();
  for (ClusterMember& member : data.members)
    if (member.sample == GLEANER_NONE) member.sample = (from++)->sample;
}

// Clusters are as large where pixels show points as if all pixels did.
PhotonClusterParameters of_their_share(PhotonClusterParameters p, const Data& data) {
  const std::uint64_t pixels = std::uint64_t{data.screen.columns()} * data.screen.rows();
  if (p.whole)
    p.clusters = std::max(1u, static_cast<std::uint32_t>(std::uint64_t{p.clusters} * data.members.size() / pixels));
  return p;
}

// What no kept sample stands for lies here and there, and a new cluster would reach from one place to the next.
float most_pixels(const PhotonClusterParameters& p, const Data& data) {
  return kMostEdges * static_cast<float>(data.screen.step) *
         std::sqrt(static_cast<float>(data.members.size()) / static_cast<float>(p.clusters));
}

void add_every_point(std::span<const SplatPoint> points, std::vector<ClusterSample>& samples) {
  for (const SplatPoint& point : points)
    if (point.exists())
      samples.push_back({.at = point, .reach = kOwnReach * point.footprint, .turn = kOwnReach, .spacing = 0});
}

double median_reach(const std::vector<ClusterSample>& samples) {
  if (samples.empty()) return 0;
  std::vector<float> reaches;
  for (const ClusterSample& sample : samples) reaches.push_back(sample.reach);
  return double{median_of(std::move(reaches))};
}

// `counters` gets the rays.
BatchResult choose_samples(const StageRun& run, const PhotonClusterParameters& all, std::span<const SplatPoint> points,
                           BatchResult& counters) {
  PhotonClusterFacts facts;
  facts.points = static_cast<std::uint64_t>(std::ranges::count_if(points, &SplatPoint::exists));
  std::vector<ClusterSample> samples = read_samples(run.task, "given");
  facts.given = samples.size();
  Data data = data_of(all, points);
  const PhotonClusterParameters p = of_their_share(all, data);
  if (p.clusters >= data.members.size()) {
    add_every_point(points, samples);
  } else {
    cluster_others(run, p, points, data, samples);
    facts.strays = extend_samples(data.screen, points, data.members, samples, facts.given,
                                  facts.given ? most_pixels(p, data) : std::numeric_limits<float>::infinity(),
                                  [&](auto places) { return distances_ahead(run, places, counters); });
  }
  BatchResult result = sample_places(samples);
  facts.places = samples.size();
  facts.reach = median_reach(samples);
  set_facts(result, facts);
  return result;
}

}  // namespace

BatchResult run_photon_cluster_stage(const StageRun& run) {
  const auto p = run.parameters<PhotonClusterParameters>();
  check(run, p);
  const double start = seconds_now();
  BatchResult counters;
  BatchResult result = choose_samples(run, p, read_splat_points(run, p.width, p.height, p.samples), counters);
  result.counters = counters.counters;
  result.counters.seconds = seconds_now() - start;
  result.counters.kernel_seconds = result.counters.seconds;
  return result;
}

BatchResult run_photon_extend_stage(const StageRun& run) {
  const auto p = run.parameters<kernels::PhotonExtendParameters>();
  check(run, p.clusters);
  const double start = seconds_now();
  BatchResult counters;
  const std::vector<SplatPoint> points =
      find_camera_points(run, p.points, p.clusters.width, p.clusters.height, p.clusters.samples, counters);
  BatchResult result = choose_samples(run, p.clusters, points, counters);
  result.counters = counters.counters;
  result.counters.seconds = seconds_now() - start;
  return result;
}

}  // namespace gleaner::worker

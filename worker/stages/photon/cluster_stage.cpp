// Stage kind "photon_cluster": shading points in clusters, and the point of each where light is gathered (Wang et al.
// 2009, section 3.2): seeds by geometric variation (seeding.h), k-means by eq. 2 (kernels/cluster.cl), the member of
// least error. Solo.

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>

#include "kernels/photon_records.h"
#include "scene/model/error.h"
#include "worker/stages/k_means.h"
#include "worker/stages/photon/clusters.h"
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
// Where every point has a record of its own, its reach in pixels: such a record reaches no other point.
constexpr float kOwnReach = 1e-4f;

PhotonClusterParameters read_parameters(const StageRun& run) {
  const auto p = run.parameters<PhotonClusterParameters>();
  check_splat_points(run, p.width, p.height, p.samples);
  if (p.clusters == 0 || p.iterations > 1000)
    throw Error::bad_input(run.where(), "clusters and iterations", "clusters, at most 1000 iterations",
                           std::to_string(p.clusters) + " and " + std::to_string(p.iterations));
  run.check_range(1);
  return p;
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

// The members' clusters, and of each the member of least error.
std::vector<ClusterSample> cluster(const StageRun& run, const PhotonClusterParameters& p, Data& data) {
  std::vector<ScreenPoint> places;
  places.reserve(data.members.size());
  for (const ClusterMember& member : data.members) places.push_back(member.screen);
  const std::uint64_t key = wide(p.seed_high, p.seed_low);
  const std::vector<std::uint32_t> seeds = seeds_by_variation(data.rows, kDatumWords, places, p.clusters, key);
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
  std::vector<ClusterSample> samples;
  std::vector<std::uint32_t> sample_of(seeds.size(), GLEANER_NONE);
  for (std::size_t k = 0; k < best.size(); ++k) {
    if (best[k].point == GLEANER_NONE) continue;
    sample_of[k] = static_cast<std::uint32_t>(samples.size());
    samples.push_back({.point = best[k].point});
  }
  for (std::size_t i = 0; i < data.members.size(); ++i) data.members[i].sample = sample_of[assigned[i]];
  return samples;
}

std::vector<ClusterSample> every_point(std::span<const SplatPoint> points) {
  std::vector<ClusterSample> samples;
  for (std::size_t i = 0; i < points.size(); ++i)
    if (points[i].exists())
      samples.push_back({.point = static_cast<std::uint32_t>(i),
                         .reach = kOwnReach * points[i].footprint,
                         .turn = kOwnReach,
                         .spacing = 0});
  return samples;
}

double median_reach(const std::vector<ClusterSample>& samples) {
  if (samples.empty()) return 0;
  std::vector<float> reaches;
  for (const ClusterSample& sample : samples) reaches.push_back(sample.reach);
  const auto middle = reaches.begin() + static_cast<std::ptrdiff_t>(reaches.size() / 2);
  std::nth_element(reaches.begin(), middle, reaches.end());
  return double{*middle};
}

}  // namespace

BatchResult run_photon_cluster_stage(const StageRun& run) {
  const PhotonClusterParameters p = read_parameters(run);
  const double start = seconds_now();
  const std::vector<SplatPoint> points = read_splat_points(run, p.width, p.height, p.samples);
  PhotonClusterFacts facts;
  facts.points = static_cast<std::uint64_t>(std::ranges::count_if(points, &SplatPoint::exists));
  std::vector<ClusterSample> samples;
  Data data = data_of(p, points);
  if (p.clusters >= data.members.size()) {
    samples = every_point(points);
  } else {
    samples = cluster(run, p, data);
    facts.strays = extend_samples(data.screen, points, data.members, samples);
  }
  BatchResult result = sample_places(samples, points);
  facts.places = samples.size();
  facts.reach = median_reach(samples);
  set_facts(result, facts);
  result.counters.seconds = seconds_now() - start;
  result.counters.kernel_seconds = result.counters.seconds;
  return result;
}

}  // namespace gleaner::worker

// Stage kind "photon_cluster_gather": the light that arrives at the sample points of shading clusters
// (kernels/photon/cluster_gather.cl, lobe_gather.cl).

#include <algorithm>
#include <cmath>
#include <limits>

#include "worker/stages/photon/clusters.h"
#include "worker/stages/photon/gather_thread.h"
#include "worker/stages/photon/stages.h"
#include "worker/stages/splat/radiance.h"
#include "worker/stages/splat/record_gather.h"
#include "worker/stages/splat/stages.h"

namespace gleaner::worker {
namespace {

// What gradients are bounded by: over all of the record's reach they shall not exceed its light by much.
constexpr float kMostOfReach = 100;

// R_j of section 3.4, the harmonic mean of the rays' lengths, m; without bounds, but for rays that all meet nothing.
float mean_distance(std::span<const HemisphereSample> samples) {
  float nearness = std::numeric_limits<float>::min();
  for (const HemisphereSample& sample : samples) nearness += sample.nearness;
  return static_cast<float>(samples.size()) / nearness;
}

// The place with R_j within bounds in the place of how far it reaches.
SplatPoint sized_place(SplatPoint place, float mean) {
  const float reach = place.factor[0];
  place.factor[0] = std::clamp(mean, reach, kMostOfReach * reach);
  return place;
}

// How far the record is read, stage photon_cluster_smooth decides.
CacheRecord cluster_record(const SplatPoint& place, const HemisphereGrid& grid,
                           std::span<const HemisphereSample> samples) {
  const float mean = mean_distance(samples);
  CacheRecord record = cache_record(sized_place(place, mean), grid, samples);
  record.radius = std::min(mean, kMostOfReach * place.factor[0]);
  record.hessian[CLUSTER_NOISE - CACHE_HESSIAN] = record.noise();
  record.spare = {place.factor[0], place.factor[1]};
  return record;
}

// A record of incoming radiance as points read it: no stage smooths these.
void make_lobe_record(const SplatPoint& place, const HemisphereGrid& grid, std::span<const HemisphereSample> samples,
                      std::uint32_t order, std::span<float> record) {
  const float mean = mean_distance(samples);
  make_radiance_record(sized_place(place, mean), grid, samples, order, record);
  const RecordExtent extent = record_extent(mean, place.factor[0], place.factor[1]);
  record[CACHE_RADIUS] = extent.radius;
  record[CACHE_ACCURACY] = extent.accuracy;
}

RecordMaker lobe_record_maker(std::uint32_t order) {
  const std::size_t words = RADIANCE_WORDS(order);
  return {words * 4, sizeof(SplatPoint), [=](const auto& place, const auto& grid, auto samples, std::byte* to) {
            make_lobe_record(place, grid, samples, order, {reinterpret_cast<float*>(to), words});
          }};
}

}  // namespace

BatchResult run_photon_cluster_gather_stage(const StageRun& run) {
  const auto p = run.parameters<kernels::PhotonClusterGatherParameters>();
  check_record_parameters(run, p.records);
  check_photon_gather(run, p.records.samples);
  check_photon_estimate(run, p.estimate);
  const auto map = photon_map_table(run, "map");
  const PhotonCutTable cut = photon_cut_table(run, p.cut_depth);
  const std::string filter = " -D PATH_FILTER=" + std::to_string(p.records.samples.filter);
  if (p.order) check_splat_order(run, p.order);
  return gather_records(
      run, p.records, run.build(p.order ? "lobe_gather.cl" : "cluster_gather.cl", filter),
      [&](const PlaceTable& places, const SamplePart& part, WorkQueue& work, unsigned index) {
        return std::make_unique<RecordThread<PhotonGatherThread>>(places, part, run.workspace, work, index, p.estimate,
                                                                  *map, cut);
      },
      p.order ? lobe_record_maker(p.order) : record_maker<SplatPoint>(cluster_record));
}

}  // namespace gleaner::worker

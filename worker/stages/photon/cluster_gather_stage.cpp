// Stage kind "photon_cluster_gather": the light that arrives at the sample points of shading clusters
// (kernels/photon/cluster_gather.cl).

#include <algorithm>
#include <cmath>
#include <limits>

#include "worker/stages/photon/gather_thread.h"
#include "worker/stages/photon/stages.h"
#include "worker/stages/splat/record_gather.h"

namespace gleaner::worker {
namespace {

// R_j is the harmonic mean of the rays' lengths (section 3.4); where they meet nothing, as far as the record may reach.
// How far it is read, stage photon_cluster_smooth decides.
CacheRecord cluster_record(const SplatPoint& place, const HemisphereGrid& grid,
                           std::span<const HemisphereSample> samples) {
  const float reach = place.factor[0], turn = place.factor[1];
  float nearness = std::numeric_limits<float>::min();  // of rays that all meet nothing
  for (const HemisphereSample& sample : samples) nearness += sample.nearness;
  const float most = 100 * reach, mean = static_cast<float>(samples.size()) / nearness;
  SplatPoint sized = place;
  // Gradients are bounded by the radius: over all of the record's reach they shall not exceed its irradiance by much.
  sized.factor[0] = std::clamp(mean, reach, most);
  CacheRecord record = cache_record(sized, grid, samples);
  record.radius = std::min(mean, most);
  record.spare = {reach, turn};
  return record;
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
  return gather_records(
      run, p.records, run.build("cluster_gather.cl", filter),
      [&](const PlaceTable& places, const SamplePart& part, WorkQueue& work, unsigned index) {
        return std::make_unique<RecordThread<PhotonGatherThread>>(places, part, run.workspace, work, index, p.estimate,
                                                                  *map, cut);
      },
      record_maker<SplatPoint>(cluster_record));
}

}  // namespace gleaner::worker

// Stage kind "photon_gather": paths that read a photon map behind their first surface (kernels/photon/gather.cl).

#include <cmath>

#include "kernels/photon_records.h"
#include "scene/model/error.h"
#include "worker/stages/path_stage.h"
#include "worker/stages/photon/map_table.h"
#include "worker/stages/photon/stages.h"

namespace gleaner::worker {
namespace {

using kernels::PhotonGatherParameters;

PhotonGatherParameters read_parameters(const StageRun& run) {
  const auto p = run.parameters<PhotonGatherParameters>();
  check_sample_parameters(run, p.samples);
  constexpr std::uint32_t gathered = PATH_CLASS_DIFFUSE | PATH_CLASS_MIXED;
  if ((p.samples.filter & gathered) != gathered || p.samples.filter & PATH_CLASS_GLOSSY)
    throw Error::bad_input(run.where(), "filter", "diffuse and mixed light, without glossy light",
                           std::to_string(p.samples.filter));
  if (!std::isfinite(p.samples.clamp) || !(p.samples.clamp > 0))
    throw Error::bad_input(run.where(), "spacing", "metres above 0", std::to_string(p.samples.clamp));
  check_photon_estimate(run, p.estimate);
  return p;
}

class GatherThread : public PathThread {
 public:
  GatherThread(const SamplePart& part, Workspace& workspace, WorkQueue& work, unsigned index,
               const kernels::PhotonEstimate& estimate, const PhotonMapTable& map)
      : PathThread(part, workspace, work, index),
        reads_(take("reads", std::size_t{wave_.capacity()} * READ_WORDS * 4)),
        read_(part.device, part.program, "photon_read") {
    shade_.set("reads", reads_);
    part.scene.set_arguments(read_);
    map.set_arguments(read_, "map");
    read_.set("reads", reads_)
        .set("neighbours", estimate.neighbours)
        .set("most_radius", estimate.most_radius)
        .set("slots", part.slots)
        .set("slot_count", part.slot_count());
  }

 private:
  std::uint32_t step(const RayRange& range, std::uint32_t fresh) override {
    const std::uint32_t alive = PathThread::step(range, fresh);
    read_.set("count", range.end());
    HostThread::launch(read_, range.end(), wave_.capacity(), 1);
    return alive;
  }

  cl::Buffer reads_;
  Kernel read_;
};

}  // namespace

BatchResult run_photon_gather_stage(const StageRun& run) {
  const PhotonGatherParameters p = read_parameters(run);
  const auto map = photon_map_table(run, "map");
  return run_samples(run, p.samples, run.build("gather.cl", " -D PATH_FILTER=" + std::to_string(p.samples.filter)),
                     [&](const SamplePart& part, WorkQueue& work, unsigned index) {
                       return std::make_unique<GatherThread>(part, run.workspace, work, index, p.estimate, *map);
                     });
}

}  // namespace gleaner::worker

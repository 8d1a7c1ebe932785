// Stage kind "photon_gather": paths that read a photon map behind their first surface (kernels/photon/gather.cl).

#include <cmath>

#include "kernels/photon_records.h"
#include "scene/model/error.h"
#include "worker/stages/photon/gather_thread.h"
#include "worker/stages/photon/stages.h"
#include "worker/stages/splat/stages.h"

namespace gleaner::worker {
namespace {

using kernels::PhotonGatherParameters;

PhotonGatherParameters gather_parameters(const StageRun& run) {
  const auto p = run.parameters<PhotonGatherParameters>();
  check_sample_parameters(run, p.samples, PATH_CLASSES | PATH_CLASS_LAYER | PATH_CLASS_LOBE);
  if (p.samples.filter & PATH_CLASS_LOBE) check_splat_order(run, p.order);
  check_photon_gather(run, p.samples);
  check_photon_estimate(run, p.estimate);
  return p;
}

}  // namespace

void check_photon_gather(const StageRun& run, const kernels::PathParameters& p) {
  constexpr std::uint32_t gathered = PATH_CLASS_DIFFUSE | PATH_CLASS_MIXED;
  if ((p.filter & gathered) != gathered || p.filter & PATH_CLASS_GLOSSY)
    throw Error::bad_input(run.where(), "filter", "diffuse and mixed light, without glossy light",
                           std::to_string(p.filter));
  if (!std::isfinite(p.clamp) || !(p.clamp > 0))
    throw Error::bad_input(run.where(), "spacing", "metres above 0", std::to_string(p.clamp));
}

BatchResult run_photon_gather_stage(const StageRun& run) {
  const PhotonGatherParameters p = gather_parameters(run);
  const auto map = photon_map_table(run, "map");
  const PhotonCutTable cut = photon_cut_table(run, p.cut_depth);
  std::string options = " -D PATH_FILTER=" + std::to_string(p.samples.filter);
  if (p.samples.filter & PATH_CLASS_LOBE) options += " -D LOBE_ORDER=" + std::to_string(p.order);
  return run_samples(
      run, p.samples, run.build("gather.cl", options), [&](const SamplePart& part, WorkQueue& work, unsigned index) {
        return std::make_unique<PhotonGatherThread>(part, run.workspace, work, index, p.estimate, *map, cut);
      });
}

}  // namespace gleaner::worker

// Stage kind "splat_gather": the light that arrives at records (kernels/splat/gather.cl).

#include "scene/model/error.h"
#include "worker/stages/path_stage.h"
#include "worker/stages/splat/record_gather.h"
#include "worker/stages/splat/stages.h"

namespace gleaner::worker {

BatchResult run_splat_gather_stage(const StageRun& run) {
  const auto p = run.parameters<kernels::SplatGatherParameters>();
  check_record_parameters(run, p);
  if (p.samples.filter != PATH_CLASS_IRRADIANCE)
    throw Error::bad_input(run.where(), "filter", std::to_string(PATH_CLASS_IRRADIANCE),
                           std::to_string(p.samples.filter));
  return gather_records(
      run, p, run.build("gather.cl"),
      [&](const PlaceTable& places, const SamplePart& part, WorkQueue& work, unsigned index) {
        return std::make_unique<RecordThread<PathThread>>(places, part, run.workspace, work, index);
      },
      cache_record);
}

}  // namespace gleaner::worker

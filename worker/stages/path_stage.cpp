#include "worker/stages/path_stage.h"

namespace gleaner::worker {

using kernels::PathParameters;

PathThread::PathThread(const SamplePart& part, Workspace& workspace, WorkQueue& work, unsigned index)
    : SampleThread(part, workspace, work, index), shade_(part.device, part.program, "path_shade") {
  set_arguments(shade_);
  shade_.set("shadows", shadows_)
      .set("slots", part.slots)
      .set("features", part.features)
      .set("capacity", wave_.capacity())
      .set("reads", shadows_);  // not touched: of photon maps alone
}

std::uint32_t PathThread::step(const RayRange& range, std::uint32_t fresh) {
  clear_device_counters();
  set_wave(shade_, fresh);
  shade_.set("next", wave_.next_paths());
  launch(shade_, range.end());
  const auto counted = read_device_counters();
  counters.scatter += counted[COUNTER_ALIVE];
  counters.shadow += counted[COUNTER_SHADOW];
  if (counted[COUNTER_SHADOW]) connect(range);
  return counted[COUNTER_ALIVE];
}

BatchResult run_path_stage(const StageRun& run) {
  const auto p = run.parameters<PathParameters>();
  check_sample_parameters(run, p);
  return run_samples(run, p, run.build("path.cl", p.filter ? " -D PATH_FILTER=" + std::to_string(p.filter) : ""),
                     [&](const SamplePart& part, WorkQueue& work, unsigned index) {
                       return std::make_unique<PathThread>(part, run.workspace, work, index);
                     });
}

}  // namespace gleaner::worker

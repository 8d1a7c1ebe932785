#include "worker/stages/ao_stage.h"

#include <cmath>

#include "kernels/ao_records.h"
#include "scene/model/error.h"
#include "worker/stages/camera_samples.h"

namespace gleaner::worker {
namespace {

using kernels::AoParameters;

AoParameters read_parameters(const StageRun& run) {
  const auto p = run.parameters<AoParameters>();
  check_sample_parameters(run, p.samples);
  if (!(p.radius >= 0) || !std::isfinite(p.radius))
    throw Error::bad_input(run.where(), "radius", "0 or more metres", std::to_string(p.radius));
  if (p.rays == 0) throw Error::bad_input(run.where(), "rays", "at least 1", "0");
  return p;
}

class AoThread : public SampleThread {
 public:
  AoThread(const SamplePart& part, Workspace& workspace, WorkQueue& work, unsigned index, std::uint32_t rays)
      : SampleThread(part, workspace, work, index),
        rays_a_sample_(rays),
        meet_(part.device, part.program, "ao_meet"),
        ray_(part.device, part.program, "ao_ray") {
    set_arguments(meet_);
    meet_.set("slots", part.slots).set("features", part.features).set("capacity", wave_.capacity());
    set_arguments(ray_);
    ray_.set("shadows", shadows_);
  }

 private:
  std::uint32_t step(const RayRange& range, std::uint32_t fresh) override {
    clear_device_counters();
    set_wave(meet_, fresh);
    meet_.set("next", wave_.next_paths());
    launch(meet_, range.end());
    const std::uint32_t passing = read_device_counters()[COUNTER_ALIVE];
    counters.scatter += passing;
    set_wave(ray_, fresh);
    for (std::uint32_t ray = 0; ray < rays_a_sample_; ++ray) {
      clear_device_counters();
      ray_.set("ray", ray);
      launch(ray_, range.end());
      const std::uint32_t asked = read_device_counters()[COUNTER_SHADOW];
      counters.shadow += asked;
      if (asked) connect(range);
    }
    return passing;
  }

  std::uint32_t rays_a_sample_;
  Kernel meet_, ray_;
};

}  // namespace

BatchResult run_ao_stage(const StageRun& run) {
  const AoParameters p = read_parameters(run);
  return run_samples(run, p.samples, run.build("ao.cl"), [&](const SamplePart& part, WorkQueue& work, unsigned index) {
    return std::make_unique<AoThread>(part, run.workspace, work, index, p.rays);
  });
}

}  // namespace gleaner::worker

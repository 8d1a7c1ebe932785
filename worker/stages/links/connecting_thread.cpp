#include "worker/stages/links/connecting_thread.h"

#include "kernels/path_layout.h"
#include "worker/wavefront/path_wave.h"

namespace gleaner::worker {

ConnectingThread::ConnectingThread(const StageRun& run, const Program& program, std::uint32_t capacity, WorkQueue& work,
                                   unsigned index)
    : HostThread(run.device, run.workspace, run.scene.tracer(), work, index),
      shadow_rows_(run.scene.shadow_rows()),
      transparent_(run.scene.transparent_shadows()),
      samples_(capacity),
      shadows_(take("shadows", PathWave::bytes(capacity, shadow_rows_))),
      slots_(take("links.slots", std::size_t{capacity + RAY_BLOCK} * PLAIN_SLOT_WORDS * 4)),
      connect_(run.device, program, transparent_ ? "shadow_pass" : "shadow_connect") {
  connect_.set("shadows", shadows_).set("slots", slots_).set("slot_count", capacity);
  if (transparent_) {
    run.scene.set_arguments(connect_);
    connect_.set("counters", device_counters());
  }
}

void ConnectingThread::connect(std::uint32_t count) {
  cl_uint left = read_device_counters()[COUNTER_SHADOW];
  counters.shadow += left;
  if (!left) return;
  connect_.set("count", count);
  if (!transparent_) {
    rays_.any(shadows_, single_rays(shadow_rows_, count));
    launch(connect_, count, samples_);
    return;
  }
  // Shadow rays through what light passes straight take turns, one surface each, as those of camera paths.
  for (unsigned turn = 0; left && turn <= META_BOUNCE_MASK; ++turn) {
    rays_.closest(shadows_, single_rays(shadow_rows_, count));
    clear_device_counters();
    launch(connect_, count, samples_);
    left = read_device_counters()[COUNTER_SHADOW];
    counters.shadow += left;
  }
}

}  // namespace gleaner::worker

#include "worker/stages/links/link_rays.h"

#include "kernels/rays.h"
#include "worker/wavefront/path_wave.h"

namespace gleaner::worker {

// The ray and its hit, and one row more.
constexpr unsigned kRows = RAY_HIT_ROWS + 1;

LinkRayThread::LinkRayThread(const LinkRayBatch& batch, WorkQueue& work, unsigned index)
    : HostThread(batch.run.device, batch.run.workspace, batch.run.scene.tracer(), work, index),
      first_item_(batch.run.first),
      directions_(batch.p.directions),
      capacity_(elements_of_wave(batch.run.device, batch.p.directions)),
      hits_(take("paths", PathWave::bytes(rays(), kRows))),
      make_rays_(batch.run.device, batch.program, "links_rays") {
  batch.run.scene.set_arguments(make_rays_);
  make_rays_.set("parameters", batch.parameters)
      .set("mesh", batch.tables.mesh)
      .set("lobes", batch.lobes.lobes)
      .set("sides", batch.sides)
      .set("rays", hits_)
      .set("counters", device_counters());
}

std::uint32_t LinkRayThread::trace(std::uint64_t first, std::uint32_t count) {
  const std::uint32_t here = count * directions_;
  clear_device_counters();
  make_rays_.set("first", static_cast<cl_uint>(first_item_ + first)).set("count", here);
  launch(make_rays_, here, rays());
  counters.scatter += read_device_counters()[0];
  rays_.closest(hits_, single_rays(kRows, here));
  return here;
}

}  // namespace gleaner::worker

// Stage kind "links_probe": where irradiance bends (kernels/links/probe.cl).

#include <cmath>

#include "scene/model/error.h"
#include "worker/stages/links/link_rays.h"
#include "worker/stages/links/stages.h"

namespace gleaner::worker {
namespace {

class ProbeThread : public LinkRayThread {
 public:
  ProbeThread(const LinkRayBatch& batch, WorkQueue& work, unsigned index)
      : LinkRayThread(batch, work, index),
        seen_(take("links.seen", std::size_t{rays()} * PROBE_LIGHTS * 4)),
        faces_(take("links.faces", std::size_t{rays()} * 4)),
        records_(take("links.records", std::size_t{capacity_} * PROBE_WORDS * 4)),
        look_(batch.run.device, batch.program, "links_probe_hits"),
        sum_(batch.run.device, batch.program, "links_probe_sum") {
    batch.run.scene.set_arguments(look_);
    look_.set("parameters", batch.parameters).set("rays", hits_).set("seen", seen_).set("faces", faces_);
    sum_.set("parameters", batch.parameters).set("seen", seen_).set("faces", faces_).set("records", records_);
  }

  void run(BatchResult& result) {
    constexpr std::size_t stride = PROBE_WORDS * 4;
    while (const WorkQueue::Block block = work_.claim(capacity_)) {
      const auto count = static_cast<std::uint32_t>(block.count);
      const std::uint32_t traced = trace(block.first, count);
      look_.set("count", traced);
      launch(look_, traced, rays());
      sum_.set("count", count);
      launch(sum_, count, capacity_, 1);
      queue_.enqueueReadBuffer(records_, CL_TRUE, 0, count * stride, result.records.data() + block.first * stride);
    }
  }

 private:
  cl::Buffer seen_, faces_, records_;
  Kernel look_, sum_;
};

}  // namespace

BatchResult run_links_probe_stage(const StageRun& run) {
  const MeshTables tables = mesh_tables(run, nullptr, 0);
  LinkRayBatch batch{run,        read_links_parameters(run), tables, lobe_tables(run, tables), run.build("probe.cl"),
                     tables.mesh};
  check_elements(run, batch.p.elements, batch.tables.layout.elements());
  if (!std::isfinite(batch.p.wave))
    throw Error::bad_input(run.where(), "wave", "a finite number", std::to_string(batch.p.wave));
  const double start = seconds_now();
  BatchResult result;
  result.records.resize(run.count * PROBE_WORDS * 4);
  cl::CommandQueue queue = run.device.make_queue();
  batch.parameters = run.parameter_buffer(queue);
  WorkQueue work(run.count, host_threads(run.device));
  run_host_threads(work, result, [&](unsigned index) { return std::make_unique<ProbeThread>(batch, work, index); });
  result.counters.seconds = seconds_now() - start;
  return result;
}

}  // namespace gleaner::worker

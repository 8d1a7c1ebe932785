// Stage kind "vpl_trace": light paths, which leave virtual point lights (kernels/vpl/trace.cl).

#include "kernels/path_layout.h"
#include "kernels/vpl_records.h"
#include "worker/stages/split_stage.h"
#include "worker/stages/vpl/stages.h"
#include "worker/stages/vpl/waves.h"
#include "worker/wavefront/path_wave.h"

namespace gleaner::worker {
namespace {

using kernels::VplTraceParameters;

class LightPathThread : public HostThread {
 public:
  LightPathThread(const StageRun& run, const Program& program, const cl::Buffer& parameters, WorkQueue& work,
                  unsigned index)
      : HostThread(run.device, run.workspace, run.scene.tracer(), work, index),
        first_item_(run.first),
        capacity_(path_capacity(run.device)),
        path_rows_(run.scene.path_rows()),
        emit_(run.device, program, "vpl_emit"),
        step_(run.device, program, "vpl_trace_step"),
        paths_(take("paths", PathWave::bytes(capacity_, run.scene.path_rows()))),
        // A path's slots more: lanes with nothing to write do so behind the records.
        record_words_(std::size_t{capacity_ + 1} * VPL_PATH_SLOTS * VPL_WORDS),
        records_(take("records", record_words_ * 4)) {
    run.scene.set_arguments(emit_);
    emit_.set("parameters", parameters).set("emission", run.scene.emission()).set("paths", paths_);
    run.scene.set_arguments(step_);
    step_.set("parameters", parameters)
        .set("paths", paths_)
        .set("records", records_)
        .set("counters", device_counters());
  }

  void run(BatchResult& result) {
    const std::size_t stride = VPL_PATH_SLOTS * VPL_WORDS * 4;
    while (const WorkQueue::Block block = work_.claim(capacity_)) {
      const auto count = static_cast<std::uint32_t>(block.count);
      queue_.enqueueFillBuffer(records_, cl_uint{0}, 0, record_words_ * 4);
      emit_.set_words("first", first_item_ + block.first).set("count", count);
      launch(emit_, count, capacity_);
      counters.scatter += count;
      step_in_place(step_, paths_, path_rows_, count, capacity_);
      queue_.enqueueReadBuffer(records_, CL_TRUE, 0, count * stride, result.records.data() + block.first * stride);
    }
  }

 private:
  std::uint64_t first_item_;
  std::uint32_t capacity_;
  unsigned path_rows_;
  Kernel emit_, step_;
  cl::Buffer paths_;
  std::size_t record_words_;
  cl::Buffer records_;
};

// Leaves each item only the slots that hold a VPL.
void compact(BatchResult& result, std::uint64_t items) {
  constexpr std::size_t stride = VPL_WORDS * 4;
  std::byte* to = result.records.data();
  const std::byte* row = to;
  for (std::uint64_t item = 0; item < items; ++item) {
    std::uint32_t count = 0;
    for (unsigned slot = 0; slot < VPL_PATH_SLOTS; ++slot, row += stride) {
      float flux[3];
      std::memcpy(flux, row + VPL_FLUX * 4, sizeof flux);
      if (!(flux[0] + flux[1] + flux[2] > 0)) continue;
      std::memmove(to, row, stride);
      to += stride;
      ++count;
    }
    result.counts.push_back(count);
  }
  result.records.resize(static_cast<std::size_t>(to - result.records.data()));
}

}  // namespace

BatchResult run_vpl_trace_stage(const StageRun& run) {
  const auto p = run.parameters<VplTraceParameters>();
  run.check_range(wide(p.items_high, p.items_low));
  const double start = seconds_now();
  BatchResult result;
  if (!run.scene.shines()) {
    result.counts.assign(run.count, 0);
    return result;
  }
  result.records.resize(run.count * VPL_PATH_SLOTS * VPL_WORDS * 4);
  run_split(run, "trace.cl", result,
            [&](const Program& program, const cl::Buffer& parameters, WorkQueue& work, unsigned index) {
              return std::make_unique<LightPathThread>(run, program, parameters, work, index);
            });
  compact(result, run.count);
  result.counters.seconds = seconds_now() - start;
  return result;
}

}  // namespace gleaner::worker

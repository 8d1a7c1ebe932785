#pragma once
// The usual way to run a batch of a split stage: one program, and the parameters as its kernels read them.

#include <string>
#include <string_view>

#include "worker/stages/stage.h"
#include "worker/wavefront/host_threads.h"

namespace gleaner::worker {

// Runs the batch's items on the host threads. make(program, parameters, work, index) gives the state of one of them.
template <typename Make>
void run_split(const StageRun& run, std::string_view file, BatchResult& result, Make make,
               const std::string& options = {}) {
  cl::CommandQueue queue = run.device.make_queue();
  const cl::Buffer parameters = run.parameter_buffer(queue);
  const Program program = run.build(file, options);
  WorkQueue work(run.count, host_threads(run.device));
  run_host_threads(work, result, [&](unsigned index) { return make(program, parameters, work, index); });
}

}  // namespace gleaner::worker

#pragma once
// Stage kind "path" (kernels/path.cl).

#include "worker/stages/camera_samples.h"

namespace gleaner::worker {

// Paths that are lit and scattered where they end (kernel path_shade).
class PathThread : public SampleThread {
 public:
  PathThread(const SamplePart& part, Workspace& workspace, WorkQueue& work, unsigned index);

 protected:
  std::uint32_t step(const RayRange& range, std::uint32_t fresh) override;

  Kernel shade_;
};

// Throws Error::bad_input on a malformed task, cl::Error, Error::failed.
BatchResult run_path_stage(const StageRun& run);

}  // namespace gleaner::worker

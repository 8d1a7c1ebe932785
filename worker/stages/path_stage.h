#pragma once
// Stage kind "path" (kernels/path.cl).

#include "worker/stages/stage.h"

namespace gleaner::worker {

// Throws Error::bad_input on a malformed task, cl::Error, Error::failed.
BatchResult run_path_stage(const StageRun& run);

}  // namespace gleaner::worker

#pragma once
// Stage kind "ao" (kernels/ao.cl).

#include "worker/stages/stage.h"

namespace gleaner::worker {

// Throws Error::bad_input on a malformed task, cl::Error, Error::failed.
BatchResult run_ao_stage(const StageRun& run);

}  // namespace gleaner::worker

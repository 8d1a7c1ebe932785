#pragma once
// Stage kind "denoise" (kernels/denoise_records.h).

#include "worker/stages/stage.h"

namespace gleaner::worker {

// Throws Error::bad_input for a malformed task, Error::failed where there is no denoiser or it fails.
BatchResult run_denoise_stage(const StageRun& run);

}  // namespace gleaner::worker

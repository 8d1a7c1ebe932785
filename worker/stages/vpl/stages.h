#pragma once
// Stage kinds of virtual point lights (kernels/vpl/). Each throws Error::bad_input on a malformed task, cl::Error,
// Error::failed.

#include "worker/stages/stage.h"

namespace gleaner::worker {

BatchResult run_vpl_trace_stage(const StageRun& run);
BatchResult run_vpl_points_stage(const StageRun& run);
BatchResult run_vpl_visibility_stage(const StageRun& run);
BatchResult run_vpl_shade_stage(const StageRun& run);

}  // namespace gleaner::worker

#pragma once
// Stage kinds of radiance links (kernels/links_records.h). Each throws Error::bad_input on a malformed task, cl::Error,
// Error::failed.

#include "worker/stages/stage.h"

namespace gleaner::worker {

BatchResult run_links_mesh_stage(const StageRun& run);
BatchResult run_links_lobes_stage(const StageRun& run);
BatchResult run_links_probe_stage(const StageRun& run);
BatchResult run_links_albedo_stage(const StageRun& run);
BatchResult run_links_make_stage(const StageRun& run);
BatchResult run_links_light_stage(const StageRun& run);
BatchResult run_links_gather_stage(const StageRun& run);
BatchResult run_links_exchange_stage(const StageRun& run);
BatchResult run_links_shade_stage(const StageRun& run);
BatchResult run_links_audit_stage(const StageRun& run);

// On the worker's host.
BatchResult measure_links_flux(const StageTask& task);
BatchResult smooth_links(const StageTask& task);

}  // namespace gleaner::worker

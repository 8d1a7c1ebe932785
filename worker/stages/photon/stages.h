#pragma once
// Stage kinds of photon maps (kernels/photon/). Each throws Error::bad_input on a malformed task, cl::Error,
// Error::failed.

#include "worker/stages/stage.h"

namespace gleaner::worker {

BatchResult run_photon_trace_stage(const StageRun& run);
BatchResult run_photon_guide_stage(const StageRun& run);
BatchResult run_photon_gather_stage(const StageRun& run);
BatchResult run_photon_caustics_stage(const StageRun& run);
BatchResult run_photon_cut_stage(const StageRun& run);
BatchResult run_photon_map_stage(const StageRun& run);
BatchResult run_photon_cluster_stage(const StageRun& run);
BatchResult run_photon_extend_stage(const StageRun& run);
BatchResult run_photon_cluster_gather_stage(const StageRun& run);
BatchResult run_photon_cluster_refine_stage(const StageRun& run);
BatchResult run_photon_extend_refine_stage(const StageRun& run);
// On the host:
BatchResult smooth_photon_clusters(const StageTask& task);

}  // namespace gleaner::worker

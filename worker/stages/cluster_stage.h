#pragma once
// Stage kinds "vpl_cluster" and "point_cluster": k-means over VPLs or over points to be shaded (algorithm 1 of the
// Colom et al. 2022). Solo.

#include "worker/stages/device_scene.h"
#include "worker/stages/executor.h"
#include "worker/stages/workspace.h"

namespace gleaner::worker {

BatchResult run_cluster_stage(const Device& device, Workspace& workspace, DeviceScene& scene, const StageTask& task,
                              std::uint64_t first, std::uint64_t count);

}  // namespace gleaner::worker

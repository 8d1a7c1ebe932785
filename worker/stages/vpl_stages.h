#pragma once
// Stage kinds "vpl_trace", "vpl_points", "vpl_visibility" and "vpl_shade" (kernels/vpl/).

#include "worker/stages/device_scene.h"
#include "worker/stages/executor.h"
#include "worker/stages/workspace.h"

namespace gleaner::worker {

BatchResult run_vpl_trace_stage(const Device& device, Workspace& workspace, DeviceScene& scene, const StageTask& task,
                                std::uint64_t first, std::uint64_t count);
BatchResult run_vpl_points_stage(const Device& device, Workspace& workspace, DeviceScene& scene, const StageTask& task,
                                 std::uint64_t first, std::uint64_t count);
BatchResult run_vpl_visibility_stage(const Device& device, Workspace& workspace, DeviceScene& scene,
                                     const StageTask& task, std::uint64_t first, std::uint64_t count);
BatchResult run_vpl_shade_stage(const Device& device, Workspace& workspace, DeviceScene& scene, const StageTask& task,
                                std::uint64_t first, std::uint64_t count);

}  // namespace gleaner::worker

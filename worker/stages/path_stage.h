#pragma once
// Stage kind "path": kernels/path.cl on the device's lanes.

#include "worker/stages/device_scene.h"
#include "worker/stages/executor.h"
#include "worker/stages/workspace.h"

namespace gleaner::worker {

// Runs items [first, first + count) of the stage. Throws Error::bad_input on a malformed task, cl::Error,
// Error::failed.
BatchResult run_path_stage(const Device& device, Workspace& workspace, DeviceScene& scene, const StageTask& task,
                           std::uint64_t first, std::uint64_t count);

}  // namespace gleaner::worker

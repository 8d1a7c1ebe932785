#pragma once
// Stages of method `vpl` that run on the worker's host (kernels/vpl_host_records.h): resampling and ordering of virtual
// point lights, points of a camera trajectory, the pilot's sums. Each throws Error::bad_input for a malformed task.

#include "worker/wavefront/stage_task.h"

namespace gleaner::worker {

BatchResult resample_lights(const StageTask& task);
BatchResult order_lights(const StageTask& task);
BatchResult sample_points(const StageTask& task);
BatchResult merge_points(const StageTask& task);
BatchResult count_skipped_queries(const StageTask& task);
BatchResult choose_pilot_points(const StageTask& task);
BatchResult choose_pilot_lights(const StageTask& task);
BatchResult measure_pilot(const StageTask& task);

}  // namespace gleaner::worker

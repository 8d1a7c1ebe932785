#pragma once
// Stage kinds of radiance cache splatting (kernels/splat/). Each throws Error::bad_input on a malformed task,
// cl::Error, Error::failed.

#include <string>
#include <vector>

#include "worker/stages/splat/points.h"
#include "worker/stages/stage.h"

namespace gleaner::worker {

BatchResult run_splat_points_stage(const StageRun& run);
BatchResult run_splat_select_stage(const StageRun& run);
BatchResult run_splat_extend_stage(const StageRun& run);
BatchResult run_splat_gather_stage(const StageRun& run);
BatchResult shape_splat_places(const StageTask& task);
BatchResult merge_splat_records(const StageTask& task);
BatchResult judge_splat_cache(const StageTask& task);
BatchResult run_splat_smooth_stage(const StageRun& run);
BatchResult run_splat_lobe_gather_stage(const StageRun& run);
BatchResult run_splat_shade_stage(const StageRun& run);

// Adds the records of an input to the others.
void append_records(const StageTask& task, const std::string& name, std::vector<CacheRecord>& records);
// The input "places", a row for each of the records. Throws Error::bad_input where they are not theirs.
std::vector<SplatPlace> places_of(const StageTask& task, const std::vector<CacheRecord>& records);
// The output of one item that is a cache.
BatchResult cache_result(const std::vector<CacheRecord>& records);
// Throws Error::bad_input for a number of samples of a pixel that is out of range.
void check_splat_samples(const StageRun& run, std::uint32_t samples);
// For an order of hemispherical harmonics that is out of range.
void check_splat_order(const StageRun& run, std::uint32_t order);
// As check_splat_samples(), and for a picture of no or too many points.
void check_splat_points(const StageRun& run, std::uint32_t width, std::uint32_t height, std::uint32_t samples);
// The points of tiles [first_tile, first_tile + tiles). The task's parameters begin with `p`.
BatchResult find_splat_points(const StageRun& run, const kernels::SplatPointParameters& p, std::uint64_t first_tile,
                              std::uint64_t tiles);
// All points that a camera shows, where a stage makes them for its own part, of a picture of this size: `counters` gets
// what that took. Throws Error::bad_input where `p` says another size.
std::vector<SplatPoint> find_camera_points(const StageRun& run, const kernels::SplatPointParameters& p,
                                           std::uint32_t width, std::uint32_t height, std::uint32_t samples,
                                           BatchResult& counters);
// The input "points", of whole tiles. Throws Error::bad_input for other numbers of them, and such as are not finite.
std::vector<SplatPoint> read_splat_points(const StageRun& run, std::uint32_t width, std::uint32_t height,
                                          std::uint32_t samples);

}  // namespace gleaner::worker

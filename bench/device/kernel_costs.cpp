#include "bench/device/kernel_costs.h"

#include <algorithm>
#include <cstring>

#include "kernels/path_layout.h"
#include "kernels/path_records.h"
#include "kernels/vpl_records.h"

namespace gleaner::bench {
namespace {

// Bytes: rows of rays and records that must come from memory or go there; what caches hold (triangles, materials,
// lights that a wave shares) is not counted. Operations: counted in the source, for a pair of a point and a light.
struct Cost {
  const char* kernel;
  const char* unit;
  double bytes = 0, flops = 0;
  bool pairs = false;  // the launch's work is points, each with a slice of the lights
};

constexpr double kPath = PATH_ROWS * 4, kShadow = SHADOW_ROWS * 4, kRay = RAY_ROWS * 4, kPoint = POINT_WORDS * 4,
                 kVpl = VPL_WORDS * 4, kVisibility = VISIBILITY_ROWS * 4;
// The bounded geometry term (two dot products, a squared distance, a division) and three multiply-adds.
constexpr double kPairFlops = 36;

constexpr Cost kCosts[] = {
    {"camera_generate", "rays", kPath + PLAIN_SLOT_WORDS * 4},
    {"path_shade", "rays", 2 * kPath + kShadow + 24},
    {"shadow_connect", "rays", kShadow + 24},
    {"shadow_pass", "rays", 2 * TRANSPARENT_SHADOW_ROWS * 4 + 24},
    {"camera_resolve", "items", PLAIN_SLOT_WORDS * 4 + sizeof(kernels::PathRecord)},
    {"trace_closest", "rays", kRay + 8 * 4},
    {"trace_any", "rays", kRay + 4},
    {"vpl_emit", "rays", kPath},
    {"vpl_trace_step", "rays", 2 * kPath + kVpl},
    {"vpl_camera_rays", "rays", kPath + kPoint},
    {"vpl_point_step", "rays", 2 * kPath + kPoint},
    {"vpl_visibility_cutoff", "points", kPoint + 4},
    {"vpl_visibility_rays", "pairs", kVisibility, kPairFlops},
    {"visibility_pack", "pairs", 4 + 0.125},
    {"vpl_memberships", "points", kPoint + 8 * MAX_FUZZINESS},
    {"vpl_gather", "pairs", 0, kPairFlops, true},
    {"vpl_residual_select", "pairs", 0, kPairFlops, true},
    {"vpl_residual_rays", "pairs", kPoint + kVpl + kVisibility + 16, kPairFlops},
};

double lights_of_a_point(const RecordedBatch& batch) {
  kernels::VplPointParameters p{};
  std::memcpy(&p, batch.task.parameters.data(), std::min(sizeof p, batch.task.parameters.size()));
  return static_cast<double>(p.clusters) / std::max(p.samples, 1u);
}

}  // namespace

KernelRate rate_of(const std::string& kernel, const worker::KernelTime& time, const RecordedBatch& batch) {
  const auto cost = std::ranges::find_if(kCosts, [&](const Cost& c) { return kernel == c.kernel; });
  const double work = static_cast<double>(time.work) / time.seconds;
  if (cost == std::end(kCosts)) return {.units = work};
  const double units = cost->pairs ? work * lights_of_a_point(batch) : work;
  return {.unit = cost->unit, .units = units, .bytes = units * cost->bytes, .flops = units * cost->flops};
}

}  // namespace gleaner::bench

#pragma once
// How far a cache is off, from itself alone, as pixels see it: the noise of its records, known from halves of their
// rays, and what interpolation does wrong, from how much the records of a point disagree.

#include <span>
#include <vector>

#include "kernels/splat_records.h"
#include "worker/stages/splat/points.h"

namespace gleaner::worker {

// `points`: of some pixels, `samples` each.
kernels::SplatJudgeFacts judge_cache(std::span<const SplatPoint> points, std::uint32_t samples,
                                     std::span<const CacheRecord> records);

}  // namespace gleaner::worker

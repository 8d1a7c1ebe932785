#include "worker/wavefront/counters.h"

#include <algorithm>

#include "kernels/records.h"

namespace gleaner::worker {

static_assert(FiniteReport::kWords == 2 + REPORTED_ITEMS);

void ThreadCounters::add_to(BatchCounters& batch, unsigned threads) const {
  batch.camera_rays += camera;
  batch.scatter_rays += scatter;
  batch.shadow_rays += shadow;
  batch.nonfinite += nonfinite;
  batch.nonfinite_items.insert(batch.nonfinite_items.end(), nonfinite_items.begin(), nonfinite_items.end());
  batch.trace_seconds += trace / threads;
  batch.kernel_seconds += (all - trace) / threads;
}

void FiniteReport::clear(cl::CommandQueue& queue) {
  static constexpr cl_uint zero[kWords] = {};
  queue.enqueueWriteBuffer(buffer_, CL_FALSE, 0, sizeof zero, zero);
}

void FiniteReport::add_to(ThreadCounters& counters, cl::CommandQueue& queue, std::uint64_t first_item) {
  cl_uint words[kWords] = {};
  queue.enqueueReadBuffer(buffer_, CL_TRUE, 0, sizeof words, words);
  counters.nonfinite += words[0];
  for (cl_uint k = 0; k < std::min(words[1], REPORTED_ITEMS); ++k)
    counters.nonfinite_items.push_back(first_item + words[2 + k]);
}

}  // namespace gleaner::worker

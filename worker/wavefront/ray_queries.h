#pragma once
// Ray queries of one host thread: closest hit and any hit, and what they took.

#include "worker/trace/tracer.h"
#include "worker/wavefront/counters.h"

namespace gleaner::worker {

// Rays that stand in no order, each answered for itself: its answer does not depend on its neighbours.
inline RayRange single_rays(unsigned rows, std::uint32_t count) {
  RayRange range;
  range.rows = rows;
  range.incoherent = count;
  return range;
}

// Blocks of 16 neighbours, always the same 16, that are answered together. A packet's answer to a ray may depend on the
// other fifteen, so that a batch must never cut a block.
inline RayRange ray_packets(unsigned rows, std::uint32_t count) {
  RayRange range;
  range.rows = rows;
  range.coherent_count = count;
  return range;
}

class RayQueries {
 public:
  RayQueries(Tracer& tracer, cl::CommandQueue& queue, ThreadCounters& counters)
      : tracer_(tracer), queue_(queue), counters_(counters) {}

  // Both wait for what the queue holds, and return when the answers are in the buffer.
  void closest(cl::Buffer& rays, const RayRange& range) {
    timed([&] { tracer_.closest(queue_, rays, range); });
  }
  void any(cl::Buffer& rays, const RayRange& range) {
    timed([&] { tracer_.any(queue_, rays, range); });
  }

 private:
  template <typename Query>
  void timed(Query&& query) {
    queue_.finish();
    const double start = seconds_now();
    query();
    counters_.trace += seconds_now() - start;
  }

  Tracer& tracer_;
  cl::CommandQueue& queue_;
  ThreadCounters& counters_;
};

}  // namespace gleaner::worker

#pragma once
// What one host thread's share of a batch cost, and samples that were not finite.

#include <cstdint>
#include <vector>

#include "worker/device/clock.h"
#include "worker/device/device.h"
#include "worker/wavefront/stage_task.h"

namespace gleaner::worker {

struct ThreadCounters {
  std::uint64_t camera = 0, scatter = 0, shadow = 0;  // rays
  std::uint64_t nonfinite = 0;                        // samples
  std::vector<std::uint64_t> nonfinite_items{};
  double trace = 0, all = 0;  // seconds

  // Seconds are the mean over the threads.
  void add_to(BatchCounters& batch, unsigned threads) const;
};

// Samples that a kernel left out because they were not finite: it counts them in a report of kWords words (samples,
// items, then the first few items).
class FiniteReport {
 public:
  static constexpr std::size_t kWords = 2 + 8;  // 2 + REPORTED_ITEMS of kernels/records.h

  explicit FiniteReport(cl::Buffer buffer) : buffer_(std::move(buffer)) {}

  const cl::Buffer& buffer() const { return buffer_; }
  void clear(cl::CommandQueue& queue);
  // The kernel's items count from `first_item`. Blocks.
  void add_to(ThreadCounters& counters, cl::CommandQueue& queue, std::uint64_t first_item);

 private:
  cl::Buffer buffer_;
};

}  // namespace gleaner::worker

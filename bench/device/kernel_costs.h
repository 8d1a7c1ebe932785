#pragma once
// What a kernel has to do at least for each thing that it works on, and so how near to the device's peak it ran.

#include "bench/device/recorded.h"
#include "worker/device/device_info.h"

namespace gleaner::bench {

struct KernelRate {
  const char* unit = "items";
  double units = 0, bytes = 0, flops = 0;  // per second; 0 where nobody counted
};

// `time`: of any number of runs of the batch.
KernelRate rate_of(const std::string& kernel, const worker::KernelTime& time, const RecordedBatch& batch);

}  // namespace gleaner::bench

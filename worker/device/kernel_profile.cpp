#include "worker/device/kernel_profile.h"

namespace gleaner::worker {

void KernelProfile::add(const std::string& kernel, cl::Event event, std::size_t work) {
  std::lock_guard lock(mutex_);
  launches_.push_back({kernel, std::move(event), work});
}

std::map<std::string, KernelTime> KernelProfile::take() {
  std::lock_guard lock(mutex_);
  std::map<std::string, KernelTime> times;
  for (Launch& launch : launches_) {
    launch.event.wait();
    const auto start = launch.event.getProfilingInfo<CL_PROFILING_COMMAND_START>();
    const auto end = launch.event.getProfilingInfo<CL_PROFILING_COMMAND_END>();
    KernelTime& time = times[launch.kernel];
    ++time.launches;
    time.work += launch.work;
    time.seconds += static_cast<double>(end - start) * 1e-9;
  }
  launches_.clear();
  return times;
}

}  // namespace gleaner::worker

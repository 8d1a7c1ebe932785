#pragma once
// How long each kernel ran, by the device's own clock.

#include <map>
#include <mutex>
#include <string>
#include <vector>

#include "worker/device/device_info.h"
#include "worker/device/opencl.h"

namespace gleaner::worker {

// Off at first. Thread-safe.
class KernelProfile {
 public:
  // Command queues that are made after it was turned on keep time.
  void turn_on() { on_ = true; }
  bool on() const { return on_; }

  void add(const std::string& kernel, cl::Event event, std::size_t work);
  // Waits for the kernels that were added, and forgets them.
  std::map<std::string, KernelTime> take();

 private:
  struct Launch {
    std::string kernel;
    cl::Event event;
    std::size_t work = 0;
  };
  bool on_ = false;
  std::mutex mutex_;
  std::vector<Launch> launches_;
};

}  // namespace gleaner::worker

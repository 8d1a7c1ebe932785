#pragma once
// The host threads that work on a batch, each with a command queue and buffers of its own: as many as a CPU device has
// threads, one on other devices.

#include <array>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "scene/model/error.h"
#include "worker/device/kernel.h"
#include "worker/wavefront/counters.h"
#include "worker/wavefront/ray_queries.h"
#include "worker/wavefront/run_threads.h"
#include "worker/wavefront/wanted.h"
#include "worker/wavefront/work_queue.h"
#include "worker/wavefront/workspace.h"

namespace gleaner::worker {

inline unsigned host_threads(const Device& device) { return device.info().cpu ? device.info().threads : 1; }

// Gives a host thread buffers of its own, by name.
using TakeBuffer = std::function<cl::Buffer(const std::string& name, std::size_t bytes)>;

// A stage derives from it the state of one of its threads.
class HostThread {
 public:
  HostThread(const Device& device, Workspace& workspace, Tracer& tracer, WorkQueue& work, unsigned index);
  // Where a call failed, what was enqueued before it still writes to buffers that the next batch takes.
  ~HostThread();
  HostThread(const HostThread&) = delete;
  HostThread& operator=(const HostThread&) = delete;

  ThreadCounters counters;

 protected:
  // A buffer of this thread's own, with room for the last row's load of a whole line.
  cl::Buffer take(const std::string& name, std::size_t bytes);

  // A work-item does as many things as the device has lanes, or `per_item`.
  void launch(Kernel& kernel, std::size_t work, std::size_t capacity) {
    kernel.launch(queue_, {.work = work, .capacity = capacity, .per_item = device_.lanes()});
  }
  void launch(Kernel& kernel, std::size_t work, std::size_t capacity, unsigned per_item) {
    kernel.launch(queue_, {.work = work, .capacity = capacity, .per_item = per_item});
  }

  // Moves paths in place, all of them at each step, until none is left: closest hits, then `step`, which adds the paths
  // that go on to the first device counter. Its parameters are set but for `count`.
  void step_in_place(Kernel& step, cl::Buffer& paths, unsigned rows, std::uint32_t count, std::uint32_t capacity);
  // The same for paths that live long: those that are left are packed where they have become few. `pack`: the kernel
  // pack_paths, whose buffers and `count` are not set. `step`: `paths` is not set. The paths stand in the first buffer.
  void step_packed(Kernel& step, Kernel& pack, std::array<cl::Buffer, 2> paths, unsigned rows, std::uint32_t count,
                   std::uint32_t capacity);

  // Two counters that kernels add to.
  const cl::Buffer& device_counters() const { return counters_buffer_; }
  void clear_device_counters();
  std::array<cl_uint, 2> read_device_counters();  // blocks

  const Device& device_;
  WorkQueue& work_;
  cl::CommandQueue queue_;
  RayQueries rays_;

 private:
  // Returns how many paths are left.
  cl_uint step_once(Kernel& step, cl::Buffer& paths, unsigned rows, std::uint32_t count, std::uint32_t capacity);

  Workspace& workspace_;
  unsigned index_;
  cl::Buffer counters_buffer_;
};

// Makes the threads' states by make(index) and calls run() of each, in a thread of its own, until the work is done.
template <typename Make>
void run_host_threads(WorkQueue& work, BatchResult& result, Make make) {
  std::vector<decltype(make(0u))> all;
  for (unsigned k = 0; k < work.threads(); ++k) all.push_back(make(k));
  run_threads(work.threads(), [&](unsigned k) {
    const double start = seconds_now();
    try {
      all[k]->run(result);
    } catch (...) {
      work.stop();
      throw;
    }
    all[k]->counters.all = seconds_now() - start;
  });
  check_wanted();
  for (const auto& thread : all) thread->counters.add_to(result.counters, work.threads());
}

}  // namespace gleaner::worker

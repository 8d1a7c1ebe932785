#include "worker/wavefront/host_threads.h"

namespace gleaner::worker {

HostThread::HostThread(const Device& device, Workspace& workspace, Tracer& tracer, WorkQueue& work, unsigned index)
    : device_(device),
      work_(work),
      queue_(device.make_queue()),
      rays_(tracer, queue_, counters),
      workspace_(workspace),
      index_(index),
      counters_buffer_(take("counters", 64)) {}

HostThread::~HostThread() {
  if (work_.stopped()) clFinish(queue_());
}

cl::Buffer HostThread::take(const std::string& name, std::size_t bytes) {
  return workspace_.take(name + "." + std::to_string(index_), bytes + 64);
}

void HostThread::clear_device_counters() {
  static constexpr cl_uint zero[2] = {0, 0};  // read after the call, also where a later one throws
  queue_.enqueueWriteBuffer(counters_buffer_, CL_FALSE, 0, sizeof zero, zero);
}

std::array<cl_uint, 2> HostThread::read_device_counters() {
  std::array<cl_uint, 2> counted{};
  queue_.enqueueReadBuffer(counters_buffer_, CL_TRUE, 0, sizeof counted, counted.data());
  return counted;
}

cl_uint HostThread::step_once(Kernel& step, cl::Buffer& paths, unsigned rows, std::uint32_t count,
                              std::uint32_t capacity) {
  rays_.closest(paths, single_rays(rows, count));
  clear_device_counters();
  launch(step, count, capacity);
  const cl_uint alive = read_device_counters()[0];
  counters.scatter += alive;
  return alive;
}

void HostThread::step_in_place(Kernel& step, cl::Buffer& paths, unsigned rows, std::uint32_t count,
                               std::uint32_t capacity) {
  step.set("count", count);
  while (step_once(step, paths, rows, count, capacity) != 0) {
  }
}

void HostThread::step_packed(Kernel& step, Kernel& pack, std::array<cl::Buffer, 2> paths, unsigned rows,
                             std::uint32_t count, std::uint32_t capacity) {
  for (;;) {
    step.set("paths", paths[0]).set("count", count);
    const cl_uint alive = step_once(step, paths[0], rows, count, capacity);
    if (alive == 0) return;
    if (alive > count / 4 * 3) continue;
    pack.set("paths", paths[0]).set("packed", paths[1]).set("count", count);
    launch(pack, count, capacity);
    std::swap(paths[0], paths[1]);
    count = alive;
  }
}

}  // namespace gleaner::worker

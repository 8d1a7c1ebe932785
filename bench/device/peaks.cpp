#include "bench/device/peaks.h"

#include <algorithm>

namespace gleaner::bench {
namespace {

// 16 chains a work-item, so that neither latency nor memory shows.
constexpr const char* kText = R"(
kernel void copy(global const float4* restrict from, global float4* restrict to) {
  size_t i = get_global_id(0);
  to[i] = from[i];
}
kernel void multiply_add(global float* out, float a, uint steps) {
  float16 x = (float16)(get_global_id(0) * 1e-9f) +
              (float16)(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15);
  for (uint k = 0; k < steps; ++k) x = fma(x, (float16)a, (float16)1e-7f);
  out[get_global_id(0)] = x.s0 + x.s1 + x.s2 + x.s3 + x.s4 + x.s5 + x.s6 + x.s7 + x.s8 + x.s9 + x.sa + x.sb + x.sc +
                          x.sd + x.se + x.sf;
}
)";

// Seconds of the fastest of several launches.
double fastest(cl::CommandQueue& queue, cl::Kernel& kernel, std::size_t items) {
  double best = 1e300;
  for (int round = 0; round < 7; ++round) {
    cl::Event event;
    queue.enqueueNDRangeKernel(kernel, cl::NullRange, cl::NDRange(items), cl::NDRange(64), nullptr, &event);
    event.wait();
    best = std::min(best, static_cast<double>(event.getProfilingInfo<CL_PROFILING_COMMAND_END>() -
                                              event.getProfilingInfo<CL_PROFILING_COMMAND_START>()) *
                              1e-9);
  }
  return best;
}

}  // namespace

Peaks measure_peaks(const worker::Device& device) {
  cl::Program program(device.context(), std::string(kText));
  program.build(std::vector<cl::Device>{device.device()}, "-cl-std=CL1.2");
  cl::CommandQueue queue(device.context(), device.device(), CL_QUEUE_PROFILING_ENABLE);
  const std::size_t bytes = (device.info().cpu ? std::size_t{128} : std::size_t{1024}) << 20;
  cl::Buffer from = device.make_buffer(bytes), to = device.make_buffer(bytes);
  queue.enqueueFillBuffer(from, cl_uint{0}, 0, bytes);
  queue.enqueueFillBuffer(to, cl_uint{0}, 0, bytes);
  cl::Kernel copy(program, "copy");
  copy.setArg(0, from);
  copy.setArg(1, to);
  Peaks peaks;
  peaks.bytes = 2.0 * static_cast<double>(bytes) / fastest(queue, copy, bytes / 16);
  cl::Kernel multiply_add(program, "multiply_add");
  const std::size_t items = device.info().cpu ? 1u << 14 : 1u << 20;
  constexpr cl_uint steps = 2048;
  multiply_add.setArg(0, to);
  multiply_add.setArg(1, 0.999f);
  multiply_add.setArg(2, steps);
  peaks.flops = 2.0 * 16 * steps * static_cast<double>(items) / fastest(queue, multiply_add, items);
  return peaks;
}

}  // namespace gleaner::bench

#pragma once
// What every stage's host side does alike: launches, times, and checks of what it was told.

#include <chrono>
#include <cstring>
#include <string>

#include "scene/model/error.h"
#include "worker/device/device.h"
#include "worker/stages/executor.h"

namespace gleaner::worker {

inline double seconds_now() {
  return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count();
}

// Enqueues a kernel for `work` things, of which a work-item does `lanes`. On CPU devices always for `capacity` of them
// (work-items beyond `work` return at once): PoCL 3.1 keeps one compiled copy a grid size, and where there are several
// its count of their users goes wrong as soon as two threads launch (pocl_release_dlhandle_cache aborts). Groups are of
// a fixed size, so that the compiled code, and with it every bit, does not depend on how much there is to do.
inline void launch(const Device& device, cl::CommandQueue& queue, cl::Kernel& kernel, std::size_t work,
                   std::size_t capacity, unsigned lanes) {
  const std::size_t items = ((device.info().cpu ? capacity : work) + lanes - 1) / lanes;
  const std::size_t group = device.info().cpu ? 8 : 64;
  queue.enqueueNDRangeKernel(kernel, cl::NullRange, cl::NDRange((items + group - 1) / group * group),
                             cl::NDRange(group));
}

// The stage's parameters as the struct that its kernels read. Throws Error::bad_input for another size.
template <typename Parameters>
Parameters read_parameters(const StageTask& task) {
  Parameters p;
  if (task.parameters.size() != sizeof p)
    throw Error::bad_input("stage " + task.kind, "parameters", std::to_string(sizeof p) + " bytes",
                           std::to_string(task.parameters.size()));
  std::memcpy(&p, task.parameters.data(), sizeof p);
  return p;
}

// Throws Error::bad_input unless items [first, first + count) are among the stage's `total`.
inline void check_range(const StageTask& task, std::uint64_t total, std::uint64_t first, std::uint64_t count) {
  if (first + count < first || first + count > total)
    throw Error::bad_input("stage " + task.kind, "items", "a range below " + std::to_string(total),
                           std::to_string(first) + " + " + std::to_string(count));
}

// Throws Error::bad_input for a film of no or too many pixels, and for a camera whose rays would not be finite: these
// end Embree and the environment's look-up alike.
inline void check_film(const StageTask& task, const scene::Camera& camera, std::uint32_t width, std::uint32_t height) {
  const std::string where = "stage " + task.kind;
  const std::uint64_t pixels = std::uint64_t{width} * height;
  if (pixels == 0 || pixels > (std::uint64_t{1} << 28))
    throw Error::bad_input(where, "size", "1 to 2^28 pixels", std::to_string(width) + "x" + std::to_string(height));
  scene::Scene with_camera;
  with_camera.cameras.push_back({"camera", camera});
  scene::validate(with_camera, where);
}

}  // namespace gleaner::worker

#pragma once
// A kernel whose arguments are set by the names that its source gives them.

#include <string>
#include <string_view>
#include <vector>

#include "worker/device/device.h"

namespace gleaner::worker {

// How much a launch has to do, and the most that a launch of this kernel ever has to do. A work-item does `per_item` of
// it; `group` work-items run together (0: the device's usual number).
struct Grid {
  std::size_t work = 0, capacity = 0;
  unsigned per_item = 1;
  std::size_t group = 0;
};

// Not thread-safe: arguments belong to the object, so that each host thread needs its own.
class Kernel {
 public:
  // Throws Error::failed where the program has no such kernel, or the driver counts other parameters than the source.
  Kernel(const Device& device, const Program& program, const std::string& name);

  // Throw Error::failed where no parameter has this name or it is of another type.
  Kernel& set(std::string_view name, const cl::Buffer& buffer);
  Kernel& set(std::string_view name, cl_uint value);
  Kernel& set(std::string_view name, cl_float value);
  template <typename T>
  Kernel& set(std::string_view name, T value) = delete;  // no conversions
  // A 64-bit number in the parameters name_low and name_high.
  Kernel& set_words(const std::string& name, std::uint64_t value);

  // Throws Error::failed where an argument was never set. On CPU devices the grid is always that of `capacity`
  // (work-items beyond `work` return at once): PoCL 3.1 keeps one compiled copy a grid size, and where there are
  // several its count of their users goes wrong as soon as two threads launch (pocl_release_dlhandle_cache aborts).
  // Groups are of a fixed size, so that the compiled code, and with it every bit, does not depend on how much there is
  // to do.
  void launch(cl::CommandQueue& queue, const Grid& grid);

  // Launches one group that has nothing to do, every number being 0: compiles the kernel. Kernels return at once where
  // they are told of no work. Blocks.
  void launch_idle(cl::CommandQueue& queue);

 private:
  unsigned index_of(std::string_view name, KernelParameter::Kind kind);

  const Device& device_;
  std::string name_, file_, options_;
  std::filesystem::path mark_;  // CompileTurn's
  bool launched_ = false;
  cl::Kernel kernel_;
  std::vector<KernelParameter> parameters_;
  std::vector<bool> set_;
  std::size_t unset_ = 0;
};

}  // namespace gleaner::worker

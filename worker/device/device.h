#pragma once
// One OpenCL device: its context, what it is, and the programs built for it.

#include <filesystem>
#include <map>
#include <memory>
#include <mutex>
#include <string>
#include <thread>
#include <vector>

#include "worker/device/device_info.h"
#include "worker/device/kernel_compilers.h"
#include "worker/device/kernel_profile.h"
#include "worker/device/opencl.h"
#include "worker/device/program.h"

namespace gleaner::worker {

// Sets the environment variables that OpenCL drivers are to find, but for those that the user has set. A program calls
// it before it starts a thread: to set a new one moves what getenv() reads in another thread, which ends the process.
// What opens a device calls it as well.
void prepare_environment();

class Device {
 public:
  // Throws Error::failed where there is no such device. Where PoCL has compiled nothing yet, its compiler is made ready
  // beside whatever happens next.
  explicit Device(const DeviceChoice& choice);

  const DeviceInfo& info() const { return info_; }
  const cl::Context& context() const { return context_; }
  const cl::Device& device() const { return device_; }
  cl::CommandQueue make_queue() const {
    return cl::CommandQueue(context_, device_, profile_->on() ? CL_QUEUE_PROFILING_ENABLE : 0);
  }
  // Rays that a work-item handles at once (kernels/lanes.h).
  unsigned lanes() const { return info_.lanes; }
  KernelProfile& profile() const { return *profile_; }

  // Builds `file` of the kernels with `options`, once; a binary that an earlier run left is taken from the cache folder
  // ($GLEANER_CACHE, else $XDG_CACHE_HOME/gleaner, else ~/.cache/gleaner; PoCL has its own, $POCL_CACHE_DIR).
  // Thread-safe. Throws Error::failed with the compiler's log.
  Program build(const std::string& file, const std::string& options) const;

  // Says that this program will be built, some time later: where the device has compilers, they begin.
  void compile_ahead(const std::string& file, const std::string& options) const;
  // Null where the driver keeps no compiled kernels of its own, or no other process is to compile.
  KernelCompilers* compilers() const { return compilers_.get(); }

  // A buffer of at least one byte. On CPU devices it lies in memory that host and kernels share.
  cl::Buffer make_buffer(std::size_t bytes, cl_mem_flags flags = CL_MEM_READ_WRITE) const;

 private:
  std::string build_name(const std::string& text, const std::string& options) const;
  std::filesystem::path mark(const std::string& text, const std::string& options, const std::string& of) const;
  bool was_compiled(const std::string& text, const std::string& options) const;
  void remember_compiled(const std::string& text, const std::string& options) const;
  void ready_compiler();
  cl::Program compile(const std::string& file, const std::string& text, const std::string& options) const;

  DeviceInfo info_;
  std::unique_ptr<KernelProfile> profile_ = std::make_unique<KernelProfile>();
  mutable std::mutex programs_mutex_;
  mutable std::map<std::string, Program> programs_;  // by file and options
  cl::Device device_;
  cl::Context context_;
  std::unique_ptr<KernelCompilers> compilers_;
  std::jthread readying_;  // PoCL's compiler
};

// "clEnqueueNDRangeKernel failed: CL_OUT_OF_RESOURCES (-5)".
std::string describe(const cl::Error& error);

}  // namespace gleaner::worker

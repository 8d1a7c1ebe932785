#pragma once
// Which OpenCL devices there are, and which one a worker drives.

#include <cstdint>
#include <string>
#include <vector>

namespace gleaner::worker {

enum class TraceKind { automatic, embree, opencl };
TraceKind parse_trace_kind(const std::string& word);  // "auto", "embree", "opencl"; throws Error::usage
const char* trace_kind_name(TraceKind kind);

struct DeviceChoice {
  int device = -1;  // index in list_devices(); -1 = the first GPU, else the first device
  int threads = 0;  // CPU devices: kernels and tracing; 0 = all of the device's
  TraceKind trace = TraceKind::automatic;
  unsigned lanes = 0;  // things that a work-item does at once: 16 or 1; 0 = what suits the device
  // Starts a process that compiles kernels (worker/device/kernel_compilers.h); empty: this process alone compiles.
  std::vector<std::string> compiler{};
};

struct DeviceInfo {
  int index = 0;
  std::string name, platform, driver, version;
  bool cpu = false;
  unsigned compute_units = 0;
  unsigned threads = 0;  // as chosen
  unsigned lanes = 1;    // as chosen
  std::uint64_t memory_bytes = 0;
  TraceKind trace = TraceKind::automatic;  // what it traces with (never automatic)
  std::string tracer;                      // e.g. "Embree 3.13.5 (AVX512)" or "OpenCL BVH2"
  // Version of the library beside it that denoises; empty: none. A worker says so (worker/denoise).
  std::string denoiser{};
};

// What launches of one kernel took, by the device's own clock.
struct KernelTime {
  std::uint64_t launches = 0, work = 0;  // work: things that the launches had to do, e.g. rays
  double seconds = 0;
};

// All OpenCL devices; empty where there are none.
std::vector<DeviceInfo> list_devices();

}  // namespace gleaner::worker

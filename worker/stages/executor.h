#pragma once
// The face of the device library: one OpenCL device that runs batches of stages on scenes it holds.
// Needs OpenCL and, where built with it, Embree; neither gRPC nor protobuf.

#include <cstdint>
#include <map>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "scene/model/blob.h"
#include "scene/model/scene.h"
#include "worker/artifacts/artifact.h"

namespace gleaner::worker {

enum class TraceKind { automatic, embree, opencl };
TraceKind parse_trace_kind(const std::string& word);  // "auto", "embree", "opencl"; throws Error::usage
const char* trace_kind_name(TraceKind kind);

struct DeviceChoice {
  int device = -1;  // index in list_devices(); -1 = the first GPU, else the first device
  int threads = 0;  // CPU devices: kernels and tracing; 0 = all of the device's
  TraceKind trace = TraceKind::automatic;
};

struct DeviceInfo {
  int index = 0;
  std::string name, platform, driver, version;
  bool cpu = false;
  unsigned compute_units = 0;
  unsigned threads = 0;  // as chosen
  std::uint64_t memory_bytes = 0;
  TraceKind trace = TraceKind::automatic;  // what it traces with (never automatic)
  std::string tracer;                      // e.g. "Embree 3.13.5 (AVX512)" or "OpenCL BVH2"
};

// All OpenCL devices; empty where there are none.
std::vector<DeviceInfo> list_devices();

// What a batch is of: one stage of one frame. Bytes are little-endian structs of kernels/*_records.h.
struct StageTask {
  std::string kind;  // which stage program runs, e.g. "path"
  std::vector<std::byte> parameters;
  std::map<std::string, TaskInput> inputs;  // by the names the stage knows them by
  std::string scene;                        // id under which load_scene() was told of the scene
};

// What a batch cost. Seconds are wall time of the device's own clockwork, not summed over threads.
struct BatchCounters {
  std::uint64_t camera_rays = 0, scatter_rays = 0, shadow_rays = 0;
  std::uint64_t nonfinite = 0;                 // samples that were not finite and were left out
  std::vector<std::uint64_t> nonfinite_items;  // the first few of them
  double seconds = 0, trace_seconds = 0, kernel_seconds = 0;
};

struct BatchResult {
  scene::Bytes records;  // fixed stride: times the batch's count; counted: those of all its items in order
  std::vector<std::uint32_t> counts{};  // counted: records of each item
  scene::Bytes facts{};                 // solo stages: what the plan is told beside the records (at most 64 KiB)
  BatchCounters counters;
};

class Executor {
 public:
  // Throws Error::failed where there is no such OpenCL device or it cannot be opened.
  explicit Executor(const DeviceChoice& choice);
  ~Executor();
  Executor(const Executor&) = delete;
  Executor& operator=(const Executor&) = delete;

  const DeviceInfo& info() const;
  // Whether scenes must come with the BVH blob (it traces in OpenCL).
  bool needs_bvh() const;

  bool holds_scene(const std::string& id) const;
  // Uploads a scene; it stays until the cache's bound (least recently used first). `bvh` may be null where needs_bvh()
  // is false.
  void load_scene(const std::string& id, std::shared_ptr<const scene::Scene> scene,
                  std::shared_ptr<const scene::Bvh> bvh);

  // Runs items [first, first + count) of the stage. Throws Error::failed (device failures) or Error::bad_input (task).
  BatchResult run(const StageTask& task, std::uint64_t first, std::uint64_t count);

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace gleaner::worker

#pragma once
// A worker as the farm sees it: what it said of itself, what it is told, what its batches cost.

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "coordinator/schedule/scheduler.h"
#include "scene/model/blob.h"

namespace gleaner::coordinator {

struct DeviceDescription {
  std::string name, platform, driver, version, tracer;
  bool cpu = false;
  std::uint32_t compute_units = 0, threads = 0;
  std::uint64_t memory_bytes = 0;
};

struct WorkerHello {
  std::string name;     // wish; numbered where it is taken
  std::string address;  // as the gateway sees it
  DeviceDescription device;
  bool needs_bvh = false;
};

// What a batch cost, as its worker says. Seconds are wall time there.
struct BatchCost {
  double seconds = 0, trace_seconds = 0, kernel_seconds = 0;
  std::uint64_t camera_rays = 0, scatter_rays = 0, shadow_rays = 0;
  std::uint64_t nonfinite = 0;
  std::vector<std::uint64_t> nonfinite_items;  // the first few
  std::uint64_t fetched_bytes = 0;             // blobs that the worker fetched for this batch
};

// All that a worker must know of a stage: the same for each of its leases.
struct StageWork {
  struct Input {
    std::string name;
    std::string blob;  // id
  };
  std::string job, stage, kind;
  scene::Bytes parameters;
  std::vector<Input> inputs;
  std::uint32_t record_bytes = 0;
  std::string scene_blob, bvh_blob;  // ids
};

// The farm's way to one worker. Calls come with the farm locked: they queue what is to be said and return.
class WorkerSession {
 public:
  virtual ~WorkerSession() = default;
  virtual void welcome(const std::string& name) = 0;  // first of all
  virtual void lease(const Lease& lease, std::shared_ptr<const StageWork> work) = 0;
  virtual void revoke(const Lease& lease) = 0;
  virtual void drain() = 0;
  // The farm has given the worker up: nothing more is said, nothing more is heard.
  virtual void close(const std::string& reason) = 0;
};

}  // namespace gleaner::coordinator

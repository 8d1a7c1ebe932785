#pragma once
// What a batch is asked to do, and what it answers.

#include <atomic>
#include <cstdint>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include "worker/artifacts/artifact.h"

namespace gleaner::worker {

// What a batch is of: one stage of one frame. Bytes are little-endian structs of the kernels' record headers.
struct StageTask {
  std::string kind;  // which stage program runs, e.g. "path"
  std::vector<std::byte> parameters;
  std::map<std::string, TaskInput> inputs;  // by the names the stage knows them by
  std::string scene;                        // id under which load_scene() was told of the scene
  // Turns true where nobody wants the batch any more: run() then throws soon, between two waves of its host threads.
  // Null: it never does.
  std::shared_ptr<const std::atomic<bool>> given_up{};
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

}  // namespace gleaner::worker

#pragma once
// What the agent asks of whatever runs batches: the device library's Executor, or a test's own.

#include <memory>
#include <string>

#include "worker/stages/executor.h"

namespace gleaner::worker {

class Runner {
 public:
  virtual ~Runner() = default;
  virtual const DeviceInfo& info() const = 0;
  virtual bool needs_bvh() const = 0;
  virtual bool holds_scene(const std::string& id) const = 0;
  virtual void load_scene(const std::string& id, std::shared_ptr<const scene::Scene> scene,
                          std::shared_ptr<const scene::Bvh> bvh) = 0;
  // As Executor's.
  virtual bool holds_base(const std::string& id) const = 0;
  virtual void load_base(const std::string& id, std::shared_ptr<const scene::Scene> scene,
                         std::shared_ptr<const scene::Bvh> bvh) = 0;
  virtual MotionReport load_frame(const std::string& id, const std::string& base,
                                  const std::optional<scene::FrameState>& state) = 0;
  virtual BatchResult run(const StageTask& task, std::uint64_t first, std::uint64_t count) = 0;
};

// One OpenCL device. Throws Error::failed where it cannot be opened.
std::unique_ptr<Runner> open_device(const DeviceChoice& choice);

}  // namespace gleaner::worker

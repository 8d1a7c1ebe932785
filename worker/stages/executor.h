#pragma once
// The face of the device library: one OpenCL device that runs batches of stages on scenes it holds.
// Needs OpenCL and, where built with it, Embree; neither gRPC nor protobuf.

#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <string>

#include "scene/model/blob.h"
#include "scene/model/frame_state.h"
#include "scene/model/scene.h"
#include "worker/device/device_info.h"
#include "worker/trace/motion.h"
#include "worker/wavefront/stage_task.h"

namespace gleaner::worker {

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

  // A base that frames show in their states. It is kept as it came, beside others until a bound.
  bool holds_base(const std::string& id) const;
  void load_base(const std::string& id, std::shared_ptr<const scene::Scene> scene,
                 std::shared_ptr<const scene::Bvh> bvh);
  // The base as the state shows it becomes the scene `id`, kept as load_scene() does; another frame of the base may
  // have to give its place to it. Throws Error::bad_input where the state does not fit, Error::failed where the base is
  // not held. Tells what it took: nothing where the scene is held. No state: the base at rest, as its arrays have it.
  MotionReport load_frame(const std::string& id, const std::string& base,
                          const std::optional<scene::FrameState>& state);

  // From now on kernels are timed, at some cost; what those that ran since the last call took, by name.
  void profile_kernels();
  std::map<std::string, KernelTime> kernel_times();

  // Runs items [first, first + count) of the stage. Throws Error::failed (device failures) or Error::bad_input (task).
  BatchResult run(const StageTask& task, std::uint64_t first, std::uint64_t count);

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace gleaner::worker

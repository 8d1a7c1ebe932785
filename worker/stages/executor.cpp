#include "worker/stages/executor.h"

#include <list>
#include <map>

#include "scene/model/error.h"
#include "worker/device/device.h"
#include "worker/stages/cluster_stage.h"
#include "worker/stages/device_scene.h"
#include "worker/stages/path_stage.h"
#include "worker/stages/vpl_stages.h"

namespace gleaner::worker {
namespace {

using StageProgram = BatchResult (*)(const Device&, Workspace&, DeviceScene&, const StageTask&, std::uint64_t,
                                     std::uint64_t);

const std::map<std::string, StageProgram>& stage_programs() {
  static const std::map<std::string, StageProgram> programs = {
      {"path", run_path_stage},
      {"vpl_trace", run_vpl_trace_stage},
      {"vpl_cluster", run_cluster_stage},
      {"vpl_points", run_vpl_points_stage},
      {"point_cluster", run_cluster_stage},
      {"vpl_visibility", run_vpl_visibility_stage},
      {"vpl_shade", run_vpl_shade_stage},
  };
  return programs;
}

// Scenes kept warm: so many, and at most so much of the device's memory.
constexpr std::size_t kMostScenes = 4;

}  // namespace

struct Executor::Impl {
  explicit Impl(const DeviceChoice& choice) : device(choice), workspace(device) {}

  DeviceScene& scene(const std::string& id) {
    for (auto held = scenes.begin(); held != scenes.end(); ++held)
      if (held->first == id) {
        scenes.splice(scenes.begin(), scenes, held);
        return *scenes.front().second;
      }
    throw Error::failed("scene " + id + " was not loaded");
  }

  Device device;
  Workspace workspace;
  std::list<std::pair<std::string, std::unique_ptr<DeviceScene>>> scenes;  // the latest used first
};

Executor::Executor(const DeviceChoice& choice) {
  try {
    impl_ = std::make_unique<Impl>(choice);
  } catch (const cl::Error& error) {
    throw Error::failed("opening the OpenCL device: " + describe(error));
  }
}
Executor::~Executor() = default;

const DeviceInfo& Executor::info() const { return impl_->device.info(); }
bool Executor::needs_bvh() const { return impl_->device.info().trace == TraceKind::opencl; }

bool Executor::holds_scene(const std::string& id) const {
  for (auto& held : impl_->scenes)
    if (held.first == id) return true;
  return false;
}

void Executor::load_scene(const std::string& id, std::shared_ptr<const scene::Scene> scene,
                          std::shared_ptr<const scene::Bvh> bvh) {
  if (holds_scene(id)) return;
  try {
    auto loaded = std::make_unique<DeviceScene>(impl_->device, std::move(scene), bvh.get());
    impl_->scenes.emplace_front(id, std::move(loaded));
  } catch (const cl::Error& error) {
    throw Error::failed("loading scene " + id + " on " + info().name + ": " + describe(error));
  }
  std::size_t bytes = 0, kept = 0;
  for (auto held = impl_->scenes.begin(); held != impl_->scenes.end();) {
    bytes += held->second->bytes();
    if (kept >= 1 && (kept >= kMostScenes || bytes > info().memory_bytes / 2)) {
      held = impl_->scenes.erase(held);
    } else {
      ++kept;
      ++held;
    }
  }
}

BatchResult Executor::run(const StageTask& task, std::uint64_t first, std::uint64_t count) {
  auto program = stage_programs().find(task.kind);
  if (program == stage_programs().end()) throw Error::bad_input("stage", "kind", "one this worker knows", task.kind);
  try {
    return program->second(impl_->device, impl_->workspace, impl_->scene(task.scene), task, first, count);
  } catch (const cl::Error& error) {
    throw Error::failed("stage " + task.kind + ", items " + std::to_string(first) + " + " + std::to_string(count) +
                        ", on " + info().name + ": " + describe(error));
  } catch (const std::bad_alloc&) {
    throw Error::failed("stage " + task.kind + ": out of memory");
  }
}

}  // namespace gleaner::worker

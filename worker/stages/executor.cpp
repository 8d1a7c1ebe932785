#include "worker/stages/executor.h"

#include <algorithm>
#include <list>
#include <set>

#ifdef GLEANER_WITH_EMBREE
#include "scene/bvh/build.h"
#endif
#include "scene/model/error.h"
#include "worker/stages/stage_table.h"

namespace gleaner::worker {
namespace {

// Scenes kept warm: so many, and at most so much of the device's memory.
constexpr std::size_t kMostScenes = 4;
// Bases lie in the host's memory.
constexpr std::size_t kMostBases = 2;

// Of the device's memory, what stays taken between batches, and what tables may take.
std::size_t most_workspace(const DeviceInfo& info) { return info.memory_bytes / 8; }
std::size_t most_tables(const DeviceInfo& info) {
  return static_cast<std::size_t>(std::min<std::uint64_t>(info.memory_bytes / 16, std::uint64_t{512} << 20));
}

scene::Bvh rebuilt_bvh([[maybe_unused]] const scene::Scene& scene) {
#ifdef GLEANER_WITH_EMBREE
  return scene::build_bvh(scene);
#else
  throw Error::failed("a scene that moves needs a new BVH in each frame, and this program was built without Embree");
#endif
}

}  // namespace

struct Executor::Impl {
  explicit Impl(const DeviceChoice& choice)
      : device(choice), workspace(device, most_workspace(device.info())), tables(most_tables(device.info())) {}

  DeviceScene& scene(const std::string& id) {
    for (auto held = scenes.begin(); held != scenes.end(); ++held)
      if (held->first == id) {
        scenes.splice(scenes.begin(), scenes, held);
        return *scenes.front().second;
      }
    throw Error::failed("scene " + id + " was not loaded");
  }

  // Once for each kind and variant of the kernels: scenes of the same needs share their programs.
  void compile_later(const StageKind& kind, const std::string& scene_id) {
    if (kind.later.empty()) return;
    const std::string& variant = scene(scene_id).kernel_options();
    if (!asked_ahead.emplace(variant, kind.kind).second) return;
    for (const LaterProgram& one : kind.later)
      device.compile_ahead(std::string(one.file),
                           (one.plain ? plain_options(device) : variant) + std::string(one.options));
  }

  Device device;
  Workspace workspace;
  KeptTables tables;
  struct Base {
    std::string id;
    std::shared_ptr<const scene::Scene> scene;
    std::shared_ptr<const scene::Bvh> bvh;
  };

  std::list<std::pair<std::string, std::unique_ptr<DeviceScene>>> scenes;  // the latest used first
  std::list<Base> bases;                                                   // alike
  std::set<std::pair<std::string, std::string_view>> asked_ahead;
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

bool Executor::holds_base(const std::string& id) const {
  return std::ranges::any_of(impl_->bases, [&](const Impl::Base& base) { return base.id == id; });
}

void Executor::load_base(const std::string& id, std::shared_ptr<const scene::Scene> scene,
                         std::shared_ptr<const scene::Bvh> bvh) {
  if (holds_base(id)) return;
  impl_->bases.push_front({id, std::move(scene), std::move(bvh)});
  if (impl_->bases.size() > kMostBases) impl_->bases.pop_back();
}

void Executor::load_frame(const std::string& id, const std::string& base_id, const scene::FrameState& state) {
  if (holds_scene(id)) return;
  const auto base = std::ranges::find(impl_->bases, base_id, &Impl::Base::id);
  if (base == impl_->bases.end()) throw Error::failed("base " + base_id + " was not loaded");
  impl_->bases.splice(impl_->bases.begin(), impl_->bases, base);
  auto scene = std::make_shared<const scene::Scene>(scene::posed(*base->scene, state, "scene " + id));
  std::shared_ptr<const scene::Bvh> bvh = base->bvh;
  if (needs_bvh() && !base->scene->rig.empty()) bvh = std::make_shared<const scene::Bvh>(rebuilt_bvh(*scene));
  load_scene(id, std::move(scene), std::move(bvh));
}

void Executor::profile_kernels() { impl_->device.profile().turn_on(); }
std::map<std::string, KernelTime> Executor::kernel_times() { return impl_->device.profile().take(); }

BatchResult Executor::run(const StageTask& task, std::uint64_t first, std::uint64_t count) {
  const StageKind& kind = stage_kind_of(task);
  const StageRun batch{.device = impl_->device,
                       .workspace = impl_->workspace,
                       .tables = impl_->tables,
                       .scene = impl_->scene(task.scene),
                       .task = task,
                       .programs = kind.programs,
                       .first = first,
                       .count = count};
  impl_->compile_later(kind, task.scene);
  try {
    BatchResult result = kind.run(batch);
    impl_->workspace.end_batch();
    return result;
  } catch (const cl::Error& error) {
    throw Error::failed("stage " + task.kind + ", items " + std::to_string(first) + " + " + std::to_string(count) +
                        ", on " + info().name + ": " + describe(error));
  } catch (const std::bad_alloc&) {
    throw Error::failed("stage " + task.kind + ": out of memory");
  }
}

}  // namespace gleaner::worker

#include "worker/stages/executor.h"

#include <algorithm>
#include <list>
#include <optional>
#include <set>

#include "scene/model/error.h"
#include "worker/stages/stage_table.h"
#include "worker/wavefront/counters.h"
#include "worker/wavefront/host_threads.h"
#include "worker/wavefront/wanted.h"

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

}  // namespace

struct Executor::Impl {
  explicit Impl(const DeviceChoice& choice)
      : device(choice), workspace(device, most_workspace(device.info())), tables(most_tables(device.info())) {}

  DeviceScene& scene(const std::string& id) {
    const auto held = std::ranges::find(scenes, id, &HeldScene::id);
    if (held == scenes.end()) throw Error::failed("scene " + id + " was not loaded");
    scenes.splice(scenes.begin(), scenes, held);
    return *scenes.front().on_device;
  }

  // Once for each kind and variant of the kernels: scenes of the same needs share their programs.
  void compile_later(const StageKind& kind, const std::string& scene_id) {
    if (kind.later.empty()) return;
    const DeviceScene& shown = scene(scene_id);
    const std::string& variant = shown.kernel_options();
    if (!asked_ahead.emplace(variant, kind.kind).second) return;
    for (const LaterProgram& one : kind.later) {
      const std::string options = one.layout        ? plain_options(device) + shown.layout_options()
                                  : one.plain       ? plain_options(device)
                                  : one.reads_light ? variant
                                                    : shown.surface_options();
      device.compile_ahead(std::string(one.file), options + std::string(one.options));
    }
  }

  struct HeldScene {
    std::string id, base;  // base: empty where the scene is none's frame
    std::unique_ptr<DeviceScene> on_device;
    std::unique_ptr<scene::PosedScene> posed;  // of a base's
  };
  struct Base {
    std::string id;
    std::shared_ptr<const scene::Scene> scene;
    std::shared_ptr<const scene::Bvh> bvh;
    std::list<std::string> displaced;  // frames that others took the place of, the latest first
  };

  void drop_beyond_bounds();
  std::list<HeldScene>::iterator place_of_frame(Base& base, const std::string& id);

  Device device;
  Workspace workspace;
  KeptTables tables;
  std::list<HeldScene> scenes;  // the latest used first
  std::list<Base> bases;        // alike
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
  return std::ranges::any_of(impl_->scenes, [&](const Impl::HeldScene& held) { return held.id == id; });
}

void Executor::load_scene(const std::string& id, std::shared_ptr<const scene::Scene> scene,
                          std::shared_ptr<const scene::Bvh> bvh) {
  if (holds_scene(id)) return;
  try {
    auto loaded = std::make_unique<DeviceScene>(impl_->device, std::move(scene), bvh.get());
    impl_->scenes.push_front({.id = id, .base = {}, .on_device = std::move(loaded), .posed = nullptr});
  } catch (const cl::Error& error) {
    throw Error::failed("loading scene " + id + " on " + info().name + ": " + describe(error));
  }
  impl_->drop_beyond_bounds();
}

void Executor::Impl::drop_beyond_bounds() {
  std::size_t bytes = 0, kept = 0;
  for (auto held = scenes.begin(); held != scenes.end();) {
    bytes += held->on_device->bytes();
    if (kept >= 1 && (kept >= kMostScenes || bytes > device.info().memory_bytes / 2)) {
      held = scenes.erase(held);
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
  impl_->bases.push_front({id, std::move(scene), std::move(bvh), {}});
  if (impl_->bases.size() > kMostBases) impl_->bases.pop_back();
}

// A frame takes the place of the base's frame that was not asked for longest. Where frames come back after others took
// their places, as those of a job that run side by side do, the base gets one more place, built at rest.
std::list<Executor::Impl::HeldScene>::iterator Executor::Impl::place_of_frame(Base& base, const std::string& id) {
  auto place = scenes.end();
  std::size_t places = 0;
  for (auto held = scenes.begin(); held != scenes.end(); ++held)
    if (held->base == base.id) place = held, ++places;
  const bool comes_back = std::ranges::find(base.displaced, id) != base.displaced.end();
  if (place != scenes.end() && !(comes_back && places < kMostScenes)) {
    std::erase(base.displaced, id);
    base.displaced.push_front(place->id);
    if (base.displaced.size() > kMostScenes) base.displaced.pop_back();
    place->id.clear();
    scenes.splice(scenes.begin(), scenes, place);
    return place;
  }
  auto loaded = std::make_unique<DeviceScene>(device, base.scene, base.bvh.get());
  scenes.push_front({.id = {},
                     .base = base.id,
                     .on_device = std::move(loaded),
                     .posed = std::make_unique<scene::PosedScene>(base.scene)});
  return scenes.begin();
}

MotionReport Executor::load_frame(const std::string& id, const std::string& base_id,
                                  const std::optional<scene::FrameState>& state) {
  if (holds_scene(id)) return {};
  const auto base = std::ranges::find(impl_->bases, base_id, &Impl::Base::id);
  if (base == impl_->bases.end()) throw Error::failed("base " + base_id + " was not loaded");
  impl_->bases.splice(impl_->bases.begin(), impl_->bases, base);
  std::optional<std::list<Impl::HeldScene>::iterator> place;
  try {
    const double start = seconds_now();
    const std::size_t held = impl_->scenes.size();
    place = impl_->place_of_frame(*base, id);
    const double placed = seconds_now();
    scene::PosedScene& shown = *(*place)->posed;
    const scene::PosedScene::Changes changes =
        state ? shown.show(*state, "scene " + id, host_threads(impl_->device)) : shown.show_rest();
    const double posed = seconds_now();
    MotionReport report = (*place)->on_device->show(shown.scene(), changes.meshes);
    report.load_seconds = impl_->scenes.size() > held ? placed - start : 0;
    report.pose_seconds = posed - placed;
    (*place)->id = id;
    impl_->drop_beyond_bounds();
    return report;
  } catch (...) {
    // Half of it may show another frame.
    if (place) impl_->scenes.erase(*place);
    try {
      throw;
    } catch (const cl::Error& error) {
      throw Error::failed("loading scene " + id + " on " + info().name + ": " + describe(error));
    }
  }
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
                       .reads_light = kind.reads_light,
                       .first = first,
                       .count = count};
  impl_->compile_later(kind, task.scene);
  const WantedScope wanted(task.given_up.get());
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

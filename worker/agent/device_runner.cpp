#include "scene/model/error.h"
#include "worker/agent/runner.h"
#include "worker/denoise/denoiser.h"

namespace gleaner::worker {

namespace {

// A worker without the library does all else.
std::string denoiser_or_none() {
  try {
    return denoiser_version();
  } catch (const Error&) {
    return {};
  }
}

class DeviceRunner final : public Runner {
 public:
  explicit DeviceRunner(const DeviceChoice& choice) : executor_(choice), info_(executor_.info()) {
    info_.denoiser = denoiser_or_none();
  }
  const DeviceInfo& info() const override { return info_; }
  bool needs_bvh() const override { return executor_.needs_bvh(); }
  bool holds_scene(const std::string& id) const override { return executor_.holds_scene(id); }
  void load_scene(const std::string& id, std::shared_ptr<const scene::Scene> scene,
                  std::shared_ptr<const scene::Bvh> bvh) override {
    executor_.load_scene(id, std::move(scene), std::move(bvh));
  }
  bool holds_base(const std::string& id) const override { return executor_.holds_base(id); }
  void load_base(const std::string& id, std::shared_ptr<const scene::Scene> scene,
                 std::shared_ptr<const scene::Bvh> bvh) override {
    executor_.load_base(id, std::move(scene), std::move(bvh));
  }
  MotionReport load_frame(const std::string& id, const std::string& base,
                          const std::optional<scene::FrameState>& state) override {
    return executor_.load_frame(id, base, state);
  }
  BatchResult run(const StageTask& task, std::uint64_t first, std::uint64_t count) override {
    return executor_.run(task, first, count);
  }

 private:
  Executor executor_;
  DeviceInfo info_;
};

}  // namespace

std::unique_ptr<Runner> open_device(const DeviceChoice& choice) { return std::make_unique<DeviceRunner>(choice); }

}  // namespace gleaner::worker

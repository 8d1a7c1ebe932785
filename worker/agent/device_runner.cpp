#include "worker/agent/runner.h"

namespace gleaner::worker {

namespace {

class DeviceRunner final : public Runner {
 public:
  explicit DeviceRunner(const DeviceChoice& choice) : executor_(choice) {}
  const DeviceInfo& info() const override { return executor_.info(); }
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
  MotionReport load_frame(const std::string& id, const std::string& base, const scene::FrameState& state) override {
    return executor_.load_frame(id, base, state);
  }
  BatchResult run(const StageTask& task, std::uint64_t first, std::uint64_t count) override {
    return executor_.run(task, first, count);
  }

 private:
  Executor executor_;
};

}  // namespace

std::unique_ptr<Runner> open_device(const DeviceChoice& choice) { return std::make_unique<DeviceRunner>(choice); }

}  // namespace gleaner::worker

#pragma once
// Small path-traced pictures through the worker's executor, from the bytes of a scene's blob, as a worker gets them.

#include <gtest/gtest.h>

#include <cmath>
#include <cstring>
#include <memory>
#include <string>
#include <vector>

#include "kernels/path_records.h"
#include "scene/bvh/build.h"
#include "scene/model/blob.h"
#include "tests/numerics/tracing.h"
#include "worker/stages/executor.h"

namespace gleaner::test {

struct Shot {
  std::uint32_t width = 16, height = 16, samples = 4, depth = 0;  // samples: a power of two
};

struct Picture {
  std::vector<kernels::PathFeatureRecord> records;  // sums over the samples, a pixel each
  worker::BatchCounters counters;

  // Means of the samples' radiance.
  std::vector<double> radiance(std::uint32_t samples) const {
    std::vector<double> result;
    for (const auto& r : records)
      for (int c = 0; c < 3; ++c)
        result.push_back((static_cast<double>(r.direct[c]) + static_cast<double>(r.indirect[c])) / samples);
    return result;
  }
};

inline kernels::PathParameters path_parameters(const scene::Camera& camera, const Shot& shot) {
  kernels::PathParameters p{};
  p.camera = camera;
  p.width = shot.width;
  p.height = shot.height;
  p.samples_per_item = p.last_item_samples = shot.samples;
  p.depth = shot.depth;
  p.seed_low = 12;
  p.features = 1;
  p.items_low = shot.width * shot.height;
  return p;
}

class Renderer {
 public:
  explicit Renderer(worker::TraceKind kind) : executor_(choice(kind)) {}

  // Throws gleaner::Error where the scene is refused or the device fails.
  Picture render(const scene::Scene& scene, const scene::Camera& camera, const Shot& shot) {
    const scene::Bytes blob = scene::serialize(scene);
    auto parsed = std::make_shared<scene::Scene>(scene::parse_scene(blob, scene.name));
    std::shared_ptr<scene::Bvh> bvh;
    if (executor_.needs_bvh()) bvh = std::make_shared<scene::Bvh>(scene::build_bvh(*parsed));
    const std::string id = scene.name + " " + std::to_string(loaded_++);
    executor_.load_scene(id, parsed, bvh);
    return run(id, path_parameters(camera, shot));
  }

  Picture run(const std::string& id, const kernels::PathParameters& p) {
    worker::StageTask task{.kind = "path", .parameters = {}, .inputs = {}, .scene = id};
    task.parameters.resize(sizeof p);
    std::memcpy(task.parameters.data(), &p, sizeof p);
    const std::uint64_t items = std::uint64_t{p.width} * p.height;
    worker::BatchResult result = executor_.run(task, 0, items);
    Picture picture{std::vector<kernels::PathFeatureRecord>(items), result.counters};
    std::memcpy(picture.records.data(), result.records.data(), result.records.size());
    return picture;
  }

  worker::Executor& executor() { return executor_; }

 private:
  static worker::DeviceChoice choice(worker::TraceKind kind) {
    worker::DeviceChoice choice{.device = -1, .threads = 1, .trace = kind};
    if (kind == worker::TraceKind::embree)
      for (const auto& info : worker::list_devices())
        if (info.trace == kind) choice.device = info.index;
    return choice;
  }

  worker::Executor executor_;
  unsigned loaded_ = 0;
};

// A test that renders with Embree and with the OpenCL tracer.
class WithRenderer : public WithTracer {
 protected:
  void SetUp() override {
    WithTracer::SetUp();
    if (device_) renderer_ = std::make_unique<Renderer>(GetParam());
  }
  std::unique_ptr<Renderer> renderer_;
};

}  // namespace gleaner::test

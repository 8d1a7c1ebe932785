#pragma once
// Tests' way to a picture: stage `path` of the Executor, with nothing between the records and the test.

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cstdio>
#include <cstring>
#include <filesystem>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include "coordinator/film/write.h"
#include "kernels/path_records.h"
#include "scene/bvh/build.h"
#include "scene/model/scene.h"
#include "tests/radiometry/statistics.h"
#include "worker/stages/executor.h"

namespace gleaner::test {

using scene::Scene;

struct Shot {
  std::shared_ptr<const Scene> scene;
  scene::Camera camera{};  // half_width is made to fit the size
  std::uint32_t width = 32, height = 32;
  // A chunk's samples of one pixel. Each chunk is of a sequence of its own: chunks are independent.
  std::uint32_t samples = 16, chunks = 4;
  std::uint32_t depth = 0;
  std::uint64_t seed = 1;
  worker::TraceKind trace = worker::TraceKind::automatic;
};

// Radiance meant over each pixel's chunk: [chunk][pixel][channel].
struct Picture {
  std::uint32_t width = 0, height = 0, chunks = 0;
  std::vector<float> direct, indirect;
  worker::BatchCounters counters;

  std::size_t pixels() const { return std::size_t{width} * height; }
  double at(std::uint32_t chunk, std::size_t pixel, int channel) const {
    const std::size_t i = (chunk * pixels() + pixel) * 3 + static_cast<std::size_t>(channel);
    return static_cast<double>(direct[i]) + indirect[i];
  }
  Sample pixel(std::size_t index, int channel) const {
    Sample sample;
    for (std::uint32_t c = 0; c < chunks; ++c) sample.add(at(c, index, channel));
    return sample;
  }
  // The mean over a rectangle of pixels: one value a chunk is added.
  void add_means(Sample& sample, std::uint32_t x0, std::uint32_t y0, std::uint32_t x1, std::uint32_t y1,
                 int channel) const {
    for (std::uint32_t c = 0; c < chunks; ++c) {
      double sum = 0;
      for (std::uint32_t y = y0; y < y1; ++y)
        for (std::uint32_t x = x0; x < x1; ++x) sum += at(c, std::size_t{y} * width + x, channel);
      sample.add(sum / (static_cast<double>(x1 - x0) * (y1 - y0)));
    }
  }
  Sample mean(int channel = 0) const {
    Sample sample;
    add_means(sample, 0, 0, width, height, channel);
    return sample;
  }
};

inline kernels::PathParameters parameters_of(const Shot& shot) {
  kernels::PathParameters p{};
  p.camera = shot.camera;
  p.camera.half_width = shot.camera.half_height * static_cast<float>(shot.width) / static_cast<float>(shot.height);
  p.width = shot.width;
  p.height = shot.height;
  p.samples_per_item = p.last_item_samples = shot.samples;
  p.depth = shot.depth;
  p.seed_low = static_cast<std::uint32_t>(shot.seed);
  p.seed_high = static_cast<std::uint32_t>(shot.seed >> 32);
  const std::uint64_t items = std::uint64_t{shot.width} * shot.height * shot.chunks;
  p.items_low = static_cast<std::uint32_t>(items);
  p.items_high = static_cast<std::uint32_t>(items >> 32);
  return p;
}

inline worker::StageTask task_of(const kernels::PathParameters& parameters, const std::string& scene) {
  worker::StageTask task;
  task.kind = "path";
  task.parameters.resize(sizeof parameters);
  std::memcpy(task.parameters.data(), &parameters, sizeof parameters);
  task.scene = scene;
  return task;
}

// All pixels of the first chunk, of the second, ...: the first chunks of the pixels' sequences.
inline std::shared_ptr<const scene::Bytes> list_of(const Shot& shot) {
  const std::uint32_t pixels = shot.width * shot.height, turns = GLEANER_PATH_SEQUENCE / shot.samples;
  auto list = std::make_shared<scene::Bytes>(std::size_t{pixels} * shot.chunks * sizeof(kernels::PathItem));
  auto* item = reinterpret_cast<kernels::PathItem*>(list->data());
  for (std::uint32_t c = 0; c < shot.chunks; ++c)
    for (std::uint32_t pixel = 0; pixel < pixels; ++pixel) *item++ = {pixel, c % 2 + c / 2 * 2 * turns};
  return list;
}

// One executor of one thread for each way to trace.
inline worker::Executor& executor(worker::TraceKind trace) {
  static std::map<worker::TraceKind, std::unique_ptr<worker::Executor>> executors;
  auto& held = executors[trace];
  if (!held) {
    worker::DeviceChoice choice;
    choice.threads = 1;
    choice.trace = trace;
    held = std::make_unique<worker::Executor>(choice);
  }
  return *held;
}

// Loads the scene under a name of its own.
inline std::string load(worker::Executor& on, const std::shared_ptr<const Scene>& scene) {
  static int loaded = 0;
  const std::string id = scene->name + "#" + std::to_string(++loaded);
  std::shared_ptr<const scene::Bvh> bvh;
  if (on.needs_bvh()) bvh = std::make_shared<const scene::Bvh>(scene::build_bvh(*scene));
  on.load_scene(id, scene, bvh);
  return id;
}

// Runs a task of the shot's items.
inline Picture run(const Shot& shot, const worker::StageTask& task) {
  const std::uint64_t items = std::uint64_t{shot.width} * shot.height * shot.chunks;
  const worker::BatchResult result = executor(shot.trace).run(task, 0, items);
  Picture picture{shot.width, shot.height, shot.chunks, {}, {}, result.counters};
  picture.direct.resize(items * 3);
  picture.indirect.resize(items * 3);
  const float scale = 1.0f / static_cast<float>(shot.samples);
  for (std::uint64_t i = 0; i < items; ++i) {
    kernels::PathRecord record;
    std::memcpy(&record, result.records.data() + i * sizeof record, sizeof record);
    for (int k = 0; k < 3; ++k) {
      picture.direct[3 * i + k] = record.direct[k] * scale;
      picture.indirect[3 * i + k] = record.indirect[k] * scale;
    }
  }
  EXPECT_EQ(result.counters.nonfinite, 0u);
  return picture;
}

inline Picture shoot(const Shot& shot) {
  worker::StageTask task = task_of(parameters_of(shot), load(executor(shot.trace), shot.scene));
  task.inputs["items"] = list_of(shot);
  return run(shot, task);
}

// The camera of that name, else the scene's first.
inline scene::Camera camera_of(const Scene& scene, const std::string& name = {}) {
  for (const auto& camera : scene.cameras)
    if (camera.name == name) return camera.camera;
  return scene.cameras.at(0).camera;
}

// An orthographic camera whose axes are `right`, `up` and their cross product's opposite.
inline scene::Camera orthographic(std::array<double, 3> origin, std::array<double, 3> right, std::array<double, 3> up,
                                  double half_height) {
  scene::Camera camera{};
  camera.type = GLEANER_CAMERA_ORTHOGRAPHIC;
  camera.half_width = camera.half_height = static_cast<float>(half_height);
  for (int k = 0; k < 3; ++k) {
    camera.origin[k] = static_cast<float>(origin[k]);
    camera.right[k] = static_cast<float>(right[k]);
    camera.up[k] = static_cast<float>(up[k]);
    camera.forward[k] = static_cast<float>(up[(k + 1) % 3] * right[(k + 2) % 3] - up[(k + 2) % 3] * right[(k + 1) % 3]);
  }
  return camera;
}

// What failed, as EXR (the mean over the chunks), and the command that runs the test again.
inline void keep_failure(const Picture& picture, const std::string& name) {
  const auto* test = ::testing::UnitTest::GetInstance()->current_test_info();
  const std::filesystem::path folder = std::filesystem::temp_directory_path() / "gleaner-failures";
  std::filesystem::create_directories(folder);
  coordinator::Film film{picture.width, picture.height, {}};
  for (int k = 0; k < 3; ++k) {
    auto& values = film.channel(std::string(1, "RGB"[k])).values;
    for (std::size_t i = 0; i < picture.pixels(); ++i) values[i] = static_cast<float>(picture.pixel(i, k).mean);
  }
  std::string file = std::string(test->test_suite_name()) + "." + name + ".exr";
  std::replace(file.begin(), file.end(), '/', '_');  // of a suite that is instantiated
  const std::string path = (folder / file).string();
  coordinator::write_exr(film, {}, path);
  std::printf("wrote %s; again: --gtest_filter=%s.%s\n", path.c_str(), test->test_suite_name(), test->name());
}

// Is `expected` the mean of what these values are drawn from? Two-sided t-test. `allowance` is what the expected value
// itself may be off by; `noise` is the largest relative standard error with which the test still says something.
inline bool expect_mean(const Sample& sample, double expected, const std::string& what, double level, double noise,
                        double allowance = 0) {
  const double error = std::max(sample.standard_error(), 1e-7 * std::abs(expected));
  const double off = std::max(0.0, std::abs(sample.mean - expected) - allowance);
  const double t = off / error;
  const double p = student_p(t, static_cast<double>(std::max<std::size_t>(sample.count, 2) - 1));
  std::printf("  %-44s %.6f +- %.6f, expected %.6f%s, t = %.2f, p = %.4f\n", what.c_str(), sample.mean,
              sample.standard_error(), expected, allowance > 0 ? (" +- " + std::to_string(allowance)).c_str() : "", t,
              p);
  EXPECT_GE(p, level) << what << ": mean " << sample.mean << " +- " << sample.standard_error() << " of " << sample.count
                      << " values, expected " << expected;
  EXPECT_LE(sample.standard_error(), noise * std::abs(expected)) << what << ": too noisy to prove anything";
  return p >= level;
}

}  // namespace gleaner::test

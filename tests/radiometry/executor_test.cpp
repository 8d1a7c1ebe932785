// One item's record depends on the item alone: not on batches, threads, repetitions or neighbours in the list. And what
// traces the rays does not show in the picture.

#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstring>
#include <random>
#include <set>
#include <string>

#include "scene/library/library.h"
#include "tests/radiometry/shot.h"
#include "worker/device/device.h"

namespace gleaner::test {
namespace {

constexpr double kFamily = 1e-3;

std::unique_ptr<worker::Executor> executor_of(unsigned threads,
                                              worker::TraceKind trace = worker::TraceKind::automatic) {
  worker::DeviceChoice choice;
  choice.threads = static_cast<int>(threads);
  choice.trace = trace;
  return std::make_unique<worker::Executor>(choice);
}

std::shared_ptr<const Scene> made(const std::string& name) {
  return std::make_shared<const Scene>(scene::make_scene(name));
}

// Its shadow rays go on through a cut-out, turn by turn.
std::shared_ptr<const Scene> made_with_alpha() {
  Scene scene = scene::make_scene("cornell-textured");
  scene::Light light = scene::make_scene("furnace-point").lights.at(0);
  for (int k = 0; k < 3; ++k) light.position[k] = camera_of(scene).origin[k];
  scene.lights.push_back(light);
  return std::make_shared<const Scene>(std::move(scene));
}

// Runs the items by batches that end at `cuts`, the last ones first.
scene::Bytes run_in_batches(worker::Executor& on, const worker::StageTask& task, std::uint64_t items,
                            std::vector<std::uint64_t> cuts, std::size_t stride) {
  cuts.insert(cuts.begin(), 0);
  cuts.push_back(items);
  scene::Bytes all(items * stride);
  for (std::size_t k = cuts.size() - 1; k > 0; --k) {
    if (cuts[k] == cuts[k - 1]) continue;
    const auto result = on.run(task, cuts[k - 1], cuts[k] - cuts[k - 1]);
    EXPECT_EQ(result.records.size(), (cuts[k] - cuts[k - 1]) * stride);
    std::copy(result.records.begin(), result.records.end(),
              all.begin() + static_cast<std::ptrdiff_t>(cuts[k - 1] * stride));
  }
  return all;
}

// First item whose bytes differ, or -1.
std::ptrdiff_t first_difference(const scene::Bytes& a, const scene::Bytes& b, std::size_t stride) {
  if (a.size() != b.size()) return 0;
  const auto [at, other] = std::mismatch(a.begin(), a.end(), b.begin());
  return at == a.end() ? -1 : (at - a.begin()) / static_cast<std::ptrdiff_t>(stride);
}

class SameBits : public ::testing::TestWithParam<worker::TraceKind> {};
INSTANTIATE_TEST_SUITE_P(Tracers, SameBits, ::testing::Values(worker::TraceKind::automatic, worker::TraceKind::opencl),
                         [](const auto& p) { return p.param == worker::TraceKind::opencl ? "OpenCL" : "Default"; });

TEST_P(SameBits, WhereverBatchesAreCut) {
  for (const std::uint32_t samples : {1u, 4u, 16u}) {
    Shot shot{.scene = made("cornell-box"), .width = 9, .height = 7, .samples = samples, .chunks = 3};
    shot.camera = camera_of(*shot.scene);
    auto on = executor_of(1, GetParam());
    kernels::PathParameters p = parameters_of(shot);
    p.last_item_samples = std::max(1u, samples / 2);
    const worker::StageTask task = task_of(p, load(*on, shot.scene));
    const std::uint64_t items = 9 * 7 * 3, tile = std::max(1u, 16 / samples);
    constexpr std::size_t stride = sizeof(kernels::PathRecord);
    const scene::Bytes whole = run_in_batches(*on, task, items, {}, stride);
    EXPECT_NE(std::count_if(whole.begin(), whole.end(), [](std::byte b) { return b != std::byte{0}; }), 0);
    std::vector<std::uint64_t> every, some;
    for (std::uint64_t i = tile; i < items; i += tile) every.push_back(i);
    std::mt19937 random(7);
    std::sample(every.begin(), every.end(), std::back_inserter(some), 5, random);
    EXPECT_EQ(first_difference(whole, run_in_batches(*on, task, items, every, stride), stride), -1)
        << samples << " samples an item, one tile a batch";
    EXPECT_EQ(first_difference(whole, run_in_batches(*on, task, items, some, stride), stride), -1)
        << samples << " samples an item, five cuts";
    EXPECT_EQ(first_difference(whole, run_in_batches(*on, task, items, {}, stride), stride), -1) << "once more";
  }
}

TEST_P(SameBits, HoweverManyThreads) {
  for (const auto& scene : {made("cornell-box"), made_with_alpha()}) {
    // Several waves a thread: their sizes differ with the threads, and who is beside whom.
    Shot shot{.scene = scene, .width = 40, .height = 30, .samples = 16, .chunks = 4};
    shot.camera = camera_of(*shot.scene);
    const std::uint64_t items = 40 * 30 * 4;
    scene::Bytes first;
    for (const unsigned threads : {1u, 2u, 3u, 7u}) {
      auto on = executor_of(threads, GetParam());
      const worker::StageTask task = task_of(parameters_of(shot), load(*on, shot.scene));
      const scene::Bytes records = on->run(task, 0, items).records;
      if (first.empty()) first = records;
      EXPECT_EQ(first_difference(first, records, sizeof(kernels::PathRecord)), -1)
          << threads << " threads, " << scene->name;
    }
  }
}

// A list names each item's pixel and chunk: in any order the records are those of the plain run.
// A variable that is new makes the list of all move, and whoever reads it in another thread ends the process. By itself
// this test is the first that opens a device; behind others it says nothing.
TEST(Executor, OpeningADeviceAddsNothingToTheEnvironment) {
  const auto names = [] {
    std::set<std::string> found;
    for (char** variable = environ; *variable; ++variable)
      found.insert(std::string(*variable, std::strcspn(*variable, "=")));
    return found;
  };
  worker::prepare_environment();
  const std::set<std::string> before = names();
  executor_of(1);
  EXPECT_EQ(names(), before);
}

TEST(Items, MayBeListedInAnyOrder) {
  Shot shot{.scene = made("cornell-box"), .width = 8, .height = 8, .samples = 16, .chunks = 2};
  shot.camera = camera_of(*shot.scene);
  auto on = executor_of(1);
  worker::StageTask task = task_of(parameters_of(shot), load(*on, shot.scene));
  const scene::Bytes plain = on->run(task, 0, 128).records;
  std::vector<kernels::PathItem> items;
  for (std::uint32_t i = 0; i < 128; ++i) items.push_back({i % 64, i / 64});
  std::shuffle(items.begin(), items.end(), std::mt19937(11));
  auto list = std::make_shared<scene::Bytes>(items.size() * sizeof items[0]);
  std::memcpy(list->data(), items.data(), list->size());
  task.inputs["items"] = list;
  const scene::Bytes listed = on->run(task, 0, 128).records;
  constexpr std::size_t stride = sizeof(kernels::PathRecord);
  for (std::size_t i = 0; i < items.size(); ++i)
    EXPECT_EQ(std::memcmp(&listed[i * stride], &plain[(items[i].chunk * 64 + items[i].pixel) * stride], stride), 0)
        << "pixel " << items[i].pixel << ", chunk " << items[i].chunk;
}

// Chunks of one sequence go on where the last one ended: four of 4 samples are one of 16.
TEST(Items, OfOneSequenceGoOn) {
  Shot shot{.scene = made("cornell-box"), .width = 8, .height = 8, .samples = 16, .chunks = 2};
  shot.camera = camera_of(*shot.scene);
  auto on = executor_of(1);
  const std::string id = load(*on, shot.scene);
  const scene::Bytes large = on->run(task_of(parameters_of(shot), id), 0, 64 * 2).records;
  shot.samples = 4;
  shot.chunks = 8;
  const scene::Bytes small = on->run(task_of(parameters_of(shot), id), 0, 64 * 8).records;
  const auto record = [](const scene::Bytes& all, std::size_t i) {
    kernels::PathRecord r;
    std::memcpy(&r, all.data() + i * sizeof r, sizeof r);
    return r;
  };
  for (std::size_t pixel = 0; pixel < 64; ++pixel)
    for (std::size_t sequence = 0; sequence < 2; ++sequence)
      for (int k = 0; k < 3; ++k) {
        double sum = 0;
        for (std::size_t turn = 0; turn < 4; ++turn)
          sum += record(small, (2 * turn + sequence) * 64 + pixel).indirect[k];
        const double whole = record(large, sequence * 64 + pixel).indirect[k];
        EXPECT_NEAR(sum, whole, 1e-5 * (1 + whole)) << "pixel " << pixel << ", sequence " << sequence;
      }
}

TEST(Items, DifferWithTheSeed) {
  Shot shot{.scene = made("cornell-box"), .width = 8, .height = 8, .chunks = 1};
  shot.camera = camera_of(*shot.scene);
  shot.seed = 1;
  const Picture a = shoot(shot);
  shot.seed = std::uint64_t{1} << 32 | 1;
  const Picture b = shoot(shot);
  std::size_t same = 0;
  for (std::size_t i = 0; i < 64; ++i) same += a.pixel(i, 0).mean == b.pixel(i, 0).mean;
  EXPECT_LT(same, 8u);
}

// Light seen, or reflected once, does not know how many more bounces are allowed.
TEST(Layers, DirectIsTheSameAtAnyDepth) {
  Shot shot{.scene = made("cornell-box"), .width = 16, .height = 16, .chunks = 2};
  shot.camera = camera_of(*shot.scene);
  const Picture all = shoot(shot);
  shot.depth = 1;
  const Picture one = shoot(shot);
  EXPECT_EQ(all.direct, one.direct);
  for (const float indirect : one.indirect) ASSERT_EQ(indirect, 0);
  EXPECT_GT(*std::max_element(all.indirect.begin(), all.indirect.end()), 0);
}

// The same paths, but for ties and roundings at the hits: nearly all pixels agree, and what is left is noise.
TEST(Tracers, AgreeOnThePicture) {
  for (const char* name : {"cornell-box", "punctual-lights"}) {
    Shot shot{.scene = made(name), .width = 48, .height = 32, .samples = 16, .chunks = 8};
    shot.camera = camera_of(*shot.scene);
    const Picture embree = shoot(shot);
    if (executor(shot.trace).info().trace != worker::TraceKind::embree)
      GTEST_SKIP() << "built without Embree: there is no second tracer to compare with";
    shot.trace = worker::TraceKind::opencl;
    const Picture opencl = shoot(shot);
    std::size_t alike = 0;
    double worst = 0;
    for (std::size_t i = 0; i < embree.pixels(); ++i) {
      double apart = 0, error = 0, scale = 0;
      for (int k = 0; k < 3; ++k) {
        const Sample a = embree.pixel(i, k), b = opencl.pixel(i, k);
        apart = std::max(apart, std::abs(a.mean - b.mean));
        scale = std::max(scale, a.mean);
        error = std::max(error, std::hypot(a.standard_error(), b.standard_error()));
      }
      alike += apart <= 1e-4 * scale;
      if (apart > 0) worst = std::max(worst, apart / std::max(error, 1e-5 * scale));
    }
    Sample difference;
    for (std::uint32_t c = 0; c < shot.chunks; ++c) {
      double sum = 0;
      for (std::size_t i = 0; i < embree.pixels(); ++i)
        for (int k = 0; k < 3; ++k) sum += embree.at(c, i, k) - opencl.at(c, i, k);
      difference.add(sum / (3.0 * static_cast<double>(embree.pixels())));
    }
    const double mean = embree.mean(0).mean;
    const double share = static_cast<double>(alike) / static_cast<double>(embree.pixels());
    std::printf(
        "  %s: %.1f %% of the pixels alike, worst %.2f standard errors apart; means differ by %.1e +- %.1e of %.3f\n",
        name, 100 * share, worst, difference.mean, difference.standard_error(), mean);
    EXPECT_GT(share, 0.9) << name;
    EXPECT_LT(worst, student_critical(sidak(kFamily, 2 * 3 * embree.pixels()), shot.chunks - 1)) << name;
    EXPECT_LT(std::abs(difference.mean), std::max(1e-5 * mean, 5 * difference.standard_error())) << name;
    EXPECT_LT(std::abs(difference.mean), 2e-3 * mean) << name;
  }
}

}  // namespace
}  // namespace gleaner::test

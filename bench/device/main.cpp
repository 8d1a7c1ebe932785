// Checks an OpenCL device against answers that PoCL gave, and times its kernels. Stands on the device library alone.
//
//   bench_device BUNDLE [--device N] [--threads N] [--lanes 1|16] [--rounds N] [--json FILE]
//
// BUNDLE is a folder that bench/device_bundle made. Exit status: 0 all within bounds, 1 not, 2 wrong usage.

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <map>
#include <memory>
#include <set>

#include "bench/device/compare.h"
#include "bench/device/json.h"
#include "bench/device/kernel_costs.h"
#include "bench/device/peaks.h"
#include "bench/device/rays.h"
#include "kernels/path_records.h"
#include "kernels/vpl_records.h"
#include "scene/model/error.h"
#include "worker/stages/executor.h"

namespace gleaner::bench {
namespace {

// Of rays that two tracers answer: those whose nearest triangle differs though the distance does not are ties.
constexpr double kDistance = 1e-5, kRayShare = 1e-4;

struct Words {
  std::filesystem::path bundle;
  worker::DeviceChoice choice{.trace = worker::TraceKind::opencl};
  int rounds = 5;
  std::string json = "device.json";
};

struct HeldScene {
  std::shared_ptr<const scene::Scene> scene;
  std::shared_ptr<const scene::Bvh> bvh;
};

std::map<std::string, HeldScene> read_scenes(const std::filesystem::path& folder) {
  std::map<std::string, HeldScene> scenes;
  for (const auto& file : files_of(folder, ".scene")) {
    HeldScene held;
    held.scene = std::make_shared<scene::Scene>(scene::parse_scene(read_file(file), file.string()));
    const std::filesystem::path tree = std::filesystem::path(file).replace_extension(".bvh");
    held.bvh =
        std::make_shared<scene::Bvh>(scene::parse_bvh(read_file(tree), held.scene->triangle_count(), tree.string()));
    scenes[file.stem().string()] = held;
  }
  return scenes;
}

class DeviceBench {
 public:
  DeviceBench(const Words& words)
      : words_(words), device_(words.choice), executor_(words.choice), scenes_(read_scenes(words.bundle / "scenes")) {}

  // Whether all is within its bounds.
  bool run() {
    json_.begin('{');
    describe();
    check_rays();
    check_stages();
    time_stages();
    json_.add("passed", passed_).end();
    std::printf("%s\n", passed_ ? "PASSED: all answers are within their bounds" : "FAILED: see above");
    return passed_;
  }
  const std::string& text() const { return json_.text(); }

 private:
  void describe();
  void check_rays();
  void check_stages();
  void time_stages();
  void load(const std::string& scene) {
    if (!executor_.holds_scene(scene)) executor_.load_scene(scene, scenes_.at(scene).scene, scenes_.at(scene).bvh);
  }

  Words words_;
  worker::Device device_;
  worker::Executor executor_;
  std::map<std::string, HeldScene> scenes_;
  Peaks peaks_;
  Json json_;
  bool passed_ = true;
};

void DeviceBench::describe() {
  const worker::DeviceInfo& info = device_.info();
  peaks_ = measure_peaks(device_);
  json_.begin("device", '{')
      .add("name", info.name)
      .add("platform", info.platform)
      .add("driver", info.driver)
      .add("version", info.version)
      .add("compute_units", info.compute_units)
      .add("threads", info.threads)
      .add("lanes", info.lanes)
      .add("memory_bytes", info.memory_bytes)
      .add("peak_bytes_per_second", peaks_.bytes)
      .add("peak_flops_per_second", peaks_.flops)
      .end();
  std::printf("%s (%s, driver %s), %u lanes: %.4g GB/s, %.4g GFLOP/s at best\n", info.name.c_str(),
              info.platform.c_str(), info.driver.c_str(), info.lanes, peaks_.bytes * 1e-9, peaks_.flops * 1e-9);
}

void DeviceBench::check_rays() {
  json_.begin("rays", '[');
  for (const auto& [name, held] : scenes_)
    for (const RayKind kind : {RayKind::camera, RayKind::scattered}) {
      const std::string word = kind == RayKind::camera ? "camera" : "scattered";
      const scene::Bytes stored = read_file(words_.bundle / "rays" / (name + "." + word));
      std::vector<RayAnswer> expected(stored.size() / sizeof(RayAnswer));
      std::memcpy(expected.data(), stored.data(), expected.size() * sizeof(RayAnswer));
      const auto count = static_cast<std::uint32_t>(expected.size());
      const auto found = trace_rays(device_, *held.scene, *held.bvh, kind, count);
      std::uint64_t differ = 0;
      for (std::uint32_t i = 0; i < count; ++i) {
        const RayAnswer &a = expected[i], &b = found[i];
        const bool both = a.primitive != GLEANER_NONE && b.primitive != GLEANER_NONE;
        const bool near = both && std::abs(double{a.t} - b.t) <= kDistance * a.t;
        differ += a.blocked != b.blocked || (a.primitive != b.primitive && !near) || (both && !near);
      }
      const bool fine = static_cast<double>(differ) <= kRayShare * count;
      passed_ = passed_ && fine;
      const std::uint32_t many = device_.info().cpu ? 1u << 16 : 1u << 20;
      const RayRate rate = time_rays(device_, *held.scene, *held.bvh, kind, many, words_.rounds);
      json_.begin('{')
          .add("scene", name)
          .add("kind", word)
          .add("count", std::uint64_t{count})
          .add("differ", differ)
          .add("most", kRayShare * count)
          .add("within_bounds", fine)
          .add("closest_rays_per_second", rate.closest)
          .add("any_rays_per_second", rate.any)
          .end();
      std::printf("%-4s rays %-18s %-9s %6llu of %u differ; closest %.4g, any %.4g Mrays/s\n", fine ? "ok" : "BAD",
                  name.c_str(), word.c_str(), static_cast<unsigned long long>(differ), count, rate.closest * 1e-6,
                  rate.any * 1e-6);
    }
  json_.end();
}

void DeviceBench::check_stages() {
  json_.begin("stages", '[');
  for (const auto& file : files_of(words_.bundle / "batches", ".batch")) {
    const RecordedBatch batch = read_batch(file);
    Comparison result;
    std::uint64_t nonfinite = 0;
    try {
      load(batch.task.scene);
      const worker::BatchResult answer = executor_.run(batch.task, batch.first, batch.count);
      nonfinite = answer.counters.nonfinite;
      result = compare_records(batch, answer.records);
    } catch (const Error& error) {
      result.error = error.what();
    }
    const bool fine = result.holds() && nonfinite == 0;
    passed_ = passed_ && fine;
    json_.begin('{')
        .add("batch", batch.name)
        .add("kind", batch.task.kind)
        .add("rows", result.rows)
        .add("differ", result.differ)
        .add("most", result.bound.share * static_cast<double>(result.rows))
        .add("tolerance", result.bound.tolerance)
        .add("sum_differs_by", result.worst_sum)
        .add("sum_most", result.bound.sum)
        .add("nonfinite", nonfinite)
        .add("error", result.error)
        .add("within_bounds", fine)
        .end();
    std::printf("%-4s %-40s %8llu of %8llu rows differ (at most %g %%), sums by %.2g (at most %g)%s%s\n",
                fine ? "ok" : "BAD", batch.name.c_str(), static_cast<unsigned long long>(result.differ),
                static_cast<unsigned long long>(result.rows), 100 * result.bound.share, result.worst_sum,
                result.bound.sum, result.error.empty() ? "" : ": ", result.error.c_str());
  }
  json_.end();
}

// The same stage of a larger film, for a device that a small one does not fill. Null: it cannot grow.
std::unique_ptr<RecordedBatch> enlarged(const RecordedBatch& batch, unsigned times) {
  auto larger = std::make_unique<RecordedBatch>(batch);
  const auto grow = [&]<typename Parameters>(Parameters p) {
    p.width *= times;
    p.height *= times;
    p.items_low = p.width * p.height;
    larger->count = p.items_low;
    std::memcpy(larger->task.parameters.data(), &p, sizeof p);
  };
  const auto parameters = [&]<typename Parameters>(Parameters& p) {
    std::memcpy(&p, batch.task.parameters.data(), std::min(sizeof p, batch.task.parameters.size()));
    return p;
  };
  if (batch.task.kind == "path" && batch.task.inputs.empty()) {
    kernels::PathParameters p{};
    grow(parameters(p));
  } else if (batch.task.kind == "vpl_shade") {
    kernels::VplPointParameters p{};
    grow(parameters(p));
  } else {
    return nullptr;
  }
  return larger;
}

void DeviceBench::time_stages() {
  executor_.profile_kernels();
  json_.begin("times", '[');
  std::set<std::string> timed;
  for (const auto& file : files_of(words_.bundle / "batches", ".batch")) {
    RecordedBatch batch = read_batch(file);
    if (!timed.insert(batch.task.scene + " " + batch.task.kind).second) continue;
    if (const auto larger = enlarged(batch, device_.info().cpu ? 2 : 12)) batch = *larger;
    load(batch.task.scene);
    std::vector<double> seconds;
    worker::BatchCounters counters;
    try {
      for (int round = -1; round < words_.rounds; ++round) {
        counters = executor_.run(batch.task, batch.first, batch.count).counters;
        if (round < 0)
          executor_.kernel_times();  // compiles and takes memory
        else
          seconds.push_back(counters.seconds);
      }
    } catch (const Error& error) {
      passed_ = false;
      std::printf("BAD  %s: %s\n", batch.name.c_str(), error.what());
      continue;
    }
    std::ranges::sort(seconds);
    const double median = seconds[seconds.size() / 2];
    const double rays = static_cast<double>(counters.camera_rays + counters.scatter_rays + counters.shadow_rays);
    json_.begin('{')
        .add("batch", batch.name)
        .add("kind", batch.task.kind)
        .add("items", batch.count)
        .add("seconds", median)
        .add("rays_per_second", rays / median)
        .add("trace_seconds", counters.trace_seconds);
    std::printf("%-40s %8llu items in %.4f s, %.4g Mrays/s\n", batch.name.c_str(),
                static_cast<unsigned long long>(batch.count), median, rays / median * 1e-6);
    json_.begin("kernels", '[');
    for (const auto& [kernel, time] : executor_.kernel_times()) {
      const KernelRate rate = rate_of(kernel, time, batch);
      json_.begin('{')
          .add("kernel", kernel)
          .add("launches", time.launches / static_cast<std::uint64_t>(words_.rounds))
          .add("seconds", time.seconds / words_.rounds)
          .add("unit", rate.unit)
          .add("units_per_second", rate.units)
          .add("bytes_per_second", rate.bytes)
          .add("share_of_peak_bytes", rate.bytes / peaks_.bytes)
          .add("flops_per_second", rate.flops)
          .add("share_of_peak_flops", rate.flops / peaks_.flops)
          .end();
      std::printf("    %-24s %9.5f s  %10.4g M%s/s  %8.4g GB/s (%.0f %% of peak)  %8.4g GFLOP/s (%.0f %%)\n",
                  kernel.c_str(), time.seconds / words_.rounds, rate.units * 1e-6, rate.unit, rate.bytes * 1e-9,
                  100 * rate.bytes / peaks_.bytes, rate.flops * 1e-9, 100 * rate.flops / peaks_.flops);
    }
    json_.end().end();
  }
  json_.end();
}

Words parse_words(int argc, char** argv) {
  Words words;
  for (int k = 1; k < argc; ++k) {
    const std::string word = argv[k];
    if (!word.starts_with("--")) {
      words.bundle = word;
      continue;
    }
    if (k + 1 == argc) throw Error::usage(word + ": expected a value");
    const char* value = argv[++k];
    if (word == "--json")
      words.json = value;
    else if (word == "--device")
      words.choice.device = std::atoi(value);
    else if (word == "--threads")
      words.choice.threads = std::atoi(value);
    else if (word == "--lanes")
      words.choice.lanes = static_cast<unsigned>(std::atoi(value));
    else if (word == "--rounds")
      words.rounds = std::max(1, std::atoi(value));
    else
      throw Error::usage("no option " + word);
  }
  if (words.bundle.empty())
    throw Error::usage("bench_device BUNDLE [--device N] [--threads N] [--lanes 1|16] [--rounds N] [--json FILE]");
  return words;
}

}  // namespace
}  // namespace gleaner::bench

int main(int argc, char** argv) {
  using namespace gleaner;
  try {
    const bench::Words words = bench::parse_words(argc, argv);
    bench::DeviceBench bench(words);
    const bool passed = bench.run();
    scene::Bytes text(bench.text().size());
    std::memcpy(text.data(), bench.text().data(), text.size());
    bench::write_file(words.json, text);
    return passed ? 0 : 1;
  } catch (const Error& error) {
    std::fprintf(stderr, "%s\n", error.what());
    return static_cast<int>(error.kind());
  } catch (const cl::Error& error) {
    std::fprintf(stderr, "%s\n", worker::describe(error).c_str());
    return 1;
  }
}

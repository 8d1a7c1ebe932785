// Clusters against all pairs: how far the light of virtual point lights is from that of pixels which query every
// VPL, and how much sooner it is there. The same VPLs, the same points, the same bound of the geometry term; nothing is
// compensated.
//
//   build/bench/bench_vpl_pairs SCENE WIDTHxHEIGHT VPLS VPL_CLUSTERS POINT_CLUSTERS [PART [ROUNDS [CLAMP
//   [RESIDUAL_THRESHOLD]]]]
//
// All pairs are queried on every PART-th row of the picture (1: all; the width a multiple of 16), and their time is
// multiplied by PART. Time: the stages of the indirect light, each whole on one device; medians of the rounds. Errors
// are of the radiance of the VPLs' light: MSE with both pictures clamped to [0, 1] as the paper has it,
// and RMSE over the mean, not clamped.

#include <algorithm>
#include <charconv>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstring>
#include <map>
#include <vector>

#include "cli/local_frame.h"
#include "scene/import/import.h"

namespace {

using namespace gleaner;

double now() { return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count(); }

double median(std::vector<double> values) {
  std::ranges::sort(values);
  return values[values.size() / 2];
}

std::vector<float> floats(const scene::Bytes& bytes) {
  std::vector<float> values(bytes.size() / 4);
  std::memcpy(values.data(), bytes.data(), bytes.size());
  return values;
}

struct Indirect {
  std::vector<float> radiance;            // RGB a pixel
  std::map<std::string, double> seconds;  // by stage
  double all() const {
    double sum = 0;
    for (const auto& [stage, s] : seconds) sum += s;
    return sum;
  }
};

bool is_indirect(const std::string& name) { return name.starts_with("vpl."); }

// What is asked for: the scene's frame by clusters, and by all pairs on one row in `part`.
struct Pairs {
  std::shared_ptr<const scene::Scene> scene;
  coordinator::FrameSettings clustered, pairs;
  unsigned part = 16;
  int rounds = 1;
};

Pairs read_arguments(int argc, char** argv) {
  Pairs asked;
  coordinator::FrameSettings settings;
  if (std::sscanf(argv[2], "%ux%u", &settings.width, &settings.height) != 2)
    throw Error::usage(std::string("size: expected WIDTHxHEIGHT, found ") + argv[2]);
  if (settings.width == 0 || settings.width % 16 != 0)
    throw Error::usage(std::string("size: expected a width that is a multiple of 16, found ") + argv[2]);
  if (argc > 6) asked.part = static_cast<unsigned>(std::max(1, std::atoi(argv[6])));
  if (argc > 7) asked.rounds = std::max(1, std::atoi(argv[7]));
  asked.scene = std::make_shared<const scene::Scene>(scene::import_scene(argv[1]));
  if (asked.scene->cameras.empty()) throw Error::bad_input(argv[1], "cameras", "one", "none");
  settings.method = "vpl";
  settings.spp = 1;
  settings.camera = asked.scene->cameras.front().camera;
  settings.camera.half_width =
      settings.camera.half_height * static_cast<float>(settings.width) / static_cast<float>(settings.height);
  settings.set = {{"vpl.count", argv[3]}, {"vpl.compensate", "0"}, {"vpl.passes", "1"}, {"vpl.samples", "1"}};
  asked.clustered = asked.pairs = settings;
  asked.clustered.set["vpl.clusters"] = argv[4];
  asked.clustered.set["vpl.point_clusters"] = argv[5];
  asked.pairs.set["vpl.clusters"] = "0";
  asked.pairs.set["vpl.point_clusters"] = "0";
  asked.clustered.set["vpl.residual_threshold"] = argc > 9 ? argv[9] : "0.02";
  asked.clustered.set["vpl.clamp"] = asked.pairs.set["vpl.clamp"] = argc > 8 ? argv[8] : "0.05";
  return asked;
}

Indirect light_by_clusters(const Pairs& asked, worker::Executor& executor) {
  Indirect light;
  const auto plan = coordinator::make_plan(asked.clustered, coordinator::summarize(*asked.scene));
  double begun = 0;
  cli::run_frame(
      *plan, executor, "scene",
      [&](const auto&, const auto&) {
        begun = now();
        return true;
      },
      [&](const auto& stage, const worker::BatchResult& result) {
        if (!is_indirect(stage.name)) return;
        light.seconds[stage.kind] += now() - begun;
        if (stage.kind == "vpl_shade") light.radiance = floats(result.records);
      });
  return light;
}

// Light of one row in `part`; the others' is 0. Returns the seconds of all rows.
double light_by_pairs(const Pairs& asked, worker::Executor& executor, std::vector<float>& light) {
  double seconds = 0;
  const std::uint64_t width = asked.pairs.width;
  const auto plan = coordinator::make_plan(asked.pairs, coordinator::summarize(*asked.scene));
  cli::run_frame(*plan, executor, "scene", [&](const auto& stage, const worker::StageTask& task) {
    if (stage.kind != "vpl_shade") return true;
    light.assign(stage.items * 3, 0.0f);
    const double start = now();
    for (std::uint64_t first = 0; first < stage.items; first += width * asked.part) {
      const std::uint64_t count = std::min<std::uint64_t>(width, stage.items - first);
      const std::vector<float> values = floats(executor.run(task, first, count).records);
      std::copy(values.begin(), values.end(), light.begin() + static_cast<std::ptrdiff_t>(first * 3));
    }
    seconds = (now() - start) * asked.part;
    return false;
  });
  return seconds;
}

void print_errors(const Pairs& asked, const std::vector<float>& fast, const std::vector<float>& exact) {
  double square = 0, clamped = 0, mean = 0, values = 0, bias = 0;
  for (std::size_t i = 0; i < exact.size(); ++i) {
    if (i / (3 * std::size_t{asked.pairs.width}) % asked.part != 0) continue;
    const double a = fast[i], b = exact[i];
    const double ca = std::clamp(a, 0.0, 1.0), cb = std::clamp(b, 0.0, 1.0);
    square += (a - b) * (a - b);
    clamped += (ca - cb) * (ca - cb);
    mean += b;
    bias += a - b;
    ++values;
  }
  std::printf("  MSE clamped to [0, 1] %.3g, RMSE over the mean %.2f %% (mean %.4g, bias %+.2f %%)\n", clamped / values,
              100 * std::sqrt(square / values) / (mean / values), mean / values, 100 * bias / mean);
}

}  // namespace

int main(int argc, char** argv) {
  if (argc < 6) {
    std::fprintf(stderr,
                 "usage: bench_vpl_pairs SCENE WIDTHxHEIGHT VPLS VPL_CLUSTERS POINT_CLUSTERS [PART [ROUNDS [CLAMP "
                 "[RESIDUAL_THRESHOLD]]]]\n");
    return 2;
  }
  try {
    const Pairs asked = read_arguments(argc, argv);
    worker::Executor executor({});
    executor.load_scene("scene", asked.scene, nullptr);
    std::vector<double> clustered_seconds, pairs_seconds, ratios;
    Indirect fast;
    std::vector<float> exact;
    // One more than is measured: the first compiles the kernels.
    for (int round = 0; round <= asked.rounds; ++round) {
      fast = light_by_clusters(asked, executor);
      const double exact_seconds = light_by_pairs(asked, executor, exact);
      if (round == 0) continue;
      clustered_seconds.push_back(fast.all());
      pairs_seconds.push_back(exact_seconds);
      ratios.push_back(exact_seconds / fast.all());
    }
    std::printf("%s %s: %s VPLs, %s VPL clusters, %s point clusters; all pairs on 1 of %u rows\n", argv[1], argv[2],
                argv[3], argv[4], argv[5], asked.part);
    for (const auto& [kind, seconds] : fast.seconds) std::printf("  %-16s %8.3f s\n", kind.c_str(), seconds);
    std::printf("  clusters %.3f s, all pairs %.1f s: %.1f times sooner\n", median(clustered_seconds),
                median(pairs_seconds), median(ratios));
    print_errors(asked, fast.radiance, exact);
    return 0;
  } catch (const std::exception& error) {
    std::fprintf(stderr, "bench_vpl_pairs: %s\n", error.what());
    return 1;
  }
}

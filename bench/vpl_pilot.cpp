// What the pilot of method `vpl` foresees, beside what is measured: errors of numbers of VPLs, of clusters of them and
// of clusters of points, each alone.
//
//   build/bench/bench_vpl_pilot SCENE WIDTHxHEIGHT [PART [BOUND]]
//
// RMSE over the mean radiance of the VPLs' light, on every PART-th row of the picture (the width a multiple of 16), at
// one bound of the geometry term. VPLs: between two seeds, over the root of two. Clusters of VPLs: against all of them.
// Clusters of points: against points that ask for themselves.

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstring>
#include <map>
#include <nlohmann/json.hpp>
#include <vector>

#include "cli/local_frame.h"
#include "coordinator/plan/vpl_pilot.h"
#include "kernels/cluster_records.h"
#include "kernels/path_records.h"
#include "kernels/vpl_records.h"
#include "scene/import/import.h"

namespace {

using namespace gleaner;
using Settings = std::map<std::string, std::string>;

std::vector<float> floats(const scene::Bytes& bytes) {
  std::vector<float> values(bytes.size() / 4);
  std::memcpy(values.data(), bytes.data(), bytes.size());
  return values;
}

struct Shaded {
  std::vector<float> radiance;  // RGB of the rows that are looked at
  std::vector<float> lights, points;
  double density = 0;  // of the VPLs
};

class Bench {
 public:
  Bench(const std::string& path, unsigned width, unsigned height, unsigned part)
      : scene_(std::make_shared<const scene::Scene>(scene::import_scene(path))), executor_({}), part_(part) {
    if (scene_->cameras.empty()) throw Error::bad_input(path, "cameras", "one", "none");
    settings_.method = "vpl";
    settings_.spp = 1;
    settings_.width = width;
    settings_.height = height;
    settings_.camera = scene_->cameras.front().camera;
    settings_.camera.half_width = settings_.camera.half_height * static_cast<float>(width) / static_cast<float>(height);
    executor_.load_scene("scene", scene_, nullptr);
  }

  Shaded shade(const Settings& set, std::uint64_t seed) {
    coordinator::FrameSettings settings = settings_;
    settings.seed = seed;
    settings.set = {
        {"vpl.compensate", "0"}, {"vpl.samples", "1"}, {"vpl.passes", "1"}, {"vpl.random_representative", "0"}};
    for (const auto& [key, value] : set) settings.set[key] = value;
    auto plan = coordinator::make_plan(settings, coordinator::summarize(*scene_));
    Shaded made;
    cli::run_frame(
        *plan, executor_, "scene",
        [&](const auto& stage, const worker::StageTask& task) {
          if (stage.name == "vpl.cluster.0") made.lights = floats(*task.inputs.at("lights").load());
          if (stage.kind != "vpl_shade") return true;
          for (std::uint64_t first = 0; first < stage.items; first += std::uint64_t{settings.width} * part_) {
            const std::uint64_t count = std::min<std::uint64_t>(settings.width, stage.items - first);
            const std::vector<float> values = floats(executor_.run(task, first, count).records);
            made.radiance.insert(made.radiance.end(), values.begin(), values.end());
          }
          return false;
        },
        [&](const auto& stage, const worker::BatchResult& result) {
          if (stage.name == "vpl.points") made.points = floats(result.records);
        });
    const auto vpl = nlohmann::json::parse(plan->parameters_json())["vpl"];
    made.density = vpl.value("clamp_per_square_metre", 0.0) / std::stod(settings.set.at("vpl.clamp"));
    return made;
  }

  worker::Executor& executor() { return executor_; }

 private:
  std::shared_ptr<const scene::Scene> scene_;
  worker::Executor executor_;
  coordinator::FrameSettings settings_;
  unsigned part_;
};

constexpr std::uint32_t kCount = 16000;  // VPLs of the picture that all is held against

double rms(const Shaded& a, const Shaded& b) {
  double sum = 0;
  for (std::size_t i = 0; i < a.radiance.size(); ++i)
    sum += (double{a.radiance[i]} - b.radiance[i]) * (double{a.radiance[i]} - b.radiance[i]);
  return std::sqrt(sum / static_cast<double>(a.radiance.size()));
}

void print(const char* what, const std::string& counts, double foreseen, double measured, double mean) {
  std::printf("  %-14s %-28s foreseen %6.2f %%  measured %6.2f %%  ratio %.2f\n", what, counts.c_str(),
              100 * foreseen / mean, 100 * measured / mean, foreseen / measured);
  std::fflush(stdout);
}

}  // namespace

int main(int argc, char** argv) {
  if (argc < 3) {
    std::fprintf(stderr, "usage: bench_vpl_pilot SCENE WIDTHxHEIGHT [PART [BOUND]]\n");
    return 2;
  }
  try {
    unsigned width = 0, height = 0;
    if (std::sscanf(argv[2], "%ux%u", &width, &height) != 2 || width == 0 || width % 16 != 0 || height == 0)
      throw Error::usage(std::string("size: expected WIDTHxHEIGHT, the width a multiple of 16, found ") + argv[2]);
    const unsigned part = argc > 3 ? static_cast<unsigned>(std::max(1, std::atoi(argv[3]))) : 16;
    Bench bench(argv[1], width, height, part);
    const std::string all = std::to_string(kCount);
    const auto points = static_cast<std::uint32_t>(std::clamp(width * height / 80.0, 256.0, 20000.0));
    const Settings none = {{"vpl.count", all}, {"vpl.clusters", "0"}, {"vpl.point_clusters", "0"}};
    // The lights and points that a pilot has.
    const Shaded first = bench.shade({{"vpl.count", all},
                                      {"vpl.clusters", "1536"},
                                      {"vpl.point_clusters", std::to_string(points)},
                                      {"vpl.clamp", "0.05"}},
                                     1);
    const double factor = argc > 4 ? std::atof(argv[4]) : 0.05;
    if (!(factor > 0)) throw Error::usage(std::string("bound: expected a number above 0, found ") + argv[4]);
    const double bound = factor * first.density;
    coordinator::VplPilot pilot(first.lights, first.points, {bound});
    if (pilot.empty()) throw Error::failed("no light reaches the picture");
    worker::StageTask task;
    task.kind = "vpl_visibility";
    task.scene = "scene";
    const auto bytes = [](const std::vector<float>& rows) {
      auto to = std::make_shared<scene::Bytes>(rows.size() * 4);
      std::memcpy(to->data(), rows.data(), to->size());
      return to;
    };
    task.inputs["lights"] = bytes(pilot.asked_lights());
    task.inputs["points"] = bytes(pilot.asked_points());
    kernels::VisibilityParameters p{};
    p.clusters = coordinator::VplPilot::kLights;
    p.point_clusters = static_cast<std::uint32_t>(pilot.asked_points().size() / POINT_WORDS);
    p.clamp = static_cast<float>(bound);
    task.parameters.resize(sizeof p);
    std::memcpy(task.parameters.data(), &p, sizeof p);
    pilot.answer(bench.executor().run(task, 0, p.point_clusters).records);
    coordinator::VplWish wish;
    wish.pixels = static_cast<double>(width) * height;
    wish.points = static_cast<double>(first.points.size() / POINT_WORDS);
    wish.spp = 16;
    wish.made = kCount;
    wish.samples = 16;
    wish.usual_point_clusters = points;
    {
      // What it takes the host with as many bounds as the plan has.
      const auto begun = std::chrono::steady_clock::now();
      coordinator::VplPilot whole(first.lights, first.points, {bound / 2, bound, 2 * bound, 4 * bound});
      const auto measured = std::chrono::steady_clock::now();
      whole.answer(bench.executor().run(task, 0, p.point_clusters).records);
      const auto answered = std::chrono::steady_clock::now();
      const coordinator::PathForecast some{whole.mean(0) * whole.mean(0), whole.mean(0)};
      choose_vpl(whole, {some, some, some, some}, wish);
      const auto chosen = std::chrono::steady_clock::now();
      const auto ms = [](auto from, auto to) { return 1e3 * std::chrono::duration<double>(to - from).count(); };
      std::printf("%s: pilot %.1f ms before it asks, %.1f ms with its %u rays, %.1f ms to choose\n", argv[1],
                  ms(begun, measured), ms(measured, answered), p.point_clusters * p.clusters, ms(answered, chosen));
    }
    const auto foreseen = [&](std::uint32_t count, std::uint32_t clusters, std::uint32_t point_clusters, double doubt) {
      return coordinator::forecast_vpl(pilot, {{}}, wish, {count, clusters, point_clusters, 1, doubt, 0});
    };
    // Lights grow denser in proportion to their number; the bound stays.
    const auto with = [&](Settings set, double count = kCount, double doubt = 0.2) {
      set["vpl.clamp"] = std::to_string(factor * kCount / count);
      set["vpl.residual_threshold"] = std::to_string(doubt);
      return set;
    };
    const Shaded exact = bench.shade(with(none), 1);
    double mean = 0;
    for (const float value : exact.radiance) mean += value / static_cast<double>(exact.radiance.size());
    std::printf("%s %ux%u, one row in %u: mean foreseen %.4g, measured %.4g\n", argv[1], width, height, part,
                pilot.mean(0), mean);
    for (const std::uint32_t count : {1000u, 4000u}) {
      Settings set = none;
      set["vpl.count"] = std::to_string(count);
      const Shaded a = bench.shade(with(set, count), 1), b = bench.shade(with(set, count), 2);
      print("VPLs", set["vpl.count"], std::sqrt(foreseen(count, 0, 0, 0).lights), rms(a, b) / std::sqrt(2), mean);
    }
    for (const std::uint32_t clusters : {256u, 768u, 1536u, 4096u}) {
      Settings set = none;
      set["vpl.clusters"] = std::to_string(clusters);
      const double told = std::sqrt(foreseen(kCount, clusters, 0, 0).clusters);
      print("VPL clusters", set["vpl.clusters"], told, rms(bench.shade(with(set), 1), exact), mean);
      if (clusters != 768) continue;
      set["vpl.random_representative"] = std::string("1");
      const double drawn = pilot.clusters_error(0, clusters, true) * (1 - clusters / double{kCount});
      print("", "768, one drawn by lot", std::sqrt(drawn), rms(bench.shade(with(set), 1), exact), mean);
    }
    // Of lights that are not clustered: points that ask for themselves mend what clusters of lights have wrong, too.
    constexpr std::uint32_t kFew = 1600;
    Settings few = none;
    few["vpl.count"] = std::to_string(kFew);
    const Shaded asked = bench.shade(with(few, kFew), 1);
    for (const double portion : {0.25, 1.0, 2.0})
      for (const double doubt : {0.0, 0.2, 0.02}) {
        Settings set = few;
        const auto some = static_cast<std::uint32_t>(points * portion);
        set["vpl.point_clusters"] = std::to_string(some);
        char words[64];
        std::snprintf(words, sizeof words, "%u, doubt %.2f", some, doubt);
        print("point clusters", words, std::sqrt(foreseen(kFew, 0, some, doubt).points),
              rms(bench.shade(with(set, kFew, doubt), 1), asked), mean);
      }
    return 0;
  } catch (const std::exception& error) {
    std::fprintf(stderr, "bench_vpl_pilot: %s\n", error.what());
    return 1;
  }
}

// What the pilot of method `vpl` foresees, beside what is measured: errors of numbers of VPLs, of clusters of them and
// of clusters of points, each alone.
//
//   build/bench/bench_vpl_pilot SCENE WIDTHxHEIGHT [PART [BOUND]]
//
// RMSE over the mean radiance of the VPLs' light, on every PART-th row of the picture (the width a multiple of 16), at
// one bound of the geometry term. VPLs: between two seeds, over the root of two. Clusters of VPLs: against all of them.
// Clusters of points: against points that query all lights.

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstring>
#include <map>
#include <nlohmann/json.hpp>
#include <vector>

#include "cli/local_frame.h"
#include "coordinator/plan/graph.h"
#include "coordinator/plan/vpl_pilot.h"
#include "kernels/cluster_records.h"
#include "kernels/path_records.h"
#include "kernels/vpl_records.h"
#include "scene/import/import.h"

namespace {

using namespace gleaner;
using Settings = std::map<std::string, std::string>;
using Shape = kernels::VplPilotShape;

constexpr std::size_t kThird = 2;  // of the pilot's bounds

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
  unsigned part() const { return part_; }

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

  // What the pilot's stages tell of these lights and points; without paths.
  kernels::VplPilotFacts measure(const Shaded& made, const std::array<double, Shape::bounds>& bounds) {
    const auto lights = run("vpl_pilot_lights", kernels::VplPilotRowsParameters{}, {{"lights", made.lights}}, 1);
    const auto points = run("vpl_pilot_points", kernels::VplPilotRowsParameters{}, {{"points", made.points}}, 1);
    const std::vector<float> queried_lights = floats(lights.records), queried_points = floats(points.records);
    if (queried_lights.empty() || queried_points.empty()) throw Error::failed("no light reaches the picture");
    kernels::VisibilityParameters p{};
    p.clusters = Shape::lights;
    p.point_clusters = static_cast<std::uint32_t>(queried_points.size() / POINT_WORDS);
    p.clamp = static_cast<float>(bounds[kThird]);
    const auto visibility =
        run("vpl_visibility", p, {{"lights", queried_lights}, {"points", queried_points}}, p.point_clusters);
    kernels::VplPilotParameters parameters;
    std::ranges::copy(bounds, parameters.bounds);
    const std::vector<float> no_paths(2 * (sizeof(kernels::PathRecord) / 4 + 3));
    const auto measured_facts = run("vpl_pilot", parameters,
                                    {{"lights", made.lights},
                                     {"points", made.points},
                                     {"queried_lights", queried_lights},
                                     {"queried_points", queried_points},
                                     {"visibility", floats(visibility.records)},
                                     {"paths.0", no_paths},
                                     {"paths.1", no_paths}},
                                    1);
    kernels::VplPilotFacts facts;
    std::memcpy(&facts, measured_facts.facts.data(), sizeof facts);
    return facts;
  }

 private:
  template <typename Parameters>
  worker::BatchResult run(const char* kind, const Parameters& parameters,
                          const std::map<std::string, std::vector<float>>& inputs, std::uint64_t items) {
    worker::StageTask task;
    task.kind = kind;
    task.scene = "scene";
    task.parameters = coordinator::bytes_of(parameters);
    for (const auto& [name, rows] : inputs) task.inputs[name] = worker::TaskInput(coordinator::bytes_of(rows));
    return executor_.run(task, 0, items);
  }

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

void print(const char* what, const std::string& counts, double predicted, double measured, double mean) {
  std::printf("  %-14s %-28s predicted %6.2f %%  measured %6.2f %%  ratio %.2f\n", what, counts.c_str(),
              100 * predicted / mean, 100 * measured / mean, predicted / measured);
  std::fflush(stdout);
}

// What the pilot predicts, beside what is measured.
class Comparison {
 public:
  // `factor`: of the bound, at kCount lights. `points`: point clusters of a usual picture.
  Comparison(Bench& bench, const coordinator::VplPilot& pilot, const coordinator::VplTarget& target, double factor,
             std::uint32_t points)
      : bench_(bench), pilot_(pilot), target_(target), factor_(factor), points_(points) {}

  void run(const char* scene) {
    exact_ = bench_.shade(with(none_), 1);
    for (const float value : exact_.radiance) mean_ += value / static_cast<double>(exact_.radiance.size());
    std::printf("%s, one row in %u: mean predicted %.4g, measured %.4g\n", scene, bench_.part(), pilot_.mean(kThird),
                mean_);
    lights();
    clusters();
    point_clusters();
  }

 private:
  coordinator::VplPrediction predicted(std::uint32_t count, std::uint32_t clusters, std::uint32_t point_clusters,
                                       double threshold) const {
    return predict_vpl(pilot_, target_, {count, clusters, point_clusters, 1, threshold, kThird});
  }

  // Lights grow denser in proportion to their number; the bound stays.
  Settings with(Settings set, double count = kCount, double threshold = 0.2) const {
    set["vpl.clamp"] = std::to_string(factor_ * kCount / count);
    set["vpl.residual_threshold"] = std::to_string(threshold);
    return set;
  }

  void lights() {
    for (const std::uint32_t count : {1000u, 4000u}) {
      Settings set = none_;
      set["vpl.count"] = std::to_string(count);
      const Shaded a = bench_.shade(with(set, count), 1), b = bench_.shade(with(set, count), 2);
      print("VPLs", set["vpl.count"], std::sqrt(predicted(count, 0, 0, 0).lights), rms(a, b) / std::sqrt(2), mean_);
    }
  }

  void clusters() {
    for (const std::uint32_t clusters : {256u, 768u, 1536u, 4096u}) {
      Settings set = none_;
      set["vpl.clusters"] = std::to_string(clusters);
      const double estimate = std::sqrt(predicted(kCount, clusters, 0, 0).clusters);
      print("VPL clusters", set["vpl.clusters"], estimate, rms(bench_.shade(with(set), 1), exact_), mean_);
      if (clusters != 768) continue;
      set["vpl.random_representative"] = std::string("1");
      const double drawn = pilot_.clusters_error(kThird, clusters, true) * (1 - clusters / double{kCount});
      print("", "768, one at random", std::sqrt(drawn), rms(bench_.shade(with(set), 1), exact_), mean_);
    }
  }

  // Of lights that are not clustered: residual samples correct errors of VPL clusters, too.
  void point_clusters() {
    constexpr std::uint32_t few_lights = 1600;
    Settings few = none_;
    few["vpl.count"] = std::to_string(few_lights);
    const Shaded exact_points = bench_.shade(with(few, few_lights), 1);
    for (const double portion : {0.25, 1.0, 2.0})
      for (const double threshold : {0.0, 0.2, 0.02}) {
        Settings set = few;
        const auto some = static_cast<std::uint32_t>(points_ * portion);
        set["vpl.point_clusters"] = std::to_string(some);
        char words[64];
        std::snprintf(words, sizeof words, "%u, threshold %.2f", some, threshold);
        print("point clusters", words, std::sqrt(predicted(few_lights, 0, some, threshold).points),
              rms(bench_.shade(with(set, few_lights, threshold), 1), exact_points), mean_);
      }
  }

  Bench& bench_;
  const coordinator::VplPilot& pilot_;
  const coordinator::VplTarget& target_;
  double factor_;
  std::uint32_t points_;
  const Settings none_ = {{"vpl.count", std::to_string(kCount)}, {"vpl.clusters", "0"}, {"vpl.point_clusters", "0"}};
  Shaded exact_;
  double mean_ = 0;
};

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
    // The lights and points that a pilot has.
    const Shaded first = bench.shade({{"vpl.count", all},
                                      {"vpl.clusters", "1536"},
                                      {"vpl.point_clusters", std::to_string(points)},
                                      {"vpl.clamp", "0.05"}},
                                     1);
    const double factor = argc > 4 ? std::atof(argv[4]) : 0.05;
    if (!(factor > 0)) throw Error::usage(std::string("bound: expected a number above 0, found ") + argv[4]);
    const double bound = factor * first.density;
    // The pilot's bounds, of which the third is this one.
    const std::array<double, Shape::bounds> bounds = {bound / 4, bound / 2, bound, 2 * bound};
    const auto begun = std::chrono::steady_clock::now();
    const kernels::VplPilotFacts facts = bench.measure(first, bounds);
    const coordinator::VplPilot pilot(facts, bounds);
    const auto measured = std::chrono::steady_clock::now();
    coordinator::VplTarget target;
    target.pixels = static_cast<double>(width) * height;
    target.points = static_cast<double>(first.points.size() / POINT_WORDS);
    target.spp = 16;
    target.made = kCount;
    target.samples = 16;
    target.usual_point_clusters = points;
    choose_vpl(pilot, target);
    const auto chosen = std::chrono::steady_clock::now();
    const auto ms = [](auto from, auto to) { return 1e3 * std::chrono::duration<double>(to - from).count(); };
    std::printf("%s: pilot %.1f ms to measure, %.1f ms to choose\n", argv[1], ms(begun, measured),
                ms(measured, chosen));
    Comparison(bench, pilot, target, factor, points).run(argv[1]);
    return 0;
  } catch (const std::exception& error) {
    std::fprintf(stderr, "bench_vpl_pilot: %s\n", error.what());
    return 1;
  }
}

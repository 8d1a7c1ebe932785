// Method `vpl` against closed forms, against the path tracer, and in the limits in which its approximations vanish.

#include <cmath>
#include <cstdio>
#include <functional>
#include <nlohmann/json.hpp>

#include "cli/local_frame.h"
#include "coordinator/plan/plan.h"
#include "scene/library/library.h"
#include "tests/radiometry/shot.h"

namespace gleaner::test {
namespace {

using coordinator::Film;
using coordinator::FrameSettings;
using Settings = std::map<std::string, std::string>;

constexpr double kFamily = 1e-3;  // chance of a false alarm of one test

struct Frame {
  std::shared_ptr<const Scene> scene;
  FrameSettings settings;
  worker::TraceKind trace = worker::TraceKind::automatic;
};

Frame frame_of(const std::string& scene, const Settings& parameters, const std::string& camera, std::uint32_t size,
               std::uint32_t spp, const Settings& set) {
  Frame frame;
  frame.scene = std::make_shared<const Scene>(scene::make_scene(scene, parameters));
  frame.settings.method = "vpl";
  frame.settings.width = frame.settings.height = size;
  frame.settings.spp = spp;
  frame.settings.set = set;
  frame.settings.camera = camera_of(*frame.scene, camera);
  frame.settings.camera.half_width = frame.settings.camera.half_height;
  return frame;
}

struct Rendered {
  Film film;
  std::map<std::string, std::vector<float>> records;  // by stage
  std::map<std::string, worker::StageTask> tasks;
  double forecast = 0;  // of the error that the VPLs' light has, over the picture's mean
};

Rendered render(const Frame& frame) {
  worker::Executor& on = executor(frame.trace);
  const std::string id = load(on, frame.scene);
  auto plan = coordinator::make_plan(frame.settings, coordinator::summarize(*frame.scene));
  Rendered made;
  cli::run_frame(
      *plan, on, id,
      [&](const auto& stage, const worker::StageTask& task) {
        made.tasks[stage.name] = task;
        return true;
      },
      [&](const auto& stage, const worker::BatchResult& result) {
        EXPECT_EQ(result.counters.nonfinite, 0u) << stage.name;
        if (!stage.name.starts_with("vpl.")) return;
        auto& values = made.records[stage.name];
        values.resize(result.records.size() / 4);
        std::memcpy(values.data(), result.records.data(), result.records.size());
      });
  made.film = plan->film();
  const auto parameters = nlohmann::json::parse(plan->parameters_json());
  if (parameters.contains("vpl") && parameters["vpl"].contains("pilot"))
    made.forecast = parameters["vpl"]["pilot"]["error"];
  return made;
}

double mean_of(const Film& film, const std::string& channel) {
  double sum = 0;
  const auto* found = film.find(channel);
  if (!found) throw Error::failed("no channel " + channel);
  for (float value : found->values) sum += value;
  return sum / static_cast<double>(found->values.size());
}

Sample means_of(Frame frame, const std::string& channel, unsigned seeds) {
  Sample sample;
  for (unsigned seed = 1; seed <= seeds; ++seed) {
    frame.settings.seed = seed;
    sample.add(mean_of(render(frame).film, channel));
  }
  return sample;
}

// --- Closed forms ---

TEST(Vpl, Furnace) {
  for (const char* albedo : {"0.2", "0.5", "0.8"})
    expect_mean(means_of(frame_of("furnace", {{"albedo", albedo}, {"emission", "0.5"}}, "corner", 24, 16,
                                  {{"vpl.count", "600"}, {"vpl.clusters", "200"}, {"vpl.point_clusters", "64"}}),
                         "G", 6),
                0.5 / (1 - std::atof(albedo)), std::string("box of albedo ") + albedo, sidak(kFamily, 3), 0.01);
}

TEST(Vpl, FurnaceOfSoManyBounces) {
  for (const char* depth : {"1", "2", "3"}) {
    Frame frame =
        frame_of("furnace", {{"albedo", "0.5"}, {"emission", "1"}}, "corner", 24, 16,
                 {{"depth", depth}, {"vpl.count", "600"}, {"vpl.clusters", "0"}, {"vpl.point_clusters", "0"}});
    expect_mean(means_of(frame, "G", 6), (1 - std::pow(0.5, std::atof(depth) + 1)) / 0.5,
                std::string("box, depth ") + depth, sidak(kFamily, 3), 0.01);
  }
}

// --- The path tracer ---

struct Meeting {
  const char* scene;
  const char* why;
  const char* camera = "";
};

class VplMeetsPath : public testing::TestWithParam<Meeting> {};

// Every VPL and every point for itself: what is left is noise, so that the picture's mean is the path tracer's, with
// all that VPLs leave to paths.
TEST_P(VplMeetsPath, WithoutClusters) {
  const Meeting& p = GetParam();
  Frame vpl = frame_of(p.scene, {}, p.camera, 24, 16,
                       {{"vpl.count", "400"}, {"vpl.clusters", "0"}, {"vpl.point_clusters", "0"}, {"vpl.sets", "2"}});
  Frame path = vpl;
  path.settings.method = "path";
  path.settings.spp = 256;
  for (const char* channel : {"R", "B"}) {
    const Sample truth = means_of(path, channel, 6);
    // The truth's own noise is the allowance; three of its standard errors.
    expect_mean(means_of(vpl, channel, 10), truth.mean, std::string(p.scene) + " " + channel, sidak(kFamily, 20), 0.05,
                3 * truth.standard_error());
  }
}

INSTANTIATE_TEST_SUITE_P(Scenes, VplMeetsPath,
                         testing::Values(Meeting{"cornell-box", "diffuse"},
                                         Meeting{"cornell-mirror", "chains of mirrors"},
                                         Meeting{"cornell-glass", "chains of glass, caustics"},
                                         Meeting{"cornell-glossy", "lobes over layers, bare lobes"},
                                         Meeting{"cornell-textured", "cut-outs, textured lobes, bent normals"},
                                         Meeting{"punctual-lights", "point, spot and directional lights"},
                                         Meeting{"emissive-textured", "textured emission"},
                                         Meeting{"thin-walls", "the room that is lit", "bright room"}),
                         [](const auto& test) {
                           std::string name = test.param.scene;
                           std::replace(name.begin(), name.end(), '-', '_');
                           return name;
                         });

TEST(Vpl, DarkRoomsStayDark) {
  // Both dark rooms lie behind a wall of 1 cm.
  for (const char* camera : {"behind the sheet", "behind the box"})
    for (const char* clusters : {"0", "100"}) {
      const Film film =
          render(frame_of("thin-walls", {}, camera, 32, 4,
                          {{"vpl.count", "500"}, {"vpl.clusters", clusters}, {"vpl.point_clusters", clusters}}))
              .film;
      EXPECT_EQ(mean_of(film, "R"), 0) << clusters << " clusters";
    }
}

// --- Limits ---

TEST(Vpl, AsManyClustersAsPointsAreAllPairs) {
  const Settings pairs = {{"vpl.count", "200"}, {"vpl.clusters", "0"}, {"vpl.point_clusters", "0"}};
  const Settings clusters = {{"vpl.count", "200"}, {"vpl.clusters", "200"}, {"vpl.point_clusters", "1024"}};
  for (const char* scene : {"cornell-box", "cornell-glossy", "cornell-glass"}) {
    const Rendered a = render(frame_of(scene, {}, {}, 32, 1, pairs)),
                   b = render(frame_of(scene, {}, {}, 32, 1, clusters));
    const auto &x = a.records.at("vpl.shade.0"), &y = b.records.at("vpl.shade.0");
    ASSERT_EQ(x.size(), y.size());
    double sum = 0;
    std::size_t different = 0;
    for (std::size_t i = 0; i < x.size(); ++i) {
      sum += x[i];
      different += x[i] != y[i];
    }
    EXPECT_GT(sum, 0);
    EXPECT_EQ(different, 0u) << scene << ": of " << x.size() << " numbers";
  }
}

TEST(Vpl, FuzzinessOfOneIsHardClustering) {
  Settings set = {{"vpl.count", "300"}, {"vpl.clusters", "60"}, {"vpl.point_clusters", "40"}, {"vpl.fuzziness", "1"}};
  const Rendered weighted = render(frame_of("cornell-box", {}, {}, 32, 1, set));
  set["vpl.equal_weights"] = "1";
  const Rendered equal = render(frame_of("cornell-box", {}, {}, 32, 1, set));
  EXPECT_EQ(weighted.records.at("vpl.shade.0"), equal.records.at("vpl.shade.0"));
  set["vpl.fuzziness"] = "6";
  EXPECT_NE(render(frame_of("cornell-box", {}, {}, 32, 1, set)).records.at("vpl.shade.0"),
            equal.records.at("vpl.shade.0"));
}

// Points that ask for the lights their clusters disagree on come nearer to all pairs.
TEST(Vpl, DoubtsAreSettled) {
  const Settings base = {{"vpl.count", "200"}, {"vpl.clusters", "0"}, {"vpl.point_clusters", "60"}};
  Settings pairs = base;
  pairs["vpl.point_clusters"] = "0";
  const auto exact = render(frame_of("cornell-box", {}, {}, 32, 1, pairs)).records.at("vpl.shade.0");
  std::vector<double> errors;
  for (const char* doubt : {"0", "0.02", "0.001"}) {
    Settings set = base;
    set["vpl.doubt"] = doubt;
    const auto shaded = render(frame_of("cornell-box", {}, {}, 32, 1, set)).records.at("vpl.shade.0");
    double square = 0, mean = 0;
    for (std::size_t i = 0; i < exact.size(); ++i) {
      square += (shaded[i] - exact[i]) * (shaded[i] - exact[i]);
      mean += exact[i];
    }
    const auto n = static_cast<double>(exact.size());
    errors.push_back(std::sqrt(square / n) / (mean / n));
    std::printf("  doubt %5s: RMSE over the mean %.4f\n", doubt, errors.back());
  }
  EXPECT_LT(errors[1], errors[0]);
  EXPECT_LT(errors[2], errors[1] / 2);
}

// More VPLs: the picture goes to the path tracer's. What clusters and the VPLs' own number leave falls, and what
// clamping takes is given back, so that no bias is left in the mean.
TEST(Vpl, ErrorFallsWithMoreLights) {
  Frame truth = frame_of("cornell-box", {}, {}, 24, 4096, {});
  truth.settings.method = "path";
  const Film reference = render(truth).film;
  std::vector<double> errors;
  for (const char* count : {"64", "256", "1024", "4096"}) {
    double square = 0, values = 0;
    for (std::uint64_t seed : {1, 2, 3, 4}) {
      // Many samples and a wide bound: what is seen is the lights' error, not that of the paths.
      Frame frame = frame_of("cornell-box", {}, {}, 24, 512,
                             {{"vpl.count", count},
                              {"vpl.clusters", "0"},
                              {"vpl.point_clusters", "0"},
                              {"vpl.samples", "64"},
                              {"vpl.clamp", "1"},
                              {"vpl.sets", "1"}});
      frame.settings.seed = seed;
      const Film film = render(frame).film;
      for (const char* channel : {"indirect.R", "indirect.G", "indirect.B"})
        for (std::size_t i = 0; i < film.find(channel)->values.size(); ++i) {
          const double d = film.find(channel)->values[i] - reference.find(channel)->values[i];
          square += d * d;
          ++values;
        }
    }
    errors.push_back(std::sqrt(square / values));
    std::printf("  %5s VPLs: RMSE of the indirect light %.5f\n", count, errors.back());
  }
  for (std::size_t i = 1; i < errors.size(); ++i) EXPECT_LT(errors[i], errors[i - 1]);
  const double order = std::log(errors.front() / errors.back()) / std::log(64.0);
  std::printf("  fitted order %.3f\n", order);
  // Noise of independent lights falls as the root of their number, but the bound goes with their density, and what a
  // light does to the corner of two walls, 1 / h at the distance h, is let in ever closer: MSE as N^-1 times N^1/2.
  EXPECT_GT(order, 0.2);
  EXPECT_LT(order, 0.6);
}

// --- The pilot ---

double squared_difference(const Film& film, const Film& truth, const std::string& prefix) {
  double square = 0, values = 0;
  for (const char* channel : {"R", "G", "B"}) {
    const auto &a = film.find(prefix + channel)->values, &b = truth.find(prefix + channel)->values;
    for (std::size_t i = 0; i < a.size(); ++i) square += (double{a[i]} - b[i]) * (double{a[i]} - b[i]);
    values += static_cast<double>(a.size());
  }
  return square / values;
}

// With nothing set, an error that is wished for is met, and the pilot's forecast is near what the lights leave.
TEST(Vpl, WishedErrorIsMet) {
  Frame frame = frame_of("cornell-box", {}, {}, 64, 4096, {});
  frame.settings.method = "path";
  const Film truth = render(frame).film;
  const double mean = (mean_of(truth, "R") + mean_of(truth, "G") + mean_of(truth, "B")) / 3;
  frame.settings.method = "vpl";
  frame.settings.spp = 64;
  for (const double target : {0.05, 0.02}) {
    frame.settings.target_error = target;
    int met = 0;
    double worst = 0;
    for (const std::uint64_t seed : {1, 2, 3, 4}) {
      frame.settings.seed = seed;
      const double error = std::sqrt(squared_difference(render(frame).film, truth, "")) / mean;
      worst = std::max(worst, error);
      met += error <= target;
    }
    std::printf("  wished %.2f: worst of four %.4f\n", target, worst);
    EXPECT_EQ(met, 4) << "target " << target << ", worst " << worst;
    EXPECT_GT(worst, 0.2 * target) << "by doing many times too much";
  }
}

TEST(Vpl, ForecastIsNearWhatTheLightsLeave) {
  // The lights' part alone: many samples take the paths' noise away, but for what shows in the truth as well.
  Frame frame = frame_of("cornell-box", {}, {}, 48, 4096, {});
  frame.settings.method = "path";
  const Film truth = render(frame).film;
  frame.settings.method = "vpl";
  frame.settings.spp = 2048;
  const double whole = (mean_of(truth, "R") + mean_of(truth, "G") + mean_of(truth, "B")) / 3;
  double measured = 0, foreseen = 0;
  for (const std::uint64_t seed : {1, 2, 3}) {
    frame.settings.seed = seed;
    frame.settings.set = {{"vpl.sets", "1"}, {"vpl.clusters", "384"}, {"vpl.count", "4000"}, {"vpl.doubt", "0.2"}};
    const Rendered made = render(frame);
    measured += squared_difference(made.film, truth, "indirect.") / (whole * whole) / 3;
    foreseen += std::pow(made.forecast, 2) / 3;
  }
  std::printf("  RMSE of the indirect light over the picture's mean: foreseen %.4f, measured %.4f\n",
              std::sqrt(foreseen), std::sqrt(measured));
  EXPECT_GT(foreseen, measured / 4);
  EXPECT_LT(foreseen, measured * 4);
}

// --- Conservation ---

TEST(Vpl, ClustersCarryTheirMembersLight) {
  const Rendered made =
      render(frame_of("cornell-glossy", {}, {}, 16, 1, {{"vpl.count", "700"}, {"vpl.clusters", "90"}}));
  const auto total = [](const float* rows, std::size_t words, double scale) {
    std::array<double, 3> sum{};
    for (std::size_t at = 0; at < words; at += VPL_WORDS)
      for (std::size_t k = 0; k < 3; ++k) sum[k] += rows[at + VPL_FLUX + k] * scale;
    return sum;
  };
  const auto luminance = [](const std::array<double, 3>& c) { return 0.2126 * c[0] + 0.7152 * c[1] + 0.0722 * c[2]; };
  const auto& traced = made.records.at("vpl.trace.0");
  const double paths = static_cast<double>(traced.size() / (VPL_WORDS * VPL_PATH_SLOTS));
  const auto& bytes = *made.tasks.at("vpl.cluster.0").inputs.at("lights");
  std::vector<float> kept(bytes.size() / 4);
  std::memcpy(kept.data(), bytes.data(), bytes.size());
  const auto& clusters = made.records.at("vpl.cluster.0");
  const auto all = total(traced.data(), traced.size(), 1 / paths), drawn = total(kept.data(), kept.size(), 1),
             gathered = total(clusters.data(), clusters.size(), 1);
  // What is drawn again keeps the light's luminance; clusters keep every channel.
  EXPECT_NEAR(luminance(drawn) / luminance(all), 1, 2.0 / 700);
  for (std::size_t k = 0; k < 3; ++k) EXPECT_NEAR(gathered[k] / drawn[k], 1, 1e-5);
  std::size_t members = 0;
  for (std::size_t at = 0; at < clusters.size(); at += VPL_WORDS)
    members += static_cast<std::size_t>(clusters[at + VPL_COUNT]);
  EXPECT_EQ(members, kept.size() / VPL_WORDS);
}

// However long light paths are, none of what they leave stands for so much that it lights a spot.
TEST(Vpl, NoLightOutshinesTheOthers) {
  const Rendered made = render(frame_of("furnace", {{"albedo", "0.95"}}, {}, 16, 1, {{"vpl.count", "4000"}}));
  const auto& bytes = *made.tasks.at("vpl.cluster.0").inputs.at("lights");
  std::vector<float> lights(bytes.size() / 4);
  std::memcpy(lights.data(), bytes.data(), bytes.size());
  double sum = 0, most = 0;
  float deepest = 0;
  for (std::size_t at = 0; at < lights.size(); at += VPL_WORDS) {
    const double flux = lights[at + VPL_FLUX + 1];
    sum += flux;
    most = std::max(most, flux);
    deepest = std::max(deepest, lights[at + VPL_DEPTH]);
  }
  EXPECT_GT(deepest, 30) << "no path was long";
  EXPECT_LT(most, 8 * sum / static_cast<double>(lights.size() / VPL_WORDS));
}

// --- Numbers ---

TEST(Vpl, AnySceneGivesAFinitePicture) {
  for (const char* scene : {"needles", "far", "comb", "hall", "many-lights", "glass-caustic", "glossy-range"}) {
    const Film film = render(frame_of(scene, {}, {}, 16, 4,
                                      {{"vpl.count", "100"}, {"vpl.clusters", "20"}, {"vpl.point_clusters", "20"}}))
                          .film;
    for (const auto& channel : film.channels)
      for (float value : channel.values) ASSERT_TRUE(std::isfinite(value)) << scene << " " << channel.name;
  }
}

TEST(Vpl, NoLightAndNoSurfaceAreBlack) {
  Scene dark = scene::make_scene("cornell-box", {});
  for (auto& material : dark.materials) std::fill(material.emission, material.emission + 3, 0.0f);
  Frame frame = frame_of("cornell-box", {}, {}, 16, 4, {});
  frame.scene = std::make_shared<const Scene>(dark);
  EXPECT_EQ(mean_of(render(frame).film, "R"), 0);
  Scene empty;
  empty.cameras = dark.cameras;
  frame.scene = std::make_shared<const Scene>(empty);
  EXPECT_EQ(mean_of(render(frame).film, "R"), 0);
}

// A scene's size is nothing to the method: its bound of the geometry term goes with the lights' density.
TEST(Vpl, ScaleIsNothing) {
  const auto scaled = [](float scale) {
    Scene scene = scene::make_scene("cornell-box", {});
    for (float& p : scene.positions) p *= scale;
    for (auto& camera : scene.cameras)
      for (float& o : camera.camera.origin) o *= scale;
    Frame frame = frame_of("cornell-box", {}, {}, 24, 4,
                           {{"vpl.count", "300"}, {"vpl.clusters", "60"}, {"vpl.point_clusters", "60"}});
    frame.scene = std::make_shared<const Scene>(scene);
    frame.settings.camera = scene.cameras[0].camera;
    frame.settings.camera.half_width = frame.settings.camera.half_height;
    return render(frame).film;
  };
  const Film one = scaled(1);
  for (float scale : {1.0f / 1024, 1024.0f}) {
    const Film other = scaled(scale);
    double square = 0, mean = 0;
    for (std::size_t i = 0; i < one.find("R")->values.size(); ++i) {
      const double d = one.find("R")->values[i] - other.find("R")->values[i];
      square += d * d;
      mean += one.find("R")->values[i];
    }
    const double n = static_cast<double>(one.find("R")->values.size());
    EXPECT_LT(std::sqrt(square / n) / (mean / n), 0.01) << "times " << scale;
  }
}

// Batches of any size give the same records, and so do two threads.
TEST(Vpl, RecordsDoNotDependOnBatches) {
  const Frame frame = frame_of("cornell-glass", {}, {}, 40, 4,
                               {{"vpl.count", "200"}, {"vpl.clusters", "50"}, {"vpl.point_clusters", "30"}});
  const Rendered whole = render(frame);
  worker::Executor two({.device = -1, .threads = 2, .trace = worker::TraceKind::automatic});
  two.load_scene("scene", frame.scene, nullptr);
  for (const auto& [name, task] : whole.tasks) {
    if (!name.starts_with("vpl.") || name.find("cluster") != std::string::npos) continue;
    const auto& records = whole.records.at(name);
    worker::StageTask again = task;
    again.scene = "scene";
    const std::uint64_t step = 48;
    const std::uint64_t items = name == "vpl.visibility.0" ? task.inputs.at("points")->size() / (POINT_WORDS * 4)
                                : name == "vpl.trace.0"    ? records.size() / (VPL_WORDS * VPL_PATH_SLOTS)
                                : name == "vpl.points"     ? records.size() / POINT_WORDS
                                                           : records.size() / 3;
    const std::size_t stride = records.size() / items;
    for (std::uint64_t first = 0; first < items; first += step * 3) {
      const std::uint64_t count = std::min(step, items - first);
      const auto result = two.run(again, first, count);
      ASSERT_EQ(std::memcmp(result.records.data(), &records[first * stride], count * stride * 4), 0)
          << name << " from " << first;
    }
  }
}

}  // namespace
}  // namespace gleaner::test

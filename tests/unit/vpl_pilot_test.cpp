// The pilot of method `vpl`: what it predicts against what can be computed, and what the plan makes of it.

#include "coordinator/plan/vpl_pilot.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <cstdio>
#include <cstring>
#include <deque>
#include <functional>
#include <limits>
#include <map>
#include <nlohmann/json.hpp>
#include <set>

#include "coordinator/plan/plan.h"
#include "kernels/cluster_records.h"
#include "kernels/path_records.h"
#include "scene/model/error.h"
#include "tests/unit/plan_frame.h"
#include "tests/unit/vpl_frame.h"

namespace gleaner::coordinator {
namespace {

using Shape = kernels::VplPilotShape;

// A square of 2 m, seen from above, under a ceiling of lights.
constexpr double kAlbedo = 0.2;

std::vector<float> light_at(double x, double y, double z, double flux) {
  std::vector<float> row(VPL_WORDS, 0.0f);
  row[0] = static_cast<float>(x), row[1] = static_cast<float>(y), row[2] = static_cast<float>(z);
  row[VPL_NORMAL + 2] = row[VPL_GEOMETRIC + 2] = -1;
  for (unsigned k = 0; k < 3; ++k) row[VPL_FLUX + k] = static_cast<float>(flux);
  row[VPL_COS] = row[VPL_COUNT] = 1;
  return row;
}

std::vector<float> ceiling(std::uint32_t count, double height) {
  std::vector<float> lights;
  for (std::uint32_t i = 0; i < count; ++i) {
    const auto row = light_at(2 * unit(2 * i + 1) - 1, 2 * unit(2 * i + 2) - 1, height, 1.0 / count);
    lights.insert(lights.end(), row.begin(), row.end());
  }
  return lights;
}

std::vector<float> floor_points(std::uint32_t side) {
  std::vector<float> points;
  for (std::uint32_t i = 0; i < side * side; ++i) {
    std::vector<float> row(POINT_WORDS, 0.0f);
    row[0] = static_cast<float>((i % side + 0.5) * 2 / side - 1);
    row[1] = static_cast<float>((i / side + 0.5) * 2 / side - 1);
    row[POINT_NORMAL + 2] = 1;
    for (unsigned k = 0; k < 3; ++k) row[POINT_ALBEDO + k] = static_cast<float>(kAlbedo);
    row[POINT_COS] = row[POINT_WEIGHT] = 1;
    points.insert(points.end(), row.begin(), row.end());
  }
  return points;
}

using Sees = std::function<bool(const float* point, const float* light)>;
const Sees everything = [](const float*, const float*) { return true; };
// A wall stands between the halves of the floor, and all lights but a few are on one side of it.
const Sees half = [](const float* point, const float*) { return point[0] > 0; };

Bytes bits(const std::vector<float>& lights, const std::vector<float>& points, const Sees& sees) {
  const std::size_t columns = lights.size() / VPL_WORDS, rows = points.size() / POINT_WORDS;
  const std::size_t words = columns / 32 + VISIBILITY_COUNTS;
  Bytes records(rows * words * 4);
  for (std::size_t p = 0; p < rows; ++p)
    for (std::size_t l = 0; l < columns; ++l) {
      std::uint32_t triangle = 0;
      std::memcpy(&triangle, &points[p * POINT_WORDS + POINT_TRIANGLE], 4);
      if (triangle == GLEANER_NONE || !sees(&points[p * POINT_WORDS], &lights[l * VPL_WORDS])) continue;
      records[(p * words + l / 32) * 4 + l % 32 / 8] |= std::byte(1u << (l % 8));
    }
  return records;
}

using Bounds = std::array<double, Shape::bounds>;

// The third is `middle`.
Bounds bounds_about(double middle) { return {middle / 4, middle / 2, middle, 2 * middle}; }
constexpr std::size_t kMiddle = 2;

worker::StageTask task_of(const char* kind, const Bytes& parameters,
                          const std::map<std::string, std::vector<float>>& inputs) {
  worker::StageTask task;
  task.kind = kind;
  task.parameters = parameters;
  for (const auto& [name, rows] : inputs)
    task.inputs[name] = worker::TaskInput(std::make_shared<const Bytes>(bytes_of_floats(rows)));
  return task;
}

std::vector<float> queried_points(const std::vector<float>& points) {
  return floats_of(worker::choose_pilot_points(task_of("vpl_pilot_points", Bytes(16), {{"points", points}})).records);
}

std::vector<float> queried_lights(const std::vector<float>& lights) {
  return floats_of(worker::choose_pilot_lights(task_of("vpl_pilot_lights", Bytes(16), {{"lights", lights}})).records);
}

kernels::VplPilotFacts facts_of(const std::vector<float>& lights, const std::vector<float>& points, const Sees& sees,
                                const Bounds& bounds) {
  const auto asked_points = queried_points(points), asked_lights = queried_lights(lights);
  const std::vector<float> no_paths(2 * 9, 0.0f);
  kernels::VplPilotParameters parameters;
  std::ranges::copy(bounds, parameters.bounds);
  Bytes parameter_bytes(sizeof parameters);
  std::memcpy(parameter_bytes.data(), &parameters, sizeof parameters);
  const auto result = worker::measure_pilot(task_of("vpl_pilot", parameter_bytes,
                                                    {{"lights", lights},
                                                     {"points", points},
                                                     {"queried_lights", asked_lights},
                                                     {"queried_points", asked_points},
                                                     {"visibility", floats_of(bits(asked_lights, asked_points, sees))},
                                                     {"paths.0", no_paths},
                                                     {"paths.1", no_paths}}));
  kernels::VplPilotFacts facts;
  EXPECT_EQ(result.facts.size(), sizeof facts);
  std::memcpy(&facts, result.facts.data(), sizeof facts);
  return facts;
}

VplPilot pilot_of(const std::vector<float>& lights, const std::vector<float>& points, const Sees& sees,
                  double bound = 1e6) {
  return VplPilot(facts_of(lights, points, sees, bounds_about(bound)), bounds_about(bound));
}

// With paths of these variances of a sample at the least and the highest bound.
VplPilot pilot_beside_paths(double low, double high) {
  const Bounds bounds = {0.5, 1, 2, 4};
  kernels::VplPilotFacts facts = facts_of(ceiling(16000, 0.3), floor_points(96), half, bounds);
  facts.paths[0] = {low, 0.1};
  facts.paths[1] = {high, 0.1};
  return VplPilot(facts, bounds);
}

double brought(const float* point, const float* light, double bound) {
  double d2 = 0;
  for (unsigned k = 0; k < 3; ++k) d2 += std::pow(double{light[k]} - point[k], 2);
  const double height = double{light[2]} - point[2];
  return kAlbedo * light[VPL_FLUX] * std::min(bound, height * height / (d2 * d2));
}

TEST(VplPilot, TellsTheMean) {
  const auto lights = ceiling(4096, 1);
  const auto points = floor_points(64);
  for (const double bound : {0.3, 1e6}) {
    double mean = 0;
    for (std::size_t p = 0; p < points.size(); p += POINT_WORDS)
      for (std::size_t l = 0; l < lights.size(); l += VPL_WORDS)
        mean += brought(&points[p], &lights[l], bound) / (64 * 64);
    const double open = pilot_of(lights, points, everything, bound).mean(kMiddle),
                 shaded = pilot_of(lights, points, half, bound).mean(kMiddle);
    std::printf("  mean %.5f, predicted %.5f; half in the dark %.5f\n", mean, open, shaded);
    EXPECT_NEAR(open, mean, 0.03 * mean);
    EXPECT_NEAR(shaded, 0.5 * mean, 0.06 * mean);
  }
}

// Lights that are drawn by chance: the variance that it foresees is the one that they have.
TEST(VplPilot, ErrorOfFewLightsIsThatOfDrawingThem) {
  const auto lights = ceiling(4096, 0.4);
  const auto points = floor_points(48);
  const double bound = 3;
  const VplPilot pilot = pilot_of(lights, points, everything, bound);
  for (const std::uint32_t count : {64u, 256u}) {
    double square = 0, looked = 0;
    for (std::size_t p = 0; p < points.size(); p += 37 * POINT_WORDS) {
      std::vector<double> each;
      double exact = 0;
      for (std::size_t l = 0; l < lights.size(); l += VPL_WORDS) {
        each.push_back(brought(&points[p], &lights[l], bound));
        exact += each.back();
      }
      for (std::uint64_t run = 0; run < 60; ++run) {
        double sum = 0;
        for (std::uint32_t k = 0; k < count; ++k)
          sum += each[mixed(p * 1000003 + run * 4099 + k) % each.size()] * 4096.0 / count;
        square += (sum - exact) * (sum - exact);
        ++looked;
      }
    }
    const double ratio = std::sqrt(pilot.lights_error(kMiddle, count) / (square / looked));
    std::printf("  %4u lights: predicted over drawn %.3f\n", count, ratio);
    EXPECT_NEAR(ratio, 1, 0.1);
  }
}

// One place has no clusters' error and no error of few lights; the errors of lights that are strewn fall with clusters.
TEST(VplPilot, ErrorOfClusters) {
  std::vector<float> same;
  for (int k = 0; k < 500; ++k) {
    const auto row = light_at(0.1, 0.2, 1, 1);
    same.insert(same.end(), row.begin(), row.end());
  }
  const auto points = floor_points(48);
  const VplPilot one = pilot_of(same, points, everything);
  EXPECT_GT(one.mean(kMiddle), 0);
  const double square = one.mean(kMiddle) * one.mean(kMiddle);
  for (const bool drawn : {false, true}) EXPECT_LT(one.clusters_error(kMiddle, 16, drawn), 1e-8 * square);
  EXPECT_LT(one.lights_error(kMiddle, 16), 1e-8 * square);

  const VplPilot strewn = pilot_of(ceiling(16384, 0.2), points, half, 5);
  double last = 1e300;
  for (double clusters = 16; clusters <= 8192; clusters *= 2) {
    const double error = strewn.clusters_error(kMiddle, clusters, false);
    EXPECT_LT(error, last) << clusters;
    EXPECT_GT(error, 0) << clusters;
    // A member by chance is further off than the one in the middle, which has neighbours on all sides.
    const double ratio = strewn.clusters_error(kMiddle, clusters, true) / error;
    std::printf("  %4.0f clusters: by chance over middle, squares: %.2f\n", clusters, ratio);
    EXPECT_GT(ratio, clusters <= 2048 ? 2 : 1) << clusters;
    last = error;
  }
  // A far cluster is looked at once, of a near one its members too.
  EXPECT_DOUBLE_EQ(pilot_of(ceiling(16384, 9), points, half, 5).looked_at(64), 64);
  const double near = pilot_of(ceiling(16384, 0.02), points, half, 5).looked_at(64);
  EXPECT_GT(near, 64 + 16384.0 / 64);
  EXPECT_LT(near, 64 + 16384.0);
  // In the open there is little that a cluster could have wrong.
  EXPECT_LT(pilot_of(ceiling(16384, 0.2), points, everything, 5).clusters_error(kMiddle, 64, false),
            0.1 * strewn.clusters_error(kMiddle, 64, false));
  // Between the powers of two that are looked at.
  const double between = strewn.clusters_error(kMiddle, 384, false);
  EXPECT_LT(between, strewn.clusters_error(kMiddle, 256, false));
  EXPECT_GT(between, strewn.clusters_error(kMiddle, 512, false));
}

TEST(VplPilot, ErrorOfPointClusters) {
  const auto lights = ceiling(4096, 1);
  const auto points = floor_points(96);
  // Nothing blocks the light: clusters are never wrong, at no spacing.
  const VplPilot open = pilot_of(lights, points, everything);
  for (const double spacing : {2.0, 10.0, 50.0})
    for (const double threshold : {0.0, 0.1}) {
      const VplPilot::Split split = open.points_error(spacing, 1000, threshold);
      EXPECT_EQ(split.common + split.stochastic, 0) << spacing << ", " << threshold;
    }
  // A shadow's edge: wrong near it, farther away where clusters are; asking mends it, the more the oftener.
  const VplPilot edge = pilot_of(lights, points, half);
  double last = 0;
  for (const double spacing : {2.0, 8.0, 32.0}) {
    const double unasked = edge.points_error(spacing, 1000, 0).common;
    EXPECT_GT(unasked, last);
    last = unasked;
    double worse = unasked;
    for (const double threshold : {0.2, 0.05, 0.01}) {
      const VplPilot::Split split = edge.points_error(spacing, 1000, threshold);
      EXPECT_LT(split.common + split.stochastic, worse) << spacing << ", " << threshold;
      worse = split.common + split.stochastic;
      EXPECT_GT(edge.queries(spacing, threshold), edge.queries(spacing, 2 * threshold));
    }
  }
}

TEST(VplPilot, NothingToSee) {
  const auto lights = ceiling(100, 1), dark = light_at(0, 0, 1, 0);
  const auto points = floor_points(8);
  std::vector<float> nowhere = points;
  for (std::size_t p = 0; p < nowhere.size(); p += POINT_WORDS) std::memset(&nowhere[p + POINT_TRIANGLE], 0xff, 4);
  for (const auto& none : {std::vector<float>{}, dark}) {
    EXPECT_TRUE(queried_lights(none).empty());
    EXPECT_THROW(facts_of(none, points, half, bounds_about(1)), Error);
  }
  for (const auto& none : {std::vector<float>{}, nowhere}) {
    EXPECT_TRUE(queried_points(none).empty());
    EXPECT_THROW(facts_of(lights, none, half, bounds_about(1)), Error);
  }
  EXPECT_EQ(queried_lights(lights).size(), Shape::lights * VPL_WORDS);
  EXPECT_EQ(queried_points(points).size(), 64u * (1 + Shape::spacings * Shape::neighbours) * POINT_WORDS);
}

// A worker that is broken or lies: numbers that nothing can be computed with.
TEST(VplPilot, RefusesFactsThatAreNone) {
  const auto facts = facts_of(ceiling(100, 1), floor_points(8), half, bounds_about(1));
  for (const double bad : {std::numeric_limits<double>::infinity(), std::nan(""), -1.0})
    for (const std::size_t at : {0u, 8u, 40u, 100u}) {
      auto broken = facts;
      std::memcpy(reinterpret_cast<char*>(&broken) + at * 8, &bad, 8);
      try {
        VplPilot pilot(broken, bounds_about(1));
        ADD_FAILURE() << "accepted " << bad << " at " << at;
      } catch (const Error& error) {
        EXPECT_THAT(error.what(), ::testing::HasSubstr("stage vpl.pilot"));
      }
    }
}

// --- The choice ---

VplTarget target_of(double spp, double error) {
  VplTarget target;
  target.pixels = 512 * 512;
  target.points = 96 * 96;
  target.spp = spp;
  target.error = error;
  target.made = 30000;
  target.samples = 16;
  target.usual_point_clusters = 1152;
  return target;
}

TEST(ChooseVpl, KeepsWhatIsSet) {
  const VplPilot pilot = pilot_beside_paths(1e-3, 8e-4);
  const VplCounts free = choose_vpl(pilot, target_of(16, 0)).counts;
  for (int what = 0; what < 5; ++what) {
    VplTarget target = target_of(16, 0);
    if (what == 0) target.count = 1234;
    if (what == 1) target.clusters = 777;
    if (what == 2) target.point_clusters = 99;
    if (what == 3) target.passes = 3;
    if (what == 4) target.residual_threshold = 0.033;
    const VplCounts chosen = choose_vpl(pilot, target).counts;
    EXPECT_EQ(chosen.count == 1234, what == 0);
    EXPECT_EQ(chosen.clusters == 777, what == 1);
    EXPECT_EQ(chosen.point_clusters == 99, what == 2);
    EXPECT_EQ(chosen.passes == 3, what == 3);
    EXPECT_EQ(chosen.residual_threshold == 0.033, what == 4);
  }
  // Neither clusters nor point clusters is a setting as well.
  VplTarget none = target_of(16, 0);
  none.clusters = 0;
  none.point_clusters = 0;
  const VplPrediction all = choose_vpl(pilot, none);
  EXPECT_EQ(all.counts.clusters, 0u);
  EXPECT_EQ(all.counts.point_clusters, 0u);
  EXPECT_EQ(all.clusters, 0);
  EXPECT_EQ(all.points, 0);
  EXPECT_GT(all.lights, 0);
  EXPECT_GT(free.clusters, 0u);
  EXPECT_GT(free.point_clusters, 0u);
}

TEST(ChooseVpl, TighterWishesCostMore) {
  const VplPilot pilot = pilot_beside_paths(1e-3, 8e-4);
  VplPrediction last;
  double loosest = 0;
  for (const double target : {0.2, 0.1, 0.05, 0.02}) {
    const VplPrediction f = choose_vpl(pilot, target_of(64, target));
    const double predicted = std::sqrt(kVplCaution * f.vpl() + f.paths) / f.mean;
    std::printf(
        "  target %.2f: predicted %.4f; %u VPLs, %u clusters, %u point clusters, %u passes, threshold %.2f, %.1f spp\n",
        target, predicted, f.counts.count, f.counts.clusters, f.counts.point_clusters, f.counts.passes,
        f.counts.residual_threshold, f.spp);
    EXPECT_LE(predicted, target * 1.001);
    EXPECT_GE(f.cost, last.cost);
    loosest = std::max(loosest, f.vpl());
    last = f;
  }
  EXPECT_LT(last.vpl(), loosest / 4);
  // Where samples cost next to nothing, it is the lights that have to meet the target.
  const VplPrediction f = choose_vpl(pilot_beside_paths(1e-6, 1e-6), target_of(64, 0.01));
  EXPECT_LE(std::sqrt(kVplCaution * f.vpl() + f.paths) / f.mean, 0.01001);
  EXPECT_GT(std::sqrt(kVplCaution * f.vpl()) / f.mean, 0.003) << "by doing many times too much";
  // Of a number of samples: the more of them, the less may the lights be off.
  const double few = choose_vpl(pilot, target_of(4, 0)).vpl(), many = choose_vpl(pilot, target_of(256, 0)).vpl();
  EXPECT_LT(many, few / 2);
}

// A denoiser takes the paths' noise away, and leaves what VPLs are off by.
TEST(ChooseVpl, DenoisedPicturesSpendMoreOnLights) {
  const VplPilot pilot = pilot_beside_paths(1e-3, 8e-4);
  for (const double spp : {4, 16, 64}) {
    VplTarget target = target_of(spp, 0);
    const VplPrediction sampled = choose_vpl(pilot, target);
    target.denoised = true;
    const VplPrediction denoised = choose_vpl(pilot, target);
    std::printf("  %g samples: VPLs leave %.3g and %.3g, in %u passes and %u\n", spp, sampled.vpl(), denoised.vpl(),
                sampled.counts.passes, denoised.counts.passes);
    // They are what frames flicker by.
    EXPECT_LT(denoised.vpl(), 0.15 * sampled.vpl()) << spp;
    EXPECT_GE(denoised.cost, sampled.cost) << spp;
  }
  // The same error takes fewer samples, but not where so many are needed that a denoiser finds nothing to do.
  const VplPilot noisy = pilot_beside_paths(1, 1);
  for (const double error : {0.5, 0.2, 0.001}) {
    VplTarget target = target_of(64, error);
    const double sampled = choose_vpl(noisy, target).spp;
    target.denoised = true;
    const double denoised = choose_vpl(noisy, target).spp;
    if (error > 0.01)
      EXPECT_LT(denoised, 0.9 * sampled) << error;
    else
      EXPECT_EQ(denoised, sampled);
  }
}

// --- The plan ---

// The floor and the ceiling above.
worker::BatchResult room(const PlannedStage& stage) {
  const StageSpec& spec = stage.spec;
  worker::BatchResult result;
  std::vector<float> values;
  if (spec.kind == "vpl_cluster") return first_lights(stage);
  if (spec.kind == "point_cluster") return first_points(stage);
  if (spec.kind == "vpl_visibility") {
    kernels::VisibilityParameters p;
    std::memcpy(&p, spec.parameters.data(), sizeof p);
    std::vector<float> lights = floats_of(*stage.inputs.at("lights"));
    lights.resize(std::size_t{p.clusters} * VPL_WORDS);  // without members
    result.records = bits(lights, floats_of(*stage.inputs.at("points")), half);
    return result;
  }
  const std::size_t words = spec.output.record_bytes / 4;
  if (spec.kind == "vpl_trace") {
    for (std::uint64_t i = 0; i < spec.items; ++i) {
      const std::uint64_t key = mixed(i + 77 * std::hash<std::string>()(spec.name));
      const auto row = light_at(2 * unit(key) - 1, 2 * unit(key + 1) - 1, 0.3, 1);
      values.insert(values.end(), row.begin(), row.end());
    }
    result.counts.assign(spec.items, 1);
  } else if (spec.kind == "vpl_points") {
    values = floor_points(static_cast<std::uint32_t>(std::ceil(std::sqrt(static_cast<double>(spec.items)))));
    values.resize(spec.items * words);
  } else {
    values.assign(spec.items * words, spec.kind == "vpl_shade" ? 0.05f : 0.0f);
  }
  if (spec.kind == "path") {
    kernels::PathParameters p;
    std::memcpy(&p, spec.parameters.data(), sizeof p);
    for (std::uint64_t i = 0; i < spec.items; ++i)
      for (std::size_t k = 0; k < 3; ++k)
        values[i * words + k] = static_cast<float>(p.samples_per_item * (0.1 + 0.2 * unit(p.seed_low + i * 3 + k)));
  }
  result.records = bytes_of_floats(values);
  return result;
}
const DeviceStage kRoom = room;

// `turn` says which of the waiting stages is done next.
class PilotFrame : public RunFrame {
 public:
  PilotFrame(const FrameSettings& settings, std::uint64_t turn)
      : RunFrame(make_plan(settings, {}), kRoom, [turn](std::size_t count) mutable {
          turn = mixed(turn);
          return static_cast<std::size_t>(turn % count);
        }) {}
};

FrameSettings frame_settings(const std::map<std::string, std::string>& set, double target = 0) {
  FrameSettings s;
  s.method = "vpl";
  s.width = 64;
  s.height = 48;
  s.spp = 16;
  s.target_error = target;
  s.set = set;
  return s;
}

nlohmann::json vpl_of(PilotFrame& frame) { return nlohmann::json::parse(frame.plan().parameters_json())["vpl"]; }

// Whichever stage ends first, the same is asked for and the same picture comes out.
TEST(VplPlan, PilotDoesNotDependOnWhatEndsFirst) {
  std::map<std::string, PlannedStage> first;
  std::string parameters;
  for (const std::uint64_t turn : {1, 2, 3, 4, 5, 6, 7, 8}) {
    PilotFrame frame(frame_settings({{"vpl.passes", "2"}}), turn);
    frame.run();
    ASSERT_TRUE(frame.stages.contains("vpl.pilot"));
    if (first.empty()) {
      first = frame.stages;
      parameters = frame.plan().parameters_json();
      continue;
    }
    EXPECT_EQ(frame.plan().parameters_json(), parameters);
    ASSERT_EQ(frame.stages.size(), first.size());
    for (const auto& [name, stage] : frame.stages) {
      ASSERT_TRUE(first.contains(name)) << name;
      EXPECT_EQ(stage.spec.parameters, first.at(name).spec.parameters) << name;
      for (std::size_t k = 0; k < stage.spec.inputs.size(); ++k)
        EXPECT_EQ(stage.spec.inputs[k].artifact, first.at(name).spec.inputs[k].artifact) << name;
    }
  }
}

// Lights, points, clusters and visibility stay with the workers: the coordinator gets records of pixels, and counts.
TEST(VplPlan, TheCoordinatorGetsPixelsAlone) {
  PilotFrame frame(frame_settings({}), 1);
  frame.run();
  const std::set<std::string> collected = {"vpl_shade", "vpl_skipped"};
  for (const auto& [name, stage] : frame.stages) {
    const bool of_pixels = name.starts_with("path.");
    EXPECT_EQ(stage.spec.output.placement, collected.contains(stage.spec.kind) ? Placement::collect
                                           : of_pixels                         ? Placement::stream
                                                                               : Placement::retain)
        << name;
    EXPECT_LE(stage.facts, std::size_t{1} << 10) << name;
  }
}

TEST(VplPlan, SetCountsAreKept) {
  const auto clusters_of = [](const PlannedStage& stage) {
    kernels::ClusterParameters p;
    std::memcpy(&p, stage.spec.parameters.data(), sizeof p);
    return p.clusters;
  };
  {
    // All three: a pilot has nothing to choose.
    PilotFrame frame(frame_settings({{"vpl.count", "900"}, {"vpl.clusters", "100"}, {"vpl.point_clusters", "50"}}), 1);
    frame.run();
    for (const auto& [name, stage] : frame.stages) EXPECT_FALSE(name.starts_with("vpl.pilot")) << name;
    EXPECT_EQ(clusters_of(frame.stages.at("vpl.cluster.0")), 100u);
    EXPECT_EQ(clusters_of(frame.stages.at("vpl.point_cluster")), 50u);
    EXPECT_FALSE(vpl_of(frame).contains("pilot"));
  }
  PilotFrame frame(frame_settings({{"vpl.clusters", "123"}}), 1);
  frame.run();
  EXPECT_TRUE(frame.stages.contains("vpl.pilot"));
  EXPECT_EQ(clusters_of(frame.stages.at("vpl.cluster.0")), 123u);
  EXPECT_EQ(vpl_of(frame)["clusters"], 123);
  // The clusters of points are of what they were chosen for: eight points each where there are as many.
  const PlannedStage& points = frame.stages.at("vpl.point_cluster");
  EXPECT_EQ(clusters_of(points), vpl_of(frame)["point_clusters"].get<std::uint32_t>());
  const std::size_t rows = points.inputs.at("points")->size() / (POINT_WORDS * 4),
                    looked = frame.stages.at("vpl.points").spec.items;
  EXPECT_EQ(rows, std::min<std::size_t>(looked, 8 * clusters_of(points)));
  for (const char* name :
       {"error", "error_of_lights", "error_of_clusters", "error_of_point_clusters", "error_of_paths"})
    EXPECT_GE(vpl_of(frame)["pilot"][name].get<double>(), 0) << name;

  PilotFrame own(frame_settings({{"vpl.point_clusters", "0"}, {"vpl.count", "500"}, {"vpl.clamp", "0"}}), 1);
  own.run();
  EXPECT_FALSE(own.stages.contains("vpl.point_cluster"));
  EXPECT_FALSE(own.stages.contains("vpl.visibility.0"));
  EXPECT_FALSE(vpl_of(own).contains("clamp_per_square_metre"));
  EXPECT_EQ(vpl_of(own)["kept"][0], 500);
}

// Frames of the same lights ask for the same light paths, whatever the pilot chose: those may be kept.
TEST(VplPlan, LightPathsAreThoseOfAnyChoice) {
  PilotFrame loose(frame_settings({}, 0.3), 1), tight(frame_settings({}, 0.02), 1);
  loose.run();
  tight.run();
  EXPECT_NE(vpl_of(loose)["clusters"], vpl_of(tight)["clusters"]);
  EXPECT_EQ(loose.stages.at("vpl.trace.0").spec.parameters, tight.stages.at("vpl.trace.0").spec.parameters);
  EXPECT_TRUE(loose.stages.at("vpl.trace.0").spec.output.reusable);
  // Samples get what the lights leave of the target.
  EXPECT_GT(tight.stages.size(), loose.stages.size());
}

TEST(VplPlan, TellsOfThePilotBeforehand) {
  const auto lines = [](const std::map<std::string, std::string>& set) {
    std::string all;
    for (const std::string& line : make_plan(frame_settings(set), {})->outline()) all += line + "\n";
    return all;
  };
  EXPECT_THAT(lines({}), ::testing::HasSubstr("vpl.pilot"));
  EXPECT_THAT(lines({{"vpl.count", "900"}, {"vpl.clusters", "100"}, {"vpl.point_clusters", "50"}}),
              ::testing::Not(::testing::HasSubstr("vpl.pilot")));
}

}  // namespace
}  // namespace gleaner::coordinator

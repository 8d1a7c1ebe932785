#include "coordinator/plan/limited_plan.h"

#include <gtest/gtest.h>

#include <cstring>
#include <limits>
#include <map>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "coordinator/plan/methods.h"
#include "scene/library/library.h"
#include "tests/unit/plan_frame.h"

namespace gleaner::coordinator {
namespace {

FrameSettings limited_settings(const std::string& method, std::uint32_t width, std::uint32_t height,
                               std::uint32_t spp) {
  FrameSettings settings;
  settings.method = method;
  settings.width = width;
  settings.height = height;
  settings.spp = spp;
  settings.limited = true;
  return settings;
}

// Work of all stages, by what is known once the farm is said to do `allowed` in the time that is left.
double planned_work(const FrameSettings& settings, double allowed) {
  const auto plan = make_plan(settings, summarize(scene::make_scene("cornell-box")));
  plan->allow(std::numeric_limits<double>::infinity());
  const Step first = plan->next(nullptr);
  EXPECT_EQ(first.stages.size(), 1u);
  const StageSpec& pace = first.stages.at(0);
  EXPECT_EQ(pace.name, "pace");
  EXPECT_FALSE(plan->conclude({{{pace.name, nullptr}, {}}})) << "there is no picture yet";
  plan->take(pace.name, 0, pace.items, Bytes(pace.items * pace.output.record_bytes));
  plan->allow(allowed);
  const FinishedStage finished{pace.name, nullptr, pace.items, {}};
  const Step step = plan->next(&finished);
  double work = plan->predicted_work();
  for (const StageSpec& stage : step.stages) work += work_of(stage);
  return work;
}

TEST(LimitedPlan, EveryMethodIsPlannedForTheTimeThereIs) {
  for (const Method& method : methods()) {
    if (method.name == "ao") continue;  // it makes do with a few rays
    const FrameSettings settings = limited_settings(std::string(method.name), 320, 240, 1024);
    const double all = planned_work(settings, 1e15);
    for (const double share : {0.02, 0.1, 0.5}) {
      const double work = planned_work(settings, share * all);
      EXPECT_LT(work, 0.9 * share * all) << method.name;
      EXPECT_GT(work, 0.2 * share * all) << method.name;
    }
  }
}

TEST(LimitedPlan, AFarmThatNobodyKnowsIsGivenLittleAtFirst) {
  for (const Method& method : methods()) {
    if (method.name == "ao") continue;
    const FrameSettings settings = limited_settings(std::string(method.name), 320, 240, 1024);
    EXPECT_LT(planned_work(settings, std::numeric_limits<double>::infinity()), 0.1 * planned_work(settings, 1e15))
        << method.name;
  }
}

TEST(LimitedPlan, SamplesGoOnWhereTheFarmIsFasterThanItLooked) {
  const Truth truth = {std::vector<double>(12 * 8, 1.0), [](std::uint32_t, double u) { return 2 * u; }};
  PlannedFrame frame(limited_settings("path", 12, 8, 200), truth);
  frame.run();
  const Film film = frame.plan().film();
  std::uint64_t samples = 0;
  for (const float n : film.find("samples.Y")->values) samples += static_cast<std::uint64_t>(n);
  EXPECT_EQ(samples, 12u * 8 * 200) << "those of the pace are no part of the picture";
  const auto parameters = nlohmann::json::parse(frame.plan().parameters_json());
  EXPECT_EQ(parameters["planned_spp"], 16) << "nobody told how fast the farm is";
}

// However early a stage is cut, no pixel that still wants chunks has two less than another.
TEST(LimitedPlan, WhatIsCutIsSpreadOverThePicture) {
  Truth truth;
  truth.mean.assign(16 * 12, 1.0);
  truth.sample = [](std::uint32_t pixel, double u) { return 1 + (pixel % 16 < 8 ? 0.2 : 0.6) * (2 * u - 1); };
  PlannedFrame frame(limited_settings("path", 16, 12, 400), truth);
  frame.run();
  ASSERT_GT(frame.runs().size(), 3u);
  for (const StageRun& run : frame.runs()) {
    if (run.spec.inputs.empty()) continue;
    std::map<std::uint32_t, std::size_t> whole, part;
    for (const auto& item : run.items) ++whole[item.pixel];
    for (std::size_t i = 0; i < run.items.size() / 2; ++i) ++part[run.items[i].pixel];
    std::size_t most = 0;
    for (const auto& [pixel, count] : part) most = std::max(most, count);
    for (const auto& [pixel, count] : whole)
      EXPECT_GE(part[pixel] + 1, std::min(count, most)) << run.spec.name << ", pixel " << pixel;
  }
}

}  // namespace
}  // namespace gleaner::coordinator

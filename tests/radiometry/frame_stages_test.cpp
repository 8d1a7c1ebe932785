// What plans say of the stages they ask for: how much work they are, and which of their records are numbers.

#include "scene/library/library.h"
#include "tests/radiometry/rendered_frame.h"

namespace gleaner::test {
namespace {

struct Method {
  std::string name;
  Settings set;
};

// A small frame, and every stage that its plan asks for.
class FrameStages : public testing::TestWithParam<Method> {
 protected:
  void SetUp() override {
    const Frame frame = square_frame(GetParam().name, scene::make_scene("cornell-glass"), "", 48, 16, GetParam().set);
    worker::Executor& on = executor(frame.trace);
    const std::string id = load(on, frame.scene);
    plan_ = coordinator::make_plan(frame.settings, coordinator::summarize(*frame.scene));
    cli::run_frame(*plan_, on, id, [&](const coordinator::StageSpec& stage, const worker::StageTask&) {
      // The first stage has been asked for.
      if (stages_.empty()) predicted_ = plan_->predicted_work() + coordinator::work_of(stage);
      stages_.push_back(stage);
      return true;
    });
  }

  std::unique_ptr<coordinator::Plan> plan_;
  std::vector<coordinator::StageSpec> stages_;
  double predicted_ = 0;
};

// Progress and the time left rest on it.
TEST_P(FrameStages, WorkIsPredictedWithinAFactorOfTwo) {
  double asked = 0;
  for (const coordinator::StageSpec& stage : stages_) asked += coordinator::work_of(stage);
  EXPECT_GT(predicted_, asked / 2);
  EXPECT_LT(predicted_, asked * 2);
  EXPECT_EQ(plan_->predicted_work(), 0) << "the frame is done";
}

// The farm refuses NaN and infinity in records of numbers before a film holds them.
TEST_P(FrameStages, RecordsThatTheFilmGetsAreNumbers) {
  for (const coordinator::StageSpec& stage : stages_) {
    const bool stays = stage.output.placement == coordinator::Placement::retain;
    EXPECT_TRUE(stays || stage.output.floats || stage.kind == "vpl_skipped") << stage.name;
  }
}

const Method methods[] = {
    {"path", {}},
    {"ao", {}},
    {"vpl", {{"vpl.passes", "4"}}},
    {"vpl", {{"vpl.count", "500"}, {"vpl.clusters", "100"}, {"vpl.point_clusters", "256"}}},
    {"photon", {{"photon.passes", "4"}, {"photon.count", "4096"}, {"photon.caustics", "4096"}}},
    {"photon", {{"photon.count", "4096"}, {"photon.caustics", "4096"}, {"photon.guide", "4096"}}},
    {"links", {{"links.vertices", "200"}}},
    {"splat", {{"splat.gather_rays", "64"}}},
};
INSTANTIATE_TEST_SUITE_P(Methods, FrameStages, testing::ValuesIn(methods),
                         [](const auto& instance) { return instance.param.name + std::to_string(instance.index); });

}  // namespace
}  // namespace gleaner::test

// Frames side by side on real workers: the same bits as one after another, and files that can be fetched at once.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <set>

#include "tests/farm/processes.h"

namespace gleaner::test {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;
using testing::HasSubstr;

const fs::path programs = GLEANER_BIN_DIR;
constexpr int frames = 4;

class SideBySideProcesses : public testing::TestWithParam<const char*> {
 protected:
  void SetUp() override {
    Process made({(programs / "gleaner").string(), "scene", "turntable", "-o", scene().string()},
                 folder_.path() / "scene");
    ASSERT_EQ(made.wait(), 0) << made.err();
  }
  fs::path scene() const { return folder_.path() / "moving.glb"; }
  std::vector<std::string> words() const {
    return {scene().string(), "--size", "96x64",    "--spp",   "64", "--frames", "1-4",
            "--fps",          "2",      "--method", GetParam()};
  }
  static std::string name(int frame, const char* extension) {
    return std::string("frame_000").append(std::to_string(frame)).append(extension);
  }
  // Of all frames, as the job's fetched reports say.
  static std::vector<std::string> pixels(const ProcessFarm& farm, const std::string& job) {
    std::vector<std::string> all;
    for (int frame = 1; frame <= frames; ++frame)
      all.push_back(json::parse(read_text(farm.fetched(job) / name(frame, ".json")))["pixels_sha256"]);
    return all;
  }

  TemporaryFolder folder_;
};
INSTANTIATE_TEST_SUITE_P(Methods, SideBySideProcesses, testing::Values("path", "vpl"),
                         [](const auto& method) { return std::string(method.param); });

TEST_P(SideBySideProcesses, FramesHaveTheBitsOfOneAfterAnother) {
  ProcessFarm one(folder_.path() / "one", programs, {"--frames-at-once", "1"});
  one.add_worker("alone");
  const std::string alone = one.submit(words());
  one.finish(alone);

  ProcessFarm farm(folder_.path() / "farm", programs);
  for (const char* worker : {"a", "b", "c"}) farm.add_worker(worker);
  ASSERT_TRUE(farm.wait_for_workers(3));
  const std::string job = farm.submit(words());
  const auto watched = farm.begin_gleaner({"watch", job});
  int side_by_side = 0;
  fs::path early;  // where files were fetched while other frames ran
  double progress = 0;
  while (!farm.ended(job)) {
    const v1::Job status = farm.job(job);
    side_by_side = std::max(side_by_side, status.running_size());
    EXPECT_GE(status.progress(), progress);
    progress = status.progress();
    if (status.frames_done() > 0 && early.empty()) {
      early = folder_.path() / "early";
      const Ran ran = farm.gleaner({"fetch", job, "-o", early.string()});
      EXPECT_EQ(ran.status, 0) << ran.err;
      EXPECT_TRUE(fs::exists(early / name(static_cast<int>(status.written(0).first()), ".exr"))) << ran.err;
    }
    std::this_thread::sleep_for(std::chrono::milliseconds(20));
  }
  EXPECT_EQ(watched->wait(), 0) << watched->err();
  EXPECT_THAT(watched->err(), HasSubstr("written, and can be fetched: frames "));
  EXPECT_FALSE(early.empty());
  EXPECT_GE(side_by_side, 2);
  EXPECT_LE(side_by_side, 3) << "no more than there are workers";
  farm.finish(job);
  EXPECT_EQ(pixels(farm, job), pixels(one, alone));
  const auto all = pixels(farm, job);
  EXPECT_EQ(std::set(all.begin(), all.end()).size(), std::size_t{frames}) << "every frame is another picture";
}

TEST_P(SideBySideProcesses, TheNextCoordinatorGoesOnWithFramesThatWereBegun) {
  ProcessFarm farm(folder_.path() / "farm", programs);
  for (const char* worker : {"a", "b", "c"}) farm.add_worker(worker);
  ASSERT_TRUE(farm.wait_for_workers(3));
  const std::string whole = farm.submit(words());
  farm.finish(whole);
  const std::string job = farm.submit(words());
  ASSERT_TRUE(eventually([&] { return farm.job(job).running_size() >= 2 || farm.ended(job); }, 120));
  farm.restart();
  farm.finish(job);
  EXPECT_EQ(pixels(farm, job), pixels(farm, whole));
}

}  // namespace
}  // namespace gleaner::test

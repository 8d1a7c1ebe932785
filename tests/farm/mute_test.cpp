// Workers that say that they live, take what they are given and never answer: they cost a frame little time and no
// pixel.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/farm/mute_worker.h"
#include "tests/farm/processes.h"

namespace gleaner::test {
namespace {

namespace fs = std::filesystem;
using Clock = std::chrono::steady_clock;

const fs::path programs = GLEANER_BIN_DIR;

class Mute : public testing::TestWithParam<const char*> {
 protected:
  static void SetUpTestSuite() {
    shared_ = new TemporaryFolder;
    Process made(
        {(programs / "gleaner").string(), "scene", "cornell-box", "-o", (shared_->path() / "box.glb").string()},
        shared_->path() / "made");
    ASSERT_EQ(made.wait(), 0) << made.err();
  }
  static void TearDownTestSuite() { delete shared_; }

  struct Rendered {
    std::string sha256;
    double seconds = 0;
  };
  static Rendered render(ProcessFarm& farm, const std::string& method, int seed) {
    const auto begun = Clock::now();
    const std::string job = farm.submit({(shared_->path() / "box.glb").string(), "--size", "160x120", "--spp", "16",
                                         "--seed", std::to_string(seed), "--method", method});
    const nlohmann::json report = farm.finish(job);
    return {report["pixels_sha256"], std::chrono::duration<double>(Clock::now() - begun).count()};
  }

  static void add_honest(ProcessFarm& farm, const std::string& method) {
    for (const char* name : {"ada", "bob"}) farm.add_worker(name);
    ASSERT_TRUE(farm.wait_for_workers(2));
    render(farm, method, 1);  // compiles
  }

  TemporaryFolder folder_;
  static inline TemporaryFolder* shared_ = nullptr;
};
INSTANTIATE_TEST_SUITE_P(Method, Mute, testing::Values("path", "vpl"),
                         [](const auto& method) { return std::string(method.param); });

TEST_P(Mute, TheyCostLittleTimeAndNoPixel) {
  const std::string method = GetParam();
  Rendered honest;
  {
    ProcessFarm farm(folder_.path() / "honest", programs);
    add_honest(farm, method);
    honest = render(farm, method, 7);
  }
  ProcessFarm farm(folder_.path() / "farm", programs);
  add_honest(farm, method);
  std::vector<std::unique_ptr<MuteWorker>> mute;
  const v1::Device device = farm.workers().front().device();
  for (int i = 0; i < 3; ++i)
    mute.push_back(std::make_unique<MuteWorker>(farm.address(), "mute-" + std::to_string(i), device));
  ASSERT_TRUE(farm.wait_for_workers(5));
  const Rendered among_mute = render(farm, method, 7);
  std::printf("%s: %.2f s, among mute workers %.2f s\n", method.c_str(), honest.seconds, among_mute.seconds);
  EXPECT_EQ(among_mute.sha256, honest.sha256);
  int leases = 0;
  for (const auto& worker : mute) leases += worker->leases();
  EXPECT_GT(leases, 0) << "they were not asked";
  // A lease lasts 30 s, one of a solo stage 300 s.
  EXPECT_LT(among_mute.seconds, 2 * honest.seconds + 10);
}

}  // namespace
}  // namespace gleaner::test

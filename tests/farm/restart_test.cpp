// Coordinators that are killed, and what the next one on the same data does. With $GLEANER_KILLS the coordinator is
// killed at so many random moments instead of a few.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstdlib>
#include <random>
#include <set>

#include "tests/farm/processes.h"
#include "tests/unit/import_files.h"

namespace gleaner::test {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;
using testing::HasSubstr;

const fs::path programs = GLEANER_BIN_DIR;

unsigned kills() {
  const char* text = std::getenv("GLEANER_KILLS");
  return text ? static_cast<unsigned>(std::stoul(text)) : 3;
}

class Restart : public testing::Test {
 protected:
  void SetUp() override {
    Process made({(programs / "gleaner").string(), "scene", "cornell-box", "-o", scene().string()},
                 folder_.path() / "scene");
    ASSERT_EQ(made.wait(), 0) << made.err();
  }
  fs::path scene() const { return folder_.path() / "box.glb"; }
  std::vector<std::string> frame(const std::string& method, unsigned spp) const {
    return {scene().string(), "--size", "96x64", "--spp", std::to_string(spp), "--seed", "3", "--method", method};
  }

  TemporaryFolder folder_;
};

class RestartOf : public Restart, public testing::WithParamInterface<const char*> {};
INSTANTIATE_TEST_SUITE_P(Farm, RestartOf, testing::Values("path", "vpl"),
                         [](const auto& method) { return std::string(method.param); });

TEST_P(RestartOf, SameBitsWhereverTheCoordinatorIsKilled) {
  ProcessFarm farm(folder_.path() / "farm", programs);
  farm.add_worker("one");
  farm.add_worker("two");
  ASSERT_TRUE(farm.wait_for_workers(2));
  const auto words = frame(GetParam(), 256);
  const json whole = farm.finish(farm.submit(words));
  const double seconds = whole["seconds"];
  std::mt19937_64 random{std::random_device{}()};
  for (unsigned kill = 0; kill < kills(); ++kill) {
    const std::string job = farm.submit(words);
    const double after = std::uniform_real_distribution<double>(0, 1.2 * seconds)(random);
    std::this_thread::sleep_for(std::chrono::duration<double>(after));
    farm.restart();
    EXPECT_EQ(farm.finish(job)["pixels_sha256"], whole["pixels_sha256"]) << "killed after " << after << " s";
  }
}

TEST_F(Restart, WhatWasSubmittedIsRenderedOnce) {
  ProcessFarm farm(folder_.path() / "farm", programs);
  std::vector<std::string> words = frame("path", 4), jobs;
  words.insert(words.end(), {"--frames", "1-3"});
  for (int i = 0; i < 3; ++i) jobs.push_back(farm.submit(words));
  farm.gleaner({"cancel", jobs[1]});
  farm.restart();
  farm.add_worker("one");
  for (int i : {0, 2}) farm.finish(jobs[static_cast<std::size_t>(i)]);
  EXPECT_EQ(farm.show(jobs[1])["state"], "cancelled");
  farm.restart(SIGTERM);
  farm.restart();
  const json list = json::parse(farm.gleaner({"list", "--json"}).out);
  ASSERT_EQ(list.size(), 3u);
  for (std::size_t i = 0; i < 3; ++i) {
    EXPECT_EQ(list[i]["job"], jobs[i]);
    EXPECT_EQ(list[i]["frames_done"], i == 1 ? 0 : 3);
  }
  EXPECT_EQ(farm.gleaner({"fetch", jobs[2], "-o", (folder_.path() / "again").string()}).status, 0);
  EXPECT_TRUE(fs::exists(folder_.path() / "again" / "frame_0003.exr"));
}

// A triangle that glows and rises.
scene::GltfFile moving_file() {
  scene::GltfFile file = scene::triangle_file();
  file.json["materials"][0]["emissiveFactor"] = {1, 1, 1};
  const std::size_t times = file.add(std::vector<float>{0, 1}, 5126, "SCALAR");
  const std::size_t values = file.add(std::vector<float>{0, 0, 0, 0, 0.5f, 0}, 5126, "VEC3");
  file.json["animations"] = {{{"channels", {{{"sampler", 0}, {"target", {{"node", 0}, {"path", "translation"}}}}}},
                              {"samplers", {{{"input", times}, {"output", values}}}}}};
  return file;
}

// What the journal keeps of a job's frames says which state of the base each one shows.
TEST_F(Restart, FramesOfAMovingSceneGoOnInTheirStates) {
  std::ofstream(folder_.path() / "moving.glb", std::ios::binary) << moving_file().glb();
  ProcessFarm farm(folder_.path() / "farm", programs);
  farm.add_worker("one");
  ASSERT_TRUE(farm.wait_for_workers(1));
  std::vector<std::string> words = {(folder_.path() / "moving.glb").string(), "--size", "64x64", "--spp", "256"};
  words.insert(words.end(), {"--frames", "1-10x3", "--fps", "9", "--look-at", "0,0,4,0,0,0"});
  const auto pixels = [&](const std::string& job) {
    farm.finish(job);
    std::vector<std::string> all;
    for (const char* report : {"frame_0001.json", "frame_0004.json", "frame_0007.json", "frame_0010.json"})
      all.push_back(json::parse(read_text(farm.fetched(job) / report))["pixels_sha256"]);
    return all;
  };
  const std::vector<std::string> whole = pixels(farm.submit(words));
  EXPECT_EQ(std::set(whole.begin(), whole.end()).size(), 4u) << "every frame shows another state";
  for (const unsigned written : {0u, 1u, 3u}) {
    const std::string job = farm.submit(words);
    ASSERT_TRUE(eventually([&] { return farm.job(job).frames_done() >= written; }, 60));
    farm.restart();
    EXPECT_EQ(pixels(job), whole) << "killed with " << written << " frames written";
  }
}

TEST_F(Restart, ADamagedJournalIsSaidAndPicturesStay) {
  ProcessFarm farm(folder_.path() / "farm", programs);
  farm.add_worker("one");
  const std::string job = farm.submit(frame("path", 2));
  farm.finish(job);
  farm.coordinator().signal(SIGTERM);
  farm.coordinator().wait();
  const fs::path journal = farm.data() / "journal.sqlite";
  std::ofstream(journal, std::ios::trunc) << std::string(8192, 'x');
  Process again(
      {(programs / "gleaner-coordinator").string(), "--listen", "127.0.0.1:0", "--data", farm.data().string()},
      folder_.path() / "again");
  EXPECT_EQ(again.wait(), 1);
  EXPECT_THAT(again.err(), HasSubstr(journal.string()));
  EXPECT_THAT(again.err(), HasSubstr("damaged"));
  EXPECT_TRUE(fs::exists(farm.data() / "jobs" / job / "frame_0001.exr"));
  // Moved away, as it is said there, it is in nobody's way.
  fs::remove(journal);
  Process anew({(programs / "gleaner-coordinator").string(), "--listen", "127.0.0.1:0", "--data", farm.data().string()},
               folder_.path() / "anew");
  EXPECT_TRUE(eventually([&] { return !anew.out().empty(); })) << anew.err();
}

}  // namespace
}  // namespace gleaner::test

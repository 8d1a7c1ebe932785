// Coordinators that are killed, and what the next one on the same data does. With $GLEANER_KILLS the coordinator is
// killed at so many random moments instead of a few.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cstdlib>
#include <ctime>
#include <functional>
#include <iostream>
#include <memory>
#include <random>
#include <set>

#include "tests/farm/postgres_server.h"
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

// Items that the next coordinator found accepted.
std::uint64_t items_taken_over(const json& report) {
  std::uint64_t items = 0;
  for (const json& skip : report["skips"])
    if (skip["why"].get<std::string>().starts_with("accepted before the frame"))
      items += skip["count"].get<std::uint64_t>();
  return items;
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

struct Kind {
  const char* method;
  unsigned workers;
  unsigned samples = 0;   // of a frame that takes a second or more
  bool postgres = false;  // the journal lies there
};

class RestartOf : public Restart, public testing::WithParamInterface<Kind> {
 protected:
  void SetUp() override {
    Restart::SetUp();
    std::vector<std::string> options;
    if (GetParam().postgres) {
#ifndef GLEANER_POSTGRES
      GTEST_SKIP() << "the coordinator was built without PostgreSQL";
#endif
      if (const std::string why = PostgresServer::missing(); !why.empty()) GTEST_SKIP() << why;
      postgres_ = std::make_unique<PostgresServer>();
      options = {"--journal", postgres_->address()};
    }
    farm_ = std::make_unique<ProcessFarm>(folder_.path() / "farm", programs, options);
    for (unsigned i = 0; i < GetParam().workers; ++i) farm_->add_worker("worker-" + std::to_string(i));
    ASSERT_TRUE(farm_->wait_for_workers(GetParam().workers));
  }

  std::unique_ptr<PostgresServer> postgres_;
  std::unique_ptr<ProcessFarm> farm_;
};
INSTANTIATE_TEST_SUITE_P(Farm, RestartOf,
                         testing::Values(Kind{"path", 1, 256}, Kind{"path", 3, 256}, Kind{"vpl", 1, 64},
                                         Kind{"vpl", 3, 64}, Kind{"path", 1, 256, true}),
                         [](const auto& kind) {
                           return kind.param.method + std::to_string(kind.param.workers) +
                                  (kind.param.postgres ? "postgres" : "");
                         });

TEST_P(RestartOf, SameBitsWhereverTheCoordinatorIsKilled) {
  const std::vector<std::string> words = frame(GetParam().method, GetParam().samples);
  const json whole = farm_->finish(farm_->submit(words));
  const double seconds = whole["seconds"];
  std::mt19937_64 random{std::random_device{}()};
  for (unsigned kill = 0; kill < kills(); ++kill) {
    const std::string job = farm_->submit(words);
    const double after = std::uniform_real_distribution<double>(0, 1.2 * seconds)(random);
    std::this_thread::sleep_for(std::chrono::duration<double>(after));
    farm_->restart();
    const json report = farm_->finish(job);
    EXPECT_EQ(report["pixels_sha256"], whole["pixels_sha256"]) << "killed after " << after << " s";
    std::cout << "killed after " << after << " s of " << seconds << ", done after " << report["seconds"]
              << " s; taken over: " << items_taken_over(report) << " items\n";
  }
}

TEST_P(RestartOf, WhatWasAcceptedIsNotComputedAgain) {
  // How long a frame takes says little on a busy machine, so one that has nearly ended before the kill is made longer.
  for (unsigned samples = GetParam().samples; samples <= 256 * GetParam().samples; samples *= 2) {
    const std::vector<std::string> words = frame(GetParam().method, samples);
    const json whole = farm_->finish(farm_->submit(words));
    std::uint64_t all = 0, done = 0;
    for (const json& stage : whole["stages"]) all += stage["items"].get<std::uint64_t>();
    const std::string job = farm_->submit(words);
    const auto quarter_is_done = [&] {
      done = farm_->items_done(job);
      return done > all / 4 || farm_->ended(job);
    };
    ASSERT_TRUE(eventually(quarter_is_done, 120));
    std::this_thread::sleep_for(std::chrono::milliseconds(400));  // until the journal knows
    if (farm_->ended(job) || farm_->items_done(job) > 3 * all / 4) continue;
    farm_->restart();
    const json report = farm_->finish(job);
    EXPECT_EQ(report["pixels_sha256"], whole["pixels_sha256"]);
    // On a busy machine the journal may not know of the last ones.
    EXPECT_GT(items_taken_over(report), done / 4);
    return;
  }
  FAIL() << "every frame ended before the coordinator was killed";
}

TEST_F(Restart, WhatWasSubmittedIsRenderedOnce) {
  ProcessFarm farm(folder_.path() / "farm", programs);
  std::vector<std::string> words = frame("path", 4), jobs;
  words.insert(words.end(), {"--frames", "1-3"});
  const auto submitted = static_cast<double>(std::time(nullptr));
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
    EXPECT_NEAR(list[i]["submitted_unix_seconds"].get<double>(), submitted, 120);
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

TEST_F(Restart, AWatchGoesOnWithTheNextCoordinator) {
  for (const int signal : {SIGKILL, SIGTERM}) {
    ProcessFarm farm(folder_.path() / ("farm-" + std::to_string(signal)), programs);
    const std::string job = farm.submit(frame("path", 4));
    const auto watched = farm.begin_gleaner({"watch", job, "--preview", (folder_.path() / "preview.png").string()});
    ASSERT_TRUE(eventually([&] { return watched->err().find("no worker is connected") != std::string::npos; }, 120))
        << watched->err();
    farm.restart(signal);
    farm.add_worker("one");
    EXPECT_EQ(watched->wait(), 0) << watched->err();
    EXPECT_THAT(watched->err(), testing::ContainsRegex("coordinator at .*; trying again\n"));
    EXPECT_THAT(watched->err(), HasSubstr("answers again"));
    EXPECT_THAT(watched->err(), HasSubstr("done"));
  }
}

TEST_F(Restart, AWatchGivesUpWhereItIsTold) {
  ProcessFarm farm(folder_.path() / "farm", programs);
  const std::string job = farm.submit(frame("path", 4));
  const auto watched = farm.begin_gleaner({"watch", job, "--give-up", "1"});
  ASSERT_TRUE(eventually([&] { return !watched->err().empty(); }, 120));
  farm.coordinator().signal(SIGKILL);
  EXPECT_EQ(watched->wait(), 4);
  EXPECT_THAT(watched->err(), HasSubstr("given up"));
}

// A job whose frames are states of a base: every second one of five.
class RestartOfMoving : public RestartOf {
 protected:
  void SetUp() override {
    Restart::SetUp();
    Process made({(programs / "gleaner").string(), "scene", "turntable", "-o", moving().string()},
                 folder_.path() / "moving");
    ASSERT_EQ(made.wait(), 0) << made.err();
    farm_ = std::make_unique<ProcessFarm>(folder_.path() / "farm", programs);
    farm_->add_worker("one");
  }
  fs::path moving() const { return folder_.path() / "moving.glb"; }
  // Does that once its first frame is written, and compares its frames with those of a job that nothing happens to.
  void expect_same_frames(const std::function<void()>& happens) {
    const std::vector<std::string> words = {moving().string(), "--size", "160x120", "--spp", "64",
                                            "--frames",        "1-5x2",  "--fps",   "2",     "--method",
                                            GetParam().method};
    const std::string whole = farm_->submit(words);
    farm_->finish(whole);
    const std::string job = farm_->submit(words);
    ASSERT_TRUE(eventually([&] { return farm_->job(job).frames_done() >= 1; }, 120));
    happens();
    farm_->finish(job);
    EXPECT_EQ(farm_->show(job)["frames_done"], 3);
    for (const char* frame : {"frame_0001.json", "frame_0003.json", "frame_0005.json"}) {
      const auto pixels = [&](const std::string& id) {
        return json::parse(read_text(folder_.path() / "farm" / ("fetched-" + id) / frame))["pixels_sha256"];
      };
      EXPECT_EQ(pixels(job), pixels(whole)) << frame;
    }
  }
};
INSTANTIATE_TEST_SUITE_P(Farm, RestartOfMoving, testing::Values(Kind{"path", 1}, Kind{"vpl", 1}),
                         [](const auto& kind) { return std::string(kind.param.method); });

TEST_P(RestartOfMoving, SameFramesAfterTheCoordinatorIsKilled) {
  expect_same_frames([&] { farm_->restart(); });
}

TEST_P(RestartOfMoving, SameFramesAfterAWorkerIsKilled) {
  Process& second = farm_->add_worker("two");
  ASSERT_TRUE(farm_->wait_for_workers(2));
  expect_same_frames([&] { second.signal(SIGKILL); });
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

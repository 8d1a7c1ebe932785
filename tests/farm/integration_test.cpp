// The real programs on one machine: the same bits whoever renders, whatever dies; the words and statuses people rely
// on.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <set>

#include "tests/farm/processes.h"

namespace gleaner::test {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;
using testing::HasSubstr;
using testing::Not;

const fs::path programs = GLEANER_BIN_DIR;

class Farm : public testing::Test {
 protected:
  static void SetUpTestSuite() {
    shared_ = new TemporaryFolder;
    Ran made = run({"scene", "cornell-box", "-o", scene().string()});
    ASSERT_EQ(made.status, 0) << made.err;
    // One lobe that harmonics of order 4 hold, and one that is too sharp.
    made = run({"scene", "cornell-glossy", "--set", "short=0.6", "--set", "tall=0.46", "-o", glossy_scene().string()});
    ASSERT_EQ(made.status, 0) << made.err;
  }
  static void TearDownTestSuite() {
    delete shared_;
    shared_ = nullptr;
  }

  static fs::path scene() { return shared_->path() / "box.glb"; }
  static fs::path glossy_scene() { return shared_->path() / "glossy.glb"; }

  // `gleaner WORDS...` without a farm.
  static Ran run(std::vector<std::string> words, const std::map<std::string, std::string>& environment = {}) {
    static int calls = 0;
    words.insert(words.begin(), (programs / "gleaner").string());
    auto variables = environment;
    variables.emplace("GLEANER_COORDINATOR", "");
    Process process(words, shared_->path() / (std::string("run").append(std::to_string(calls++))), variables);
    Ran ran;
    ran.status = process.wait();
    ran.out = process.out();
    ran.err = process.err();
    return ran;
  }

  static bool in_glossy_scene() { return method_ == "photon_lobes" || method_ == "splat_lobes"; }

  static std::vector<std::string> frame(unsigned spp) {
    std::vector<std::string> words = {(in_glossy_scene() ? glossy_scene() : scene()).string(),
                                      "--size",
                                      "80x60",
                                      "--spp",
                                      std::to_string(spp),
                                      "--seed",
                                      "7"};
    append_method(words);
    return words;
  }

  // The method is what its name begins with; the rest says what of it is turned on.
  static void append_method(std::vector<std::string>& words) {
    static const std::map<std::string, std::vector<std::string>> settings = {
        {"photon", {"photon.guide=20000"}},
        {"photon_lobes", {"photon.order=4"}},
        {"splat_lobes", {"splat.hessian=1", "splat.order=5"}}};
    words.insert(words.end(), {"--method", method_.substr(0, method_.find('_'))});
    if (!settings.contains(method_)) return;
    for (const std::string& setting : settings.at(method_)) words.insert(words.end(), {"--set", setting});
  }

  // What the embedded farm makes of the frame.
  static std::string embedded_sha256(unsigned spp, unsigned workers = 1, unsigned batch_items = 0) {
    std::string stem =
        (shared_->path() /
         (std::string("embedded").append(std::to_string(spp)).append("-").append(std::to_string(workers))))
            .string();
    std::vector<std::string> words = frame(spp);
    words.insert(words.begin(), "render");
    for (const std::string& word :
         {std::string("-o"), stem + ".exr", std::string("--report"), stem + ".json", std::string("--workers"),
          std::to_string(workers), std::string("--batch-items"), std::to_string(batch_items)})
      words.push_back(word);
    Ran ran = run(words);
    if (ran.status != 0) throw Error::failed("render: " + ran.err);
    return json::parse(read_text(stem + ".json"))["pixels_sha256"];
  }

  // A worker is killed that works on the stage, or on any.
  static void expect_same_bits_after_a_kill(ProcessFarm& farm, const std::string& stage);

  fs::path folder(const std::string& name) const { return own_.path() / name; }

  TemporaryFolder own_;
  static TemporaryFolder* shared_;
  static std::string method_;
};
TemporaryFolder* Farm::shared_ = nullptr;
std::string Farm::method_ = "path";

// What must hold whichever method makes the picture.
class AnyMethod : public Farm, public testing::WithParamInterface<const char*> {
 protected:
  void SetUp() override { method_ = GetParam(); }
  void TearDown() override { method_ = "path"; }
};
INSTANTIATE_TEST_SUITE_P(Farm, AnyMethod,
                         testing::Values("path", "vpl", "photon", "photon_lobes", "splat", "splat_lobes"),
                         [](const auto& test) { return std::string(test.param); });

// The cloth has no rough lobes.
class MovingFrames : public AnyMethod {};
INSTANTIATE_TEST_SUITE_P(Farm, MovingFrames, testing::Values("path", "vpl", "photon", "splat"),
                         [](const auto& test) { return std::string(test.param); });

TEST_P(AnyMethod, SameBitsForAnyWorkersAndAnyBatches) {
  const unsigned spp = 8;
  const std::string expected = embedded_sha256(spp);
  EXPECT_EQ(embedded_sha256(spp, 3, 333), expected) << "three workers in one process";
  struct {
    unsigned workers;
    const char* batch_items;
  } const farms[] = {{1, "0"}, {2, "64"}, {3, "1000"}, {7, "517"}};
  for (const auto& [workers, batch_items] : farms) {
    ProcessFarm farm(folder(std::string("farm").append(std::to_string(workers))), programs,
                     {"--batch-items", batch_items});
    for (unsigned i = 0; i < workers; ++i) farm.add_worker(std::string("w").append(std::to_string(i)));
    ASSERT_TRUE(farm.wait_for_workers(workers));
    json report = farm.finish(farm.submit(frame(spp)));
    EXPECT_EQ(report["pixels_sha256"], expected) << workers << " workers, batches of " << batch_items;
    EXPECT_EQ(report["scene"], in_glossy_scene() ? "glossy.glb" : "box.glb");
    if (method_ == "photon_lobes") {
      EXPECT_GT(report["parameters"]["photon"]["lobe_places"], 10);
    }
    if (method_ == "splat_lobes") {
      EXPECT_GT(report["parameters"]["splat"]["first_records"], 10);
      EXPECT_GT(report["parameters"]["splat"]["lobe_records"], 10);
    }
    EXPECT_GT(report["seconds"], 0);
    EXPECT_GT(report["rays"]["total"], 0);
  }
}

// Runs `act` on a job that has begun and not ended, with ever longer frames until it did: INCONCLUSIVE is not a pass.
// It has begun where items are done, or items of one stage.
template <typename Act>
void mid_frame(ProcessFarm& farm, const std::function<std::vector<std::string>(unsigned)>& words, const Act& act,
               const std::string& stage = {}) {
  for (unsigned spp = 64; spp <= 16384; spp *= 4) {
    std::string job = farm.submit(words(spp));
    ASSERT_TRUE(eventually([&] { return farm.items_done(job, stage) > 0 || farm.ended(job); }, 120));
    if (act(job, spp)) return;
  }
  FAIL() << "INCONCLUSIVE: every frame ended before anything could happen to it";
}

void Farm::expect_same_bits_after_a_kill(ProcessFarm& farm, const std::string& stage) {
  farm.add_worker("survivor");
  Process* victim = &farm.add_worker("victim");
  ASSERT_TRUE(farm.wait_for_workers(2));
  mid_frame(
      farm, frame,
      [&](const std::string& job, unsigned spp) {
        bool held_work = false;
        for (const auto& worker : farm.workers())
          held_work = held_work || (worker.id() == "victim" && worker.leases() > 0);
        victim->signal(SIGKILL);
        EXPECT_EQ(victim->wait(), 128 + SIGKILL);
        bool while_it_ran = !farm.ended(job);
        json report = farm.finish(job);
        EXPECT_EQ(report["pixels_sha256"], embedded_sha256(spp));
        if (while_it_ran && held_work) return true;
        victim = &farm.add_worker("victim");
        EXPECT_TRUE(farm.wait_for_workers(2));
        return false;
      },
      stage);
}

TEST_P(AnyMethod, AKilledWorkerCostsNoPixel) {
  ProcessFarm farm(folder("farm"), programs, {"--batch-items", "256"});
  expect_same_bits_after_a_kill(farm, {});
}

// What the dead worker retained of the caches is lost with it.
class SplatStages : public Farm, public testing::WithParamInterface<const char*> {
 protected:
  void SetUp() override { method_ = "splat_lobes"; }
  void TearDown() override { method_ = "path"; }
};
INSTANTIATE_TEST_SUITE_P(Farm, SplatStages,
                         testing::Values("splat.points", "splat.first_gather", "splat.gather", "splat.lobe_gather",
                                         "splat.shade", "splat.lobe_shade"),
                         [](const auto& test) { return std::string(test.param).substr(6); });

TEST_P(SplatStages, AWorkerKilledWithinThemCostsNoPixel) {
  ProcessFarm farm(folder("farm"), programs, {"--batch-items", "16"});
  expect_same_bits_after_a_kill(farm, GetParam());
}

// Frames of a scene that moves: whoever renders them, and whoever dies between two of them.
TEST_P(MovingFrames, AKilledWorkerCostsNoPixelOfTheFramesToCome) {
  const std::string moving = (folder("cloth.glb")).string();
  const Ran made = run({"scene", "waving-cloth", "-o", moving, "--set", "cells=12"});
  ASSERT_EQ(made.status, 0) << made.err;
  const char* spp = method_ == "photon" ? "16" : "64";
  std::vector<std::string> words = {moving,  "--frames", "1-6", "--fps",  "8", "--size",
                                    "80x60", "--spp",    spp,   "--seed", "7"};
  append_method(words);
  std::vector<std::string> alone = words;
  alone.insert(alone.begin(), "render");
  for (const std::string word : {"-o", "cloth.exr", "--report", "cloth.json", "--workers", "1"})
    alone.push_back(word.find('.') == std::string::npos ? word : folder(word).string());
  const Ran rendered = run(alone);
  ASSERT_EQ(rendered.status, 0) << rendered.err;
  const auto frame_name = [](const char* stem, int number) {
    return std::string(stem) + "_000" + std::to_string(number) + ".json";
  };

  ProcessFarm farm(folder("farm"), programs, {"--batch-items", "256"});
  farm.add_worker("survivor");
  Process& victim = farm.add_worker("victim");
  ASSERT_TRUE(farm.wait_for_workers(2));
  const std::string job = farm.submit(words);
  ASSERT_TRUE(eventually([&] { return farm.job(job).frames_done() >= 1 || farm.ended(job); }, 120));
  victim.signal(SIGKILL);
  EXPECT_EQ(victim.wait(), 128 + SIGKILL);
  EXPECT_FALSE(farm.ended(job)) << "INCONCLUSIVE: all frames were done";
  farm.finish(job);
  std::set<std::string> different;
  for (int number = 1; number <= 6; ++number) {
    const json expected = json::parse(read_text(folder(frame_name("cloth", number))));
    const json report = json::parse(read_text(farm.fetched(job) / frame_name("frame", number)));
    EXPECT_EQ(report["pixels_sha256"], expected["pixels_sha256"]) << "frame " << number;
    different.insert(report["pixels_sha256"]);
    ASSERT_TRUE(expected.contains("motion")) << "frame " << number;
    EXPECT_EQ(expected["motion"][0]["load_seconds"] > 0, number == 1);
  }
  EXPECT_EQ(different.size(), 6u) << "the cloth does not move";
}

// A second picture of a camera trajectory begins with the first one's lights, and says so.
TEST_F(Farm, LightsServeEveryCamera) {
  ProcessFarm farm(folder("farm"), programs, {});
  farm.add_worker("one");
  ASSERT_TRUE(farm.wait_for_workers(1));
  const auto words = [](const char* eye) {
    return std::vector<std::string>{
        scene().string(), "--size", "48x48", "--spp",         "4",     "--method",         "vpl",
        "--look-at",      eye,      "--set", "vpl.count=500", "--set", "vpl.clusters=100", "--quiet"};
  };
  const char* const there = "0.1,1,3.5,0,1,0,40";
  const json first = farm.finish(farm.submit(words("0,1,3.5,0,1,0,40")));
  const json second = farm.finish(farm.submit(words(there)));
  const auto stages = [](const json& report) {
    std::vector<std::string> names;
    for (const auto& stage : report["stages"]) names.push_back(stage["name"]);
    return names;
  };
  EXPECT_THAT(stages(first), testing::Contains("vpl.trace.0"));
  EXPECT_THAT(stages(first), testing::Contains("vpl.cluster.0"));
  EXPECT_THAT(stages(second), Not(testing::Contains("vpl.trace.0")));
  EXPECT_THAT(stages(second), Not(testing::Contains("vpl.cluster.0")));
  EXPECT_THAT(stages(second), testing::Contains("vpl.shade.0"));
  EXPECT_THAT(second["skips"].dump(), HasSubstr("stage vpl.trace.0"));
  // The same picture as of a farm that has never seen the scene.
  std::vector<std::string> alone = words(there);
  alone.insert(alone.begin(), "render");
  const std::string stem = (shared_->path() / "alone").string();
  for (const std::string& word : {std::string("-o"), stem + ".exr", std::string("--report"), stem + ".json"})
    alone.push_back(word);
  ASSERT_EQ(run(alone).status, 0);
  EXPECT_EQ(second["pixels_sha256"], json::parse(read_text(stem + ".json"))["pixels_sha256"]);
}

TEST_F(Farm, AWorkerMayJoinMidFrame) {
  ProcessFarm farm(folder("farm"), programs, {"--batch-items", "256"});
  farm.add_worker("first");
  ASSERT_TRUE(farm.wait_for_workers(1));
  int joined = 0;
  mid_frame(farm, frame, [&](const std::string& job, unsigned spp) {
    farm.add_worker(std::string("late").append(std::to_string(joined++)));
    json report = farm.finish(job);
    EXPECT_EQ(report["pixels_sha256"], embedded_sha256(spp));
    std::uint64_t late = 0;
    for (const auto& stage : report["stages"])
      for (const auto& [id, share] : stage["workers"].items())
        if (id != "first") late += share["items"].get<std::uint64_t>();
    return late > 0;
  });
}

TEST_F(Farm, CancelEndsAJobAndTheFarmGoesOn) {
  ProcessFarm farm(folder("farm"), programs, {"--batch-items", "256"});
  farm.add_worker("w");
  ASSERT_TRUE(farm.wait_for_workers(1));
  mid_frame(farm, frame, [&](const std::string& job, unsigned) {
    if (farm.gleaner({"cancel", job}).status != 0) return false;
    // Its only frame may have been written just before.
    if (farm.show(job)["frames_done"] != 0) return false;
    Ran watched = farm.gleaner({"watch", job});
    EXPECT_EQ(watched.status, 1);
    EXPECT_THAT(watched.err, HasSubstr("cancelled"));
    EXPECT_EQ(farm.show(job)["state"], "cancelled");
    Ran fetched = farm.gleaner({"fetch", job, "-o", folder("nothing").string()});
    EXPECT_EQ(fetched.status, 1);
    EXPECT_FALSE(fs::exists(folder("nothing")));
    return true;
  });
  EXPECT_EQ(farm.finish(farm.submit(frame(8)))["pixels_sha256"], embedded_sha256(8));
}

// A batch that would take minutes is given up within a second.
TEST_F(Farm, CancelStopsTheKernel) {
  ProcessFarm farm(folder("farm"), programs, {"--batch-items", "10000000"});
  farm.add_worker("w");
  ASSERT_TRUE(farm.wait_for_workers(1));
  farm.finish(farm.submit(frame(8)));  // compiles
  const std::string job = farm.submit({scene().string(), "--size", "640x480", "--spp", "4096", "--method", method_});
  ASSERT_TRUE(eventually([&] { return farm.workers().front().leases() > 0; }));
  std::this_thread::sleep_for(std::chrono::seconds(2));
  EXPECT_EQ(farm.items_done(job), 0u);
  const auto begun = std::chrono::steady_clock::now();
  EXPECT_EQ(farm.gleaner({"cancel", job}).status, 0);
  farm.finish(farm.submit(frame(4)));
  EXPECT_LT(std::chrono::duration<double>(std::chrono::steady_clock::now() - begun).count(), 15);
}

TEST_F(Farm, TwoJobsAtOnce) {
  ProcessFarm farm(folder("farm"), programs);
  farm.add_worker("a");
  farm.add_worker("b");
  ASSERT_TRUE(farm.wait_for_workers(2));
  std::string first = farm.submit(frame(32)), second = farm.submit(frame(16)), third = farm.submit(frame(8));
  EXPECT_EQ(farm.finish(third)["pixels_sha256"], embedded_sha256(8));
  EXPECT_EQ(farm.finish(second)["pixels_sha256"], embedded_sha256(16));
  EXPECT_EQ(farm.finish(first)["pixels_sha256"], embedded_sha256(32));
  EXPECT_EQ(json::parse(farm.gleaner({"list", "--json"}).out).size(), 3u);
}

TEST_F(Farm, SigtermDrainsAWorker) {
  ProcessFarm farm(folder("farm"), programs, {"--batch-items", "256"});
  farm.add_worker("stays");
  Process* leaves = &farm.add_worker("leaves");
  ASSERT_TRUE(farm.wait_for_workers(2));
  mid_frame(farm, frame, [&](const std::string& job, unsigned spp) {
    bool while_it_ran = !farm.ended(job);
    // Twice, as batch systems do that tell all of a job's processes, and whose script passes it on.
    leaves->signal(SIGTERM);
    std::this_thread::sleep_for(std::chrono::milliseconds(20));
    leaves->signal(SIGTERM);
    EXPECT_EQ(leaves->wait(), 0) << leaves->err();
    while_it_ran = while_it_ran && !farm.ended(job);
    EXPECT_EQ(farm.finish(job)["pixels_sha256"], embedded_sha256(spp));
    if (!while_it_ran) {
      leaves = &farm.add_worker("leaves");
      EXPECT_TRUE(farm.wait_for_workers(2));
    }
    return while_it_ran;
  });
}

TEST_F(Farm, SubmitWatchFetchAndTheirFiles) {
  ProcessFarm farm(folder("farm"), programs);
  Ran submitted = farm.gleaner({"submit", scene().string(), "--size", "80x60", "--spp", "64"});
  ASSERT_EQ(submitted.status, 0) << submitted.err;
  EXPECT_THAT(submitted.out, testing::MatchesRegex("[0-9a-f-]+\n")) << "the id alone";
  std::string job = submitted.out.substr(0, submitted.out.size() - 1);
  EXPECT_THAT(farm.gleaner({"why", job}).out, HasSubstr("no worker"));
  Ran early = farm.gleaner({"fetch", job, "-o", folder("early").string()});
  EXPECT_EQ(early.status, 1);
  farm.add_worker("w");
  Ran watched = farm.gleaner({"watch", job, "--preview", folder("preview.png").string()});
  EXPECT_EQ(watched.status, 0) << watched.err;
  EXPECT_EQ(watched.out, "");
  EXPECT_THAT(read_text(folder("preview.png")).substr(0, 4), "\x89PNG");
  Ran fetched = farm.gleaner({"fetch", job, "-o", folder("out/deep").string()});
  ASSERT_EQ(fetched.status, 0) << fetched.err;
  for (const char* name : {"frame_0001.exr", "frame_0001.png", "frame_0001.json"})
    EXPECT_TRUE(fs::exists(folder("out/deep") / name)) << name;
  EXPECT_EQ(read_text(folder("preview.png")), read_text(folder("out/deep/frame_0001.png")))
      << "the last preview is the picture";
  Ran lines = farm.gleaner({"watch", job, "--json"});
  EXPECT_EQ(json::parse(lines.out.substr(0, lines.out.find('\n')))["state"], "done");
  json workers = json::parse(farm.gleaner({"workers", "--json"}).out);
  ASSERT_EQ(workers.size(), 1u);
  EXPECT_EQ(workers[0]["worker"], "w");
}

TEST_F(Farm, OneRequestIsOneJobAndItsFramesAreAList) {
  ProcessFarm farm(folder("farm"), programs);
  const std::vector<std::string> words = {
      "submit", scene().string(),        "--size",     "40x30", "--spp",        "4",     "--frames", "9,3-4,3",
      "--name", "n\u00e4chtlich, \"7\"", "--priority", "3",     "--request-id", "shot 7"};
  Ran first = farm.gleaner(words);
  ASSERT_EQ(first.status, 0) << first.err;
  const std::string job = first.out.substr(0, first.out.size() - 1);
  EXPECT_EQ(farm.gleaner(words).out, first.out);
  std::vector<std::string> other = words;
  other[5] = "8";
  Ran refused = farm.gleaner(other);
  EXPECT_EQ(refused.status, 3);
  EXPECT_THAT(refused.err, HasSubstr("shot 7"));
  ASSERT_EQ(farm.gleaner({"pause", job}).status, 0);
  farm.restart();
  EXPECT_EQ(farm.gleaner(words).out, first.out);
  EXPECT_THAT(farm.gleaner({"list"}).out, testing::AllOf(HasSubstr("paused"), HasSubstr("n\u00e4chtlich")));
  farm.add_worker("w");
  Ran early = farm.gleaner({"submit", scene().string(), "--after", "no-such-job"});
  EXPECT_EQ(early.status, 3);
  ASSERT_EQ(farm.gleaner({"resume", job}).status, 0);
  EXPECT_EQ(farm.gleaner({"watch", job, "--quiet"}).status, 0);
  EXPECT_EQ(farm.show(job)["written"], json::parse("[[3, 4], [9, 9]]"));
  EXPECT_EQ(farm.gleaner({"pause", job}).status, 1) << "it is done";
  EXPECT_EQ(farm.gleaner({"retry", job}).status, 3);
  const std::string csv = farm.gleaner({"list", "--csv"}).out;
  EXPECT_THAT(csv, testing::StartsWith("job,name,state,"));
  EXPECT_THAT(csv, HasSubstr(job + ",\"n\u00e4chtlich, \"\"7\"\"\",done,3,\"box.glb\",path,40,30,3,3,0,20"));
  EXPECT_THAT(csv, testing::Not(HasSubstr(",0.000,0\r\n"))) << "it cost something";
}

TEST_F(Farm, SubmitWaitsAndFetchesAndOverwritesNothing) {
  ProcessFarm farm(folder("farm"), programs);
  farm.add_worker("w");
  const std::string out = folder("out").string();
  const std::vector<std::string> words = {"submit", scene().string(), "--size",  "40x30",  "--spp",
                                          "4",      "--frames",       "2",       "--wait", "-o",
                                          out,      "--pattern",      "shot.###"};
  Ran done = farm.gleaner(words);
  ASSERT_EQ(done.status, 0) << done.err;
  const std::string job = done.out.substr(0, done.out.size() - 1);
  for (const char* name : {"shot.002.exr", "shot.002.png", "shot.002.json"})
    EXPECT_TRUE(fs::exists(folder("out") / name));
  const auto written = fs::last_write_time(folder("out/shot.002.exr"));
  Ran again = farm.gleaner(words);
  EXPECT_EQ(again.status, 1);
  EXPECT_THAT(again.err, testing::AllOf(HasSubstr("shot.002.exr"), HasSubstr("--force")));
  EXPECT_EQ(again.out, "") << "nothing is rendered that could not be fetched";
  std::vector<std::string> fetch = {"fetch", job, "-o", out, "--pattern", "shot.###"};
  EXPECT_EQ(farm.gleaner(fetch).status, 1);
  fetch.push_back("--new");
  EXPECT_EQ(farm.gleaner(fetch).status, 0);
  EXPECT_EQ(fs::last_write_time(folder("out/shot.002.exr")), written);
  fetch.back() = "--force";
  EXPECT_EQ(farm.gleaner(fetch).status, 0);
  EXPECT_NE(fs::last_write_time(folder("out/shot.002.exr")), written);
  EXPECT_EQ(farm.gleaner({"fetch", job, "-o", out, "--pattern", "shot"}).status, 2);
}

TEST_F(Farm, DrainSendsAWorkerHome) {
  ProcessFarm farm(folder("farm"), programs);
  Process& worker = farm.add_worker("w");
  ASSERT_TRUE(farm.wait_for_workers(1));
  EXPECT_EQ(farm.gleaner({"drain", "v"}).status, 3);
  EXPECT_EQ(farm.gleaner({"drain", "w"}).status, 0);
  EXPECT_EQ(worker.wait(), 0);
}

TEST_F(Farm, AJobThatCannotWriteFailsAndTheCoordinatorLives) {
  ProcessFarm farm(folder("farm"), programs);
  farm.add_worker("w");
  std::ofstream(farm.data() / "jobs") << "in the way";
  std::string job = farm.submit(frame(4));
  Ran watched = farm.gleaner({"watch", job});
  EXPECT_EQ(watched.status, 1);
  EXPECT_THAT(watched.err, HasSubstr("jobs"));
  fs::remove(farm.data() / "jobs");
  EXPECT_EQ(farm.finish(farm.submit(frame(4)))["pixels_sha256"], embedded_sha256(4));
}

TEST_F(Farm, StatusesAndWordsOfErrors) {
  std::ofstream(own_.path() / "broken.glb") << "this is no scene";
  const std::string box = scene().string(), out = folder("x.exr").string();
  struct {
    std::vector<std::string> words;
    int status;
    std::vector<std::string> said;
  } const table[] = {
      {{}, 2, {"gleaner: error:"}},
      {{"paint"}, 2, {"gleaner: error:"}},
      {{"render"}, 2, {"SCENE"}},
      {{"render", box}, 2, {"--output"}},
      {{"render", box, "-o", out, "--bogus"}, 2, {"--bogus", "usage: gleaner render"}},
      {{"render", box, "-o", folder("x.png").string()}, 2, {"-o", ".exr"}},
      {{"render", box, "-o", out, "--size", "12by9"}, 2, {"--size", "12by9"}},
      {{"render", box, "-o", out, "--size", "0x10"}, 2, {"--size", "0x10"}},
      {{"render", box, "-o", out, "--spp", "0"}, 2, {"--spp"}},
      {{"render", box, "-o", out, "--frames", "5-2"}, 2, {"--frames", "5-2"}},
      {{"render", box, "-o", out, "--frames", "1,,3"}, 2, {"--frames", "1,,3"}},
      {{"render", box, "-o", out, "--frames", "1,2-4x0"}, 2, {"--frames"}},
      {{"render", box, "-o", out, "--frames", "7,0-4294967295,0-4294967295"}, 2, {"--frames", "100000"}},
      {{"submit", box, "-o", out}, 2, {"--wait"}},
      {{"render", box, "-o", out, "--frames", "0-4294967294"}, 2, {"--frames", "100000"}},
      {{"render", box, "-o", out, "--frames", "1-4294967295", "--look-at", "0,1,5,0,1,0", "--look-at", "0,1,6,0,1,0"},
       2,
       {"--frames", "100000"}},
      {{"render", box, "-o", out, "--method", "paint"}, 2, {"paint"}},
      {{"render", box, "-o", out, "--set", "nonsense"}, 2, {"--set", "nonsense"}},
      {{"render", box, "-o", out, "--set", "no.such=1"}, 2, {"no.such"}},
      {{"render", box, "-o", out, "--set", "depth=many"}, 2, {"depth", "many"}},
      {{"render", box, "-o", out, "--trace", "magic"}, 2, {"magic"}},
      {{"render", box, "-o", out, "--look-at", "1,2,3"}, 2, {"--look-at"}},
      {{"render", box, "-o", out, "--target-error", "-1"}, 2, {"--target-error"}},
      {{"replay", box, "--stage", "path.0", "--item", "0", "--frames", "2-3", "--frame", "4"}, 2, {"--frame", "2-3"}},
      {{"render", "nowhere.glb", "-o", out}, 3, {"nowhere.glb"}},
      {{"render", (own_.path() / "broken.glb").string(), "-o", out}, 3, {"broken.glb"}},
      {{"render", box, "-o", out, "--camera", "behind"}, 3, {"behind", "camera"}},
      {{"render", box, "-o", out, "--environment", "nowhere.hdr"}, 3, {"nowhere.hdr"}},
      {{"render", box, "-o", "/no/such/folder/x.exr"}, 1, {"/no/such/folder"}},
      {{"list"}, 2, {"coordinator"}},
      {{"list", "--coordinator", "127.0.0.1:1"}, 4, {"127.0.0.1:1"}},
      {{"submit", box, "--coordinator", "127.0.0.1:1"}, 4, {"127.0.0.1:1"}},
      {{"watch", "job", "--coordinator", "127.0.0.1:1"}, 4, {"127.0.0.1:1"}},
  };
  for (const auto& row : table) {
    std::string line;
    for (const auto& word : row.words) line += word + " ";
    auto begun = std::chrono::steady_clock::now();
    Ran ran = run(row.words);
    EXPECT_EQ(ran.status, row.status) << line << ran.err;
    EXPECT_LT(std::chrono::steady_clock::now() - begun, std::chrono::seconds(20)) << line << "hangs";
    EXPECT_EQ(ran.out, "") << line;
    for (const auto& words : row.said) EXPECT_THAT(ran.err, HasSubstr(words)) << line;
    std::size_t first = ran.err.find("gleaner: error:");
    EXPECT_NE(first, std::string::npos) << line << ran.err;
    EXPECT_EQ(ran.err.find("gleaner: error:", first + 1), std::string::npos) << line << "says it twice: " << ran.err;
  }
  EXPECT_FALSE(fs::exists(out));

  ProcessFarm farm(folder("farm"), programs);
  for (const char* command : {"show", "watch", "cancel", "why"}) {
    Ran ran = farm.gleaner({command, "no-such-job"});
    EXPECT_EQ(ran.status, 3) << command;
    EXPECT_THAT(ran.err, HasSubstr("no-such-job")) << command;
  }
  EXPECT_EQ(farm.gleaner({"fetch", "no-such-job", "-o", folder("none").string()}).status, 3);
  EXPECT_FALSE(fs::exists(folder("none")));
  EXPECT_EQ(farm.gleaner({"list", "--json"}).out, "[]\n");
  EXPECT_EQ(farm.gleaner({"workers", "--json"}).out, "[]\n");

  Process second(
      {(programs / "gleaner-coordinator").string(), "--listen", farm.address(), "--data", folder("second").string()},
      folder("second-log"));
  EXPECT_EQ(second.wait(), 1);
  EXPECT_THAT(second.err(), HasSubstr(farm.address()));
  std::ofstream(own_.path() / "file") << "in the way";
  Process third(
      {(programs / "gleaner-coordinator").string(), "--listen", "127.0.0.1:0", "--data", folder("file").string()},
      folder("third-log"));
  EXPECT_EQ(third.wait(), 1);
  EXPECT_THAT(third.err(), HasSubstr("file"));
  Process sharing(
      {(programs / "gleaner-coordinator").string(), "--listen", "127.0.0.1:0", "--data", farm.data().string()},
      folder("sharing-log"));
  EXPECT_EQ(sharing.wait(), 1);
  EXPECT_THAT(sharing.err(), HasSubstr(farm.data().string()));
  EXPECT_THAT(sharing.err(), HasSubstr("another coordinator"));
  Process lonely(
      {(programs / "gleaner-worker").string(), "--coordinator", "127.0.0.1:1", "--threads", "1", "--give-up", "1"},
      folder("lonely-log"), {{"POCL_MAX_PTHREAD_COUNT", "1"}});
  EXPECT_EQ(lonely.wait(), 4) << lonely.err();
}

// Bytes that the process has in memory: "VmRSS" now, "VmHWM" at most so far.
std::uint64_t memory_of(const Process& process, const std::string& what) {
  std::ifstream file("/proc/" + std::to_string(process.id()) + "/status");
  for (std::string word; file >> word;)
    if (std::uint64_t kibibytes = 0; word == what + ":" && file >> kibibytes) return kibibytes * 1024;
  throw Error::failed("no " + what + " in /proc");
}

TEST_F(Farm, FramesAreHeldInMemoryOneAtATimeAndWithinItsBound) {
  ProcessFarm farm(folder("farm"), programs, {"--memory", "2", "--active-jobs", "1"});
  std::vector<std::string> words = {"submit", scene().string(), "--size", "16384x16384", "--spp", "1"};
  Ran refused = farm.gleaner(words);
  EXPECT_NE(refused.status, 0);
  EXPECT_THAT(refused.err, HasSubstr("16384x16384"));
  EXPECT_THAT(refused.err, HasSubstr("2.00 GiB"));
  // The first of them runs, as far as it gets without a worker; none of the others has a plan.
  words[3] = "1920x1080";
  std::vector<std::string> jobs;
  for (int i = 0; i < 2; ++i) jobs.push_back(farm.gleaner(words).out);
  ASSERT_TRUE(eventually([&] { return farm.job(jobs[0].substr(0, jobs[0].find('\n'))).stages_size() > 0; }));
  std::this_thread::sleep_for(std::chrono::seconds(1));
  const std::uint64_t before = memory_of(farm.coordinator(), "VmRSS");
  const int queued = 8;
  for (int i = 0; i < queued; ++i) jobs.push_back(farm.gleaner(words).out);
  const std::uint64_t after = memory_of(farm.coordinator(), "VmRSS");
  EXPECT_LT(after, before + queued * (std::uint64_t{1} << 20)) << "a job that waits takes more than a mebibyte";
  for (const std::string& job : jobs) farm.gleaner({"cancel", job.substr(0, job.find('\n'))});
}

TEST_F(Farm, OtherMachinesAreLetInOnlyWhereTheUserSaysSo) {
  const std::string coordinator = (programs / "gleaner-coordinator").string(), data = folder("data").string();
  struct {
    std::vector<std::string> words;
    const char* said;
  } const refused[] = {
      {{"--listen", "0.0.0.0:0"}, "--listen 0.0.0.0:0 is open to other machines"},
      {{"--listen", ":0"}, "--insecure"},
      {{"--listen", "[::]:0"}, "--insecure"},
      {{"--listen", "127.0.0.1:0", "--http", "0.0.0.0:0"}, "--http 0.0.0.0:0 is open to other machines"},
      {{"--listen", "nonsense"}, "expected HOST:PORT"},
      {{"--listen", "127.0.0.1:0", "--http", "http://127.0.0.1:0"}, "--http: expected HOST:PORT"},
  };
  for (const auto& row : refused) {
    std::vector<std::string> words = {coordinator, "--data", data};
    words.insert(words.end(), row.words.begin(), row.words.end());
    Process process(words, folder("refused"));
    ASSERT_TRUE(eventually([&] { return !process.running(); })) << row.words[1] << " was listened on";
    EXPECT_EQ(process.wait(), 2) << row.words[1];
    EXPECT_THAT(process.err(), HasSubstr(row.said));
    EXPECT_EQ(process.out(), "");
  }
  EXPECT_FALSE(fs::exists(data)) << "it refused too late";

  Process open({coordinator, "--data", data, "--insecure", "--listen", "0.0.0.0:0", "--http", "0.0.0.0:0"},
               folder("open"));
  ASSERT_TRUE(eventually([&] { return open.out().find('\n') != std::string::npos; })) << open.err();
  const std::string port = open.out().substr(open.out().rfind(':') + 1);
  const std::string address = "127.0.0.1:" + port.substr(0, port.find('\n'));
  EXPECT_EQ(Process({coordinator, "--check", address}, folder("check")).wait(), 0);
  open.signal(SIGTERM);
  EXPECT_EQ(open.wait(), 0);
  EXPECT_EQ(Process({coordinator, "--check", address}, folder("check")).wait(), 4);
  EXPECT_EQ(Process({coordinator}, folder("no-data")).wait(), 2);
}

// With keys that `gleaner keys` made, on all of this machine's addresses; workers fetch from each other by them too.
TEST_F(Farm, KeysMakeAFarmOfEncryptedConnections) {
  const std::string authority = folder("authority").string(), all = folder("all").string();
  ASSERT_EQ(run({"keys", "init", authority}).status, 0);
  ASSERT_EQ(
      run({"keys", "issue", authority, "all", "-o", all, "--role", "coordinate", "--role", "work", "--role", "submit"})
          .status,
      0);
  EXPECT_THAT(run({"keys", "list", authority}).out, HasSubstr("coordinate,work,submit"));
  EXPECT_EQ(run({"keys", "issue", authority, "king", "--role", "king"}).status, 2);
  EXPECT_EQ(run({"keys", "issue", folder("nowhere").string(), "anna", "--role", "submit"}).status, 3);

  ::setenv("GLEANER_KEYS", all.c_str(), 1);
  method_ = "vpl";
  {
    ProcessFarm farm(folder("farm"), programs);
    farm.add_worker("w0");
    farm.add_worker("w1");
    const json report = farm.finish(farm.submit(frame(1024)));
    EXPECT_EQ(report["pixels_sha256"], embedded_sha256(1024));
    EXPECT_THAT(farm.gleaner({"workers"}).out, HasSubstr("w1"));
    ::unsetenv("GLEANER_KEYS");
    const Ran stranger = farm.gleaner({"list"});
    EXPECT_EQ(stranger.status, 4);
    EXPECT_THAT(stranger.err, HasSubstr("--keys"));
    EXPECT_EQ(farm.gleaner({"list", "--keys", all}).status, 0);
    const Ran none = farm.gleaner({"list", "--keys", folder("nowhere").string()});
    EXPECT_EQ(none.status, 3);
    EXPECT_THAT(none.err, HasSubstr("authority.crt"));
  }
  ::unsetenv("GLEANER_KEYS");
  method_ = "path";
  Process open({(programs / "gleaner-coordinator").string(), "--listen", "0.0.0.0:0", "--data", folder("open").string(),
                "--keys", authority + "/coordinator"},
               folder("open-log"));
  EXPECT_TRUE(eventually([&] { return open.out().find('\n') != std::string::npos; }, 20)) << open.err();
}

TEST_F(Farm, ATimeLimitIsKeptAndSaid) {
  std::vector<std::string> words = frame(1000000);
  std::string out = folder("limited.exr").string(), report_file = folder("limited.json").string();
  words.insert(words.begin(), "render");
  for (const std::string& word :
       {std::string("-o"), out, std::string("--report"), report_file, std::string("--time-limit"), std::string("2")})
    words.push_back(word);
  Ran ran = run(words);
  ASSERT_EQ(ran.status, 0) << ran.err;
  EXPECT_TRUE(fs::exists(out));
  json report = json::parse(read_text(report_file));
  EXPECT_EQ(report["time_limit"]["reached"], true);
  EXPECT_LT(report["parameters"]["samples"], 80ll * 60 * 1000000);
  bool said = false;
  for (const auto& skip : report["skips"]) said = said || (skip["what"] == "samples" && skip["count"] > 0);
  EXPECT_TRUE(said);
}

// What a frame of a trajectory makes of its own, and what it shares with the others.
TEST_F(Farm, ReplayKnowsTheFramesOfATrajectory) {
  const auto record = [](const std::string& stage, const std::vector<std::string>& more) {
    std::vector<std::string> words = {"replay",    scene().string(),
                                      "--size",    "32x32",
                                      "--spp",     "4",
                                      "--method",  "vpl",
                                      "--frames",  "5-7",
                                      "--look-at", "0,1,3.5,0,1,0,40",
                                      "--look-at", "0.5,1,3.5,0,1,0,40",
                                      "--set",     "vpl.count=300",
                                      "--quiet",   "--item",
                                      "500",       "--stage",
                                      stage};
    if (stage.ends_with("cluster")) *(words.end() - 3) = "7";
    words.insert(words.end(), more.begin(), more.end());
    const Ran ran = run(words);
    EXPECT_EQ(ran.status, 0) << ran.err;
    return ran.out;
  };
  const std::string first = record("vpl.shade.0", {});
  EXPECT_EQ(record("vpl.shade.0", {"--frame", "5"}), first);
  EXPECT_NE(record("vpl.shade.0", {"--frame", "7"}), first);
  for (const char* shared : {"vpl.points.2", "vpl.point_cluster"})
    EXPECT_EQ(record(shared, {"--frame", "7"}), record(shared, {})) << shared;
}

TEST_F(Farm, AWorkerOfEachDevice) {
  ProcessFarm farm(folder("devices"), programs);
  // PoCL makes as many devices as it is told.
  Process workers({(programs / "gleaner-worker").string(), "--coordinator", farm.address(), "--name", "host",
                   "--all-devices", "--threads", "1"},
                  folder("all-workers"), {{"POCL_DEVICES", "basic basic"}, {"POCL_MAX_PTHREAD_COUNT", "1"}});
  ASSERT_TRUE(farm.wait_for_workers(2)) << workers.err();
  std::set<std::string> names;
  for (const auto& worker : farm.workers()) names.insert(worker.id());
  EXPECT_EQ(names, (std::set<std::string>{"host-0", "host-1"}));
  const json report = farm.finish(farm.submit(frame(1024)));
  EXPECT_EQ(report["pixels_sha256"], embedded_sha256(1024));
  std::set<std::string> used;
  for (const auto& stage : report["stages"])
    for (const auto& [name, share] : stage["workers"].items()) used.insert(name);
  EXPECT_EQ(used, names);
  workers.signal(SIGTERM);
  EXPECT_EQ(workers.wait(), 0);
}

// A render of many frames that is ended after some of them.
TEST_F(Farm, ARenderThatIsEndedSaysWhatItWroteAndLeavesNothingElse) {
  for (const int signal : {SIGKILL, SIGINT}) {
    const fs::path out = folder("ended" + std::to_string(signal));
    fs::create_directories(out);
    Process render(
        {(programs / "gleaner").string(), "render", scene().string(), "--size", "320x240", "--spp", "4", "--frames",
         "1-2000", "--look-at", "0,1,3,0,1,0", "--seed", "1", "-o", (out / "f.####.exr").string()},
        folder("render" + std::to_string(signal)));
    ASSERT_TRUE(eventually([&] { return fs::exists(out / "f.0002.exr") || !render.running(); }, 120));
    ASSERT_TRUE(render.running()) << render.err();
    render.signal(signal);
    const int status = render.wait();
    EXPECT_NE(status, 0);
    std::size_t pictures = 0;
    for (const auto& entry : fs::directory_iterator(out)) {
      const std::string name = entry.path().filename().string();
      EXPECT_TRUE(name.starts_with("f.") && (name.ends_with(".exr") || name.ends_with(".png"))) << name;
      pictures += name.ends_with(".exr");
    }
    EXPECT_GE(pictures, 2u);
    if (signal == SIGINT) {
      EXPECT_THAT(render.err(), HasSubstr("frames were written before"));
      EXPECT_THAT(render.err(), Not(HasSubstr("nothing was written")));
    }
  }
}

TEST_F(Farm, HelpIsNoError) {
  EXPECT_EQ(run({"--help"}).status, 0);
  EXPECT_EQ(run({"render", "--help"}).status, 0);
  EXPECT_THAT(run({"render", "--help"}).out, HasSubstr("--target-error"));
}

}  // namespace
}  // namespace gleaner::test

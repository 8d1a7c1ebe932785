// Jobs that wait, run and end: what they hold of the coordinator's memory, and who waits for whom.

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/mount.h>

#include <cerrno>
#include <cstring>

#include <system_error>

#include "coordinator/jobs/frame_name.h"
#include "coordinator/jobs/kept_records.h"
#include "tests/farm/scripted_farm.h"

namespace gleaner::test {
namespace {

using testing::HasSubstr;
using testing::SizeIs;

// What happened to the plans of a farm.
struct PlanLog {
  std::atomic<int> made{0}, alive{0};
};

class CountedPlan final : public Plan {
 public:
  CountedPlan(const FrameSettings& settings, PlanLog& log) : plan_(settings), log_(log) { ++log_.made, ++log_.alive; }
  ~CountedPlan() override { --log_.alive; }
  Step next(const FinishedStage* finished) override { return plan_.next(finished); }
  void preview(const std::string& stage, std::uint64_t first, std::uint64_t count, const Bytes& records) override {
    plan_.preview(stage, first, count, records);
  }
  Film preview_film(bool) const override { return plan_.preview_film(false); }
  Film film() const override { return plan_.film(); }
  std::vector<Skip> skips() const override { return {}; }
  std::string parameters_json() const override { return "{}"; }
  std::vector<std::string> outline() const override { return {}; }

 private:
  FakePlan plan_;
  PlanLog& log_;
};

// A gate that a plan's thread stands at.
class Gate {
 public:
  void pass() {
    std::unique_lock lock(mutex_);
    ++waiting_;
    changed_.notify_all();
    changed_.wait(lock, [&] { return open_; });
  }
  void open() {
    std::lock_guard lock(mutex_);
    open_ = true;
    changed_.notify_all();
  }
  bool reached() {
    std::lock_guard lock(mutex_);
    return waiting_ > 0;
  }

 private:
  std::mutex mutex_;
  std::condition_variable changed_;
  bool open_ = false;
  int waiting_ = 0;
};

// Computes, once its first stage is there, for as long as the gate is shut.
class SlowPlan final : public Plan {
 public:
  SlowPlan(const FrameSettings& settings, std::shared_ptr<Gate> gate) : plan_(settings), gate_(std::move(gate)) {}
  Step next(const FinishedStage* finished) override {
    if (finished) gate_->pass();
    return plan_.next(finished);
  }
  void preview(const std::string&, std::uint64_t, std::uint64_t, const Bytes&) override {}
  Film preview_film(bool) const override { return plan_.preview_film(false); }
  Film film() const override { return plan_.film(); }
  std::vector<Skip> skips() const override { return {}; }
  std::string parameters_json() const override { return "{}"; }
  std::vector<std::string> outline() const override { return {}; }

 private:
  FakePlan plan_;
  std::shared_ptr<Gate> gate_;
};

class FarmJobs : public FarmEngine {
 protected:
  FarmSettings counted() {
    FarmSettings farm_settings = settings();
    farm_settings.active_jobs = 1;
    farm_settings.plan = [this](const FrameSettings& frame, const SceneSummary&) {
      return std::make_unique<CountedPlan>(frame, log_);
    };
    return farm_settings;
  }

  // Jobs of the method's seed 77 compute behind the gate.
  FarmSettings slow(std::shared_ptr<Gate> gate) {
    FarmSettings farm_settings = settings();
    farm_settings.active_jobs = 1;
    farm_settings.plan = [gate](const FrameSettings& frame, const SceneSummary& scene) -> std::unique_ptr<Plan> {
      if (frame.seed == 77) return std::make_unique<SlowPlan>(frame, gate);
      return make_fake_plan(frame, scene);
    };
    return farm_settings;
  }

  JobRequest slow_request() {
    FrameSettings frame = fake_settings();
    frame.seed = 77;
    return request(frame);
  }

  // Serves the worker until the plan stands at the gate.
  void serve_to(Gate& gate, ScriptedWorker& worker) {
    ASSERT_TRUE(eventually([&] {
      if (auto offer = worker.next(0.01)) worker.deliver(*offer, worker.compute(*offer, blobs_));
      return gate.reached();
    }));
  }

  PlanLog log_;
};

TEST(FrameName, IsReadAsItWasWritten) {
  for (const std::uint32_t frame : {0u, 7u, 9999u, 10000u, 4294967295u})
    EXPECT_EQ(frame_of_stem(frame_stem(frame)), frame);
  EXPECT_EQ(frame_stem(7), "frame_0007");
  for (const char* stem : {"", "frame_", "frame_7a", "frame_-1", "frame_4294967296", "shot_0007"})
    EXPECT_EQ(frame_of_stem(stem), std::nullopt) << stem;
}

TEST_F(FarmJobs, AJobThatWaitsHasNoPlan) {
  Farm farm(counted(), blobs_);
  ScriptedWorker worker;
  worker.join(farm);
  std::vector<std::string> jobs;
  for (int i = 0; i < 4; ++i) jobs.push_back(farm.submit(request()));
  ASSERT_TRUE(eventually([&] { return log_.made == 1; }));
  farm.cancel(jobs[1]);
  serve(farm, worker, jobs[3]);
  for (int i : {0, 2, 3}) EXPECT_EQ(end_of(farm, jobs[static_cast<std::size_t>(i)]).state, JobState::done);
  EXPECT_EQ(log_.made, 3) << "the job that was cancelled while it waited made none";
  EXPECT_EQ(log_.alive, 0);
}

TEST_F(FarmJobs, WhatAnEndedJobHeldIsFreed) {
  Farm farm(counted(), blobs_);
  ScriptedWorker worker;
  worker.join(farm);
  std::string job = farm.submit(request());
  std::string input;
  while (!ended(farm.status(job)->state)) {
    auto offer = worker.next(0.05);
    if (!offer) continue;
    if (offer->work->stage == "gather") input = offer->work->inputs.at(0).blob;
    worker.deliver(*offer, worker.compute(*offer, blobs_));
  }
  ASSERT_EQ(end_of(farm, job).state, JobState::done);
  EXPECT_EQ(log_.alive, 0);
  ASSERT_FALSE(input.empty());
  EXPECT_FALSE(blobs_.get(input)) << "the frame's artifact is still held";
  JobStatus status = *farm.status(job);
  ASSERT_THAT(status.stages, SizeIs(2));
  EXPECT_EQ(status.stages[1].items_done, status.stages[1].items) << "what it did is still told";
}

TEST_F(FarmJobs, TheLastJobsThatEndedAreListedWithTheirFiles) {
  std::atomic<double> time{0};
  FarmSettings farm_settings = settings();
  farm_settings.clock = [&] { return time.load(); };
  farm_settings.silence = 1e9;
  farm_settings.ended_jobs = 3;
  farm_settings.ended_seconds = 1000;
  Farm farm(farm_settings, blobs_);
  ScriptedWorker worker;
  worker.join(farm);
  std::vector<std::string> jobs;
  for (int i = 0; i < 5; ++i) {
    jobs.push_back(farm.submit(request()));
    serve(farm, worker, jobs.back());
  }
  EXPECT_THAT(farm.list(), SizeIs(3));
  EXPECT_FALSE(farm.status(jobs[1]));
  EXPECT_TRUE(farm.files(jobs[1]).empty());
  EXPECT_THAT(farm.files(jobs[2]), SizeIs(3));
  time = 1001;
  std::string last = farm.submit(request());
  EXPECT_THAT(farm.list(), SizeIs(1)) << "those that ended long ago";
  EXPECT_EQ(farm.list()[0].id, last);
}

TEST_F(FarmJobs, AFrameThatNeedsMoreMemoryThanThereIsIsRefused) {
  FarmSettings farm_settings = settings();
  farm_settings.check = [](const FrameSettings&, const SceneSummary&) { return std::uint64_t{3} << 29; };
  farm_settings.memory_bytes = std::uint64_t{1} << 30;
  Farm farm(farm_settings, blobs_);
  try {
    farm.submit(request());
    FAIL() << "it was taken";
  } catch (const Error& error) {
    EXPECT_EQ(error.kind(), ErrorKind::usage);
    EXPECT_THAT(error.what(), HasSubstr("1.50 GiB"));
    EXPECT_THAT(error.what(), HasSubstr("1.00 GiB"));
    EXPECT_THAT(error.what(), HasSubstr("32x16"));
  }
  EXPECT_TRUE(farm.list().empty());
}

TEST_F(FarmJobs, AFrameThatMovesHoldsItsSceneToo) {
  FarmSettings farm_settings = settings();
  farm_settings.check = [](const FrameSettings&, const SceneSummary&) { return std::uint64_t{100}; };
  farm_settings.memory_bytes = 1000;
  Farm farm(farm_settings, blobs_);
  JobRequest still = request();
  still.scenes.front().scene_blob = blobs_.put(scene::Bytes(800));
  JobRequest moving = still;
  moving.scenes.front().state_blob = blobs_.put(scene::Bytes(10));
  EXPECT_THROW(farm.submit(moving), Error) << "the base, and a copy of it";
  EXPECT_NO_THROW(farm.cancel(farm.submit(still)));
}

TEST_F(FarmJobs, AJobWaitsForTheMemoryOfThoseThatRun) {
  FarmSettings farm_settings = settings();
  farm_settings.active_jobs = 2;
  farm_settings.check = [](const FrameSettings& frame, const SceneSummary&) { return std::uint64_t{frame.width}; };
  farm_settings.memory_bytes = 60;
  Farm farm(farm_settings, blobs_);
  std::string first = farm.submit(request(fake_settings(32, 16))), second = farm.submit(request(fake_settings(40, 16))),
              third = farm.submit(request(fake_settings(8, 16)));
  EXPECT_EQ(farm.status(first)->state, JobState::running);
  EXPECT_EQ(farm.status(second)->state, JobState::queued);
  EXPECT_THAT(farm.why(second)->at(0), HasSubstr("memory"));
  EXPECT_EQ(farm.status(third)->state, JobState::queued) << "a small job must not overtake a large one for ever";
  ScriptedWorker worker;
  worker.join(farm);
  serve(farm, worker, third);
  for (const auto& job : {first, second, third}) EXPECT_EQ(end_of(farm, job).state, JobState::done);
}

TEST_F(FarmJobs, CancelDoesNotWaitForAPlanThatComputes) {
  auto gate = std::make_shared<Gate>();
  Farm farm(slow(gate), blobs_);
  ScriptedWorker worker;
  worker.join(farm);
  std::string stuck = farm.submit(slow_request()), next = farm.submit(request());
  serve_to(*gate, worker);
  // Nobody is held up by it.
  EXPECT_FALSE(farm.preview(stuck));
  EXPECT_EQ(farm.status(stuck)->state, JobState::running);
  auto cancelled = farm.cancel(stuck);
  ASSERT_TRUE(cancelled);
  EXPECT_EQ(cancelled->state, JobState::cancelled);
  serve(farm, worker, next);
  EXPECT_EQ(end_of(farm, next).state, JobState::done);
  gate->open();
  EXPECT_EQ(farm.status(stuck)->state, JobState::cancelled);
  EXPECT_TRUE(farm.files(stuck).empty());
}

TEST_F(FarmJobs, AFarmEndsThoughAPlanComputes) {
  auto gate = std::make_shared<Gate>();
  Farm farm(slow(gate), blobs_);
  ScriptedWorker worker;
  worker.join(farm);
  std::string stuck = farm.submit(slow_request());
  serve_to(*gate, worker);
  EXPECT_FALSE(farm.end(0.05));
  EXPECT_EQ(farm.status(stuck)->state, JobState::cancelled);
  gate->open();
  EXPECT_TRUE(farm.end(20));
}

// Takes its records in, and draws them, only while its gate is open.
class GatedPlan final : public Plan {
 public:
  GatedPlan(const FrameSettings& settings, std::shared_ptr<Gate> gate) : plan_(settings), gate_(std::move(gate)) {}
  Step next(const FinishedStage* finished) override { return plan_.next(finished); }
  void take(const std::string& stage, std::uint64_t first, std::uint64_t count, const Bytes& records) override {
    gate_->pass();
    plan_.take(stage, first, count, records);
  }
  void preview(const std::string&, std::uint64_t, std::uint64_t, const Bytes&) override { gate_->pass(); }
  Film preview_film(bool) const override { return plan_.preview_film(false); }
  Film film() const override { return plan_.film(); }
  std::vector<Skip> skips() const override { return {}; }
  std::string parameters_json() const override { return "{}"; }
  std::vector<std::string> outline() const override { return {}; }

 private:
  FakePlan plan_;
  std::shared_ptr<Gate> gate_;
};

// Bytes that this process has in memory.
std::uint64_t resident_bytes() {
  std::ifstream file("/proc/self/statm");
  std::uint64_t all = 0, resident = 0;
  file >> all >> resident;
  return resident * 4096;
}

TEST_F(FarmJobs, APreviewThatIsNotDrawnTakesNoMemory) {
  auto gate = std::make_shared<Gate>();
  FarmSettings farm_settings = settings(1 << 16);
  farm_settings.plan = [gate](const FrameSettings& frame, const SceneSummary&) {
    return std::make_unique<GatedPlan>(frame, gate);
  };
  Farm farm(farm_settings, blobs_);
  ScriptedWorker worker;
  worker.join(farm);
  std::string job = farm.submit(request(fake_settings(1024, 2048)));  // "scatter" has 64 MiB of records
  std::uint64_t begun = 0;
  for (int batch = 0; batch < 127; ++batch) {
    auto offer = worker.next();
    ASSERT_TRUE(offer);
    ASSERT_EQ(worker.deliver(*offer, worker.compute(*offer, blobs_)), Verdict::accepted);
    if (batch == 8) begun = resident_bytes();
  }
  EXPECT_TRUE(gate->reached());
  EXPECT_LT(resident_bytes(), begun + (std::uint64_t{32} << 20)) << "batches are held for the preview";
  farm.cancel(job);
  gate->open();
}

TEST_F(FarmJobs, AnOversizedRecordDoesNotDriveOutAllOthers) {
  KeptRecords kept(100);
  const auto record = [](std::size_t bytes) {
    ArtifactData data;
    data.records = std::make_shared<const Bytes>(bytes);
    return std::make_shared<const ArtifactData>(std::move(data));
  };
  kept.put("small", record(20));
  kept.put("large", record(90));
  EXPECT_FALSE(kept.find("large"));
  EXPECT_TRUE(kept.find("small"));
  for (const char* name : {"a", "b", "c", "d"}) kept.put(name, record(25));
  EXPECT_FALSE(kept.find("small")) << "the least recently used leaves first";
  EXPECT_TRUE(kept.find("a"));
}

TEST_F(FarmJobs, WhateverAPlanThrowsFailsItsJobAlone) {
  FarmSettings farm_settings = settings();
  farm_settings.plan = [](const FrameSettings& frame, const SceneSummary& scene) -> std::unique_ptr<Plan> {
    if (frame.seed == 1) throw 1;
    if (frame.seed == 2) throw std::bad_alloc();
    return make_fake_plan(frame, scene);
  };
  Farm farm(farm_settings, blobs_);
  ScriptedWorker worker;
  worker.join(farm);
  for (std::uint64_t seed : {1u, 2u, 3u}) {
    FrameSettings frame = fake_settings();
    frame.seed = seed;
    std::string job = farm.submit(request(frame));
    serve(farm, worker, job);
    JobStatus status = end_of(farm, job);
    EXPECT_EQ(status.state, seed == 3 ? JobState::done : JobState::failed) << status.message;
    // The third one's message is that its picture is white from end to end.
    EXPECT_NE(status.message, "");
  }
}

TEST_F(FarmJobs, HigherPrioritiesComeFirst) {
  FarmSettings one = settings();
  one.active_jobs = 1;
  Farm farm(one, blobs_);
  JobRequest low = request(), high = request();
  low.priority = -1;
  high.priority = 1;
  const std::string first = farm.submit(request()), last = farm.submit(low), usual = farm.submit(request()),
                    urgent = farm.submit(high);
  farm.cancel(first);
  end_of(farm, first);
  EXPECT_EQ(farm.status(urgent)->state, JobState::running);
  farm.cancel(urgent);
  end_of(farm, urgent);
  EXPECT_EQ(farm.status(usual)->state, JobState::running);
  EXPECT_EQ(farm.status(last)->state, JobState::queued);
  high.priority = 1001;
  EXPECT_THROW(farm.submit(high), Error);
}

// Of two jobs that run, the later one is served first where its priority is higher.
TEST_F(FarmJobs, WorkersServeTheHigherPriorityOfTwoThatRun) {
  Farm farm(settings(), blobs_);
  JobRequest high = request();
  high.priority = 1;
  high.settings.seed += 1;
  const std::string usual = farm.submit(request()), urgent = farm.submit(high);
  ASSERT_TRUE(eventually([&] { return !farm.status(usual)->stages.empty() && !farm.status(urgent)->stages.empty(); }));
  ScriptedWorker worker;
  worker.join(farm);
  auto offer = worker.next();
  ASSERT_TRUE(offer);
  EXPECT_EQ(offer->work->job, urgent);
}

TEST_F(FarmJobs, APausedJobHandsOutNothingAndLetsOthersRun) {
  FarmSettings one = settings();
  one.active_jobs = 1;
  Farm farm(one, blobs_);
  ScriptedWorker worker;
  worker.join(farm);
  JobRequest other = request();
  other.settings.seed += 1;
  const std::string paused = farm.submit(request()), next = farm.submit(other);
  auto offer = worker.next();
  ASSERT_TRUE(offer);
  ASSERT_TRUE(farm.pause(paused, true));
  EXPECT_EQ(farm.status(next)->state, JobState::running);
  EXPECT_EQ(worker.deliver(*offer, worker.compute(*offer, blobs_)), Verdict::accepted) << "what is out may finish";
  serve(farm, worker, next);
  EXPECT_EQ(farm.status(paused)->state, JobState::running);
  farm.pause(paused, false);
  serve(farm, worker, paused);
  EXPECT_EQ(end_of(farm, paused).state, JobState::done);
  EXPECT_EQ(report(farm, paused)["pixels_sha256"], fake_pixels_sha256(fake_settings()));
}

TEST_F(FarmJobs, ATimeLimitDoesNotRunWhileTheJobIsPaused) {
  std::atomic<double> time{0};
  FarmSettings farm_settings = settings();
  farm_settings.clock = [&] { return time.load(); };
  farm_settings.silence = 1e9;
  Farm farm(farm_settings, blobs_);
  ScriptedWorker worker;
  worker.join(farm);
  JobRequest limited = request();
  limited.time_limit = 100;
  const std::string job = farm.submit(limited);
  auto offer = worker.next();
  ASSERT_TRUE(offer);
  ASSERT_TRUE(farm.pause(job, true));
  time = 900;
  worker.deliver(*offer, worker.compute(*offer, blobs_));
  EXPECT_FALSE(ended(farm.status(job)->state));
  farm.pause(job, false);
  serve(farm, worker, job);
  EXPECT_EQ(end_of(farm, job).state, JobState::done);
  EXPECT_EQ(report(farm, job)["time_limit"]["reached"], false);
  EXPECT_EQ(report(farm, job)["pixels_sha256"], fake_pixels_sha256(fake_settings()));
}

TEST_F(FarmJobs, AFrameWaitsForRoomOnAFullDisk) {
  const std::filesystem::path disk = folder_.path() / "disk";
  std::filesystem::create_directory(disk);
  if (::mount("tmpfs", disk.c_str(), "tmpfs", 0, "size=64k") != 0)
    GTEST_SKIP() << "no small disk can be mounted here: " << std::strerror(errno);
  const std::shared_ptr<void> unmounts(nullptr, [&](void*) { ::umount2(disk.c_str(), MNT_DETACH); });
  {
    std::ofstream filler(disk / "filler");
    while (filler << std::string(4096, 'x') << std::flush) continue;
  }
  FarmSettings farm_settings = settings();
  farm_settings.paths = [&](const std::string&, std::uint32_t) {
    return FramePaths{disk / "frame.exr", disk / "frame.png", disk / "frame.json"};
  };
  for (const bool patient : {false, true}) {
    farm_settings.disk_patience = patient ? 100 : 0;
    Farm farm(farm_settings, blobs_);
    ScriptedWorker worker;
    worker.join(farm);
    const std::string job = farm.submit(request());
    const auto waits = [&] {
      const auto reasons = farm.why(job);
      return !reasons->empty() && reasons->front().find("waits for room") != std::string::npos;
    };
    while (!ended(farm.status(job)->state) && !waits()) {
      if (auto offer = worker.next(0.05)) worker.deliver(*offer, worker.compute(*offer, blobs_));
    }
    if (!patient) {
      EXPECT_EQ(end_of(farm, job).state, JobState::failed);
      EXPECT_THAT(farm.status(job)->message, HasSubstr("No space left on device"));
      continue;
    }
    EXPECT_THAT(farm.why(job)->front(), HasSubstr("frame.exr: cannot write: No space left on device"));
    std::filesystem::remove(disk / "filler");
    EXPECT_EQ(end_of(farm, job).state, JobState::done);
    EXPECT_EQ(report(farm, job)["pixels_sha256"], fake_pixels_sha256(fake_settings()));
  }
}

TEST_F(FarmJobs, AJobAfterOneThatIsNotThereIsRefused) {
  Farm farm(settings(), blobs_);
  JobRequest lost = request();
  lost.after = {"nobody"};
  EXPECT_THROW(farm.submit(lost), Error);
  lost.after = {};
  lost.numbers = {3, 3};
  EXPECT_THROW(farm.submit(lost), Error) << "a frame twice";
}

TEST_F(FarmJobs, AThreadThatCannotStartIsWaitedFor) {
  FarmSettings farm_settings = settings();
  std::atomic<int> refused{2};
  farm_settings.start_thread = [&](std::function<void()> what) {
    if (refused-- > 0) throw std::system_error(std::make_error_code(std::errc::resource_unavailable_try_again));
    return std::thread(std::move(what));
  };
  Farm farm(farm_settings, blobs_);
  ScriptedWorker worker;
  worker.join(farm);
  const std::string job = farm.submit(request());
  EXPECT_EQ(farm.status(job)->state, JobState::queued);
  serve(farm, worker, job);
  EXPECT_EQ(end_of(farm, job).state, JobState::done) << end_of(farm, job).message;
}

}  // namespace
}  // namespace gleaner::test

// Frames of a job side by side: when a further one begins, what it gets, and how the job ends. Two frames are told
// apart by the order in which their leases come: a worker that holds all batches of the first one's stage leaves the
// other worker idle, and that gets the second one's.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <map>
#include <random>
#include <set>
#include <thread>

#include "coordinator/jobs/frame_set.h"
#include "coordinator/journal/journal_writer.h"
#include "coordinator/journal/sqlite_journal.h"
#include "tests/farm/scripted_farm.h"

namespace gleaner::test {
namespace {

using testing::AllOf;
using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::Not;
using testing::Pair;
using testing::SizeIs;

class SideBySide : public FarmEngine {
 protected:
  // A batch a stage: a frame feeds one worker.
  FarmSettings whole_stages() {
    FarmSettings farm_settings = settings(1 << 20);
    farm_settings.scheduler.in_flight = 1;
    return farm_settings;
  }
  // Moving cameras: every frame is a picture of its own, of the same pixels.
  JobRequest frames(std::uint32_t count) {
    JobRequest job = request();
    job.last_frame = count;
    job.cameras.assign(count, job.settings.camera);
    for (std::uint32_t i = 0; i < count; ++i) job.cameras[i].origin[0] = static_cast<float>(i + 1);
    return job;
  }
  void do_it(ScriptedWorker& worker, const Offered& offer) { worker.deliver(offer, worker.compute(offer, blobs_)); }
  // The worker gets no more than it holds; the others may get copies of that.
  std::optional<Offered> hold_first(Farm& farm, ScriptedWorker& worker) {
    auto offer = worker.next();
    farm.drain(worker.id);
    return offer;
  }
  // Serves until so many frames are over; copies of what another worker holds are left alone.
  void serve_frames(Farm& farm, ScriptedWorker& worker, const std::string& job, std::uint32_t count) {
    for (JobStatus status; status.frames_done + status.frames_failed < count; status = *farm.status(job))
      if (auto offer = worker.next(0.05); offer && !offer->lease.duplicate) do_it(worker, *offer);
  }
  bool runs(Farm& farm, const std::string& job, std::vector<std::uint32_t> frames) {
    return eventually([&] { return farm.status(job)->running == frames; });
  }
  void expect_right(Farm& farm, const std::string& job, std::size_t count) {
    const JobStatus status = end_of(farm, job);
    ASSERT_EQ(status.state, JobState::done) << status.message;
    EXPECT_EQ(status.frames_done, count);
    EXPECT_EQ(status.progress, 1);
    for (std::size_t i = 0; i < count; ++i) {
      EXPECT_EQ(report(farm, job, ".json", i)["frame"], i + 1);
      EXPECT_EQ(report(farm, job, ".json", i)["pixels_sha256"], fake_pixels_sha256(fake_settings()));
    }
  }
};

TEST_F(SideBySide, AFrameThatIsFinishedBeforeAnEarlierOneCanBeFetched) {
  Farm farm(settings(1 << 20), blobs_);
  ScriptedWorker slow, quick;
  slow.join(farm, "slow");
  const std::string job = farm.submit(frames(3));
  do_it(slow, *slow.next());
  // "gather", which reads what the later frames' plans give their workers as well, to the byte.
  auto held = hold_first(farm, slow);
  quick.join(farm, "quick");
  ASSERT_TRUE(held);
  ASSERT_TRUE(runs(farm, job, {1, 2})) << "the other worker idles";
  serve_frames(farm, quick, job, 2);
  JobStatus status = *farm.status(job);
  EXPECT_EQ(status.state, JobState::running);
  EXPECT_THAT(status.written, ElementsAre(Pair(2, 3)));
  EXPECT_THAT(status.running, ElementsAre(1));
  EXPECT_THAT(farm.files(job), SizeIs(6));
  for (const auto& file : farm.files(job)) EXPECT_TRUE(std::filesystem::exists(file)) << file;
  EXPECT_EQ(report(farm, job)["frame"], 2);
  do_it(slow, *held);
  serve(farm, quick, job);
  expect_right(farm, job, 3);
}

TEST_F(SideBySide, OneWorkerRendersOneFrameAfterAnother) {
  Farm farm(whole_stages(), blobs_);
  ScriptedWorker worker;
  worker.join(farm);
  const std::string job = farm.submit(frames(3));
  std::set<std::size_t> running;
  while (!ended(farm.status(job)->state)) {
    if (auto offer = worker.next(0.05)) {
      std::this_thread::sleep_for(std::chrono::milliseconds(50));
      running.insert(farm.status(job)->running.size());
      do_it(worker, *offer);
    }
  }
  EXPECT_THAT(running, ElementsAre(1));
  expect_right(farm, job, 3);
}

// Whoever has a lease does not idle, however long it takes.
TEST_F(SideBySide, BusyWorkersGetNoFurtherFrame) {
  FarmSettings farm_settings = settings(256);
  farm_settings.scheduler.in_flight = 1;
  Farm farm(farm_settings, blobs_);
  ScriptedWorker a, b;
  a.join(farm, "a");
  b.join(farm, "b");
  const std::string job = farm.submit(frames(2));
  const auto of_a = a.next(), of_b = b.next();
  ASSERT_TRUE(of_a && of_b);
  std::this_thread::sleep_for(std::chrono::milliseconds(300));
  EXPECT_THAT(farm.status(job)->running, ElementsAre(1));
  do_it(a, *of_a);
  do_it(b, *of_b);
  std::thread helper([&] { serve(farm, b, job); });
  serve(farm, a, job);
  helper.join();
  expect_right(farm, job, 2);
}

// Each bound on its own keeps the second frame back, though a worker idles for long.
TEST_F(SideBySide, MemoryAndTheLimitBoundTheFramesThatRun) {
  const std::uint64_t frame_bytes = check_fake_settings(fake_settings(), {});
  FarmSettings little_memory = whole_stages(), limit = whole_stages(), enough = whole_stages();
  little_memory.memory_bytes = 2 * frame_bytes - 1;
  limit.frames_at_once = 1;
  enough.memory_bytes = 2 * frame_bytes;
  JobRequest timed = frames(3);
  timed.time_limit = 1000;
  struct Case {
    const char* what;
    FarmSettings settings;
    JobRequest request;
    std::size_t frames;
  };
  for (const Case& c : {Case{"memory", little_memory, frames(3), 1}, Case{"limit", limit, frames(3), 1},
                        Case{"a time limit", whole_stages(), timed, 1}, Case{"none", enough, frames(3), 2}}) {
    Farm farm(c.settings, blobs_);
    ScriptedWorker holding, idle, idle_too;
    holding.join(farm, "holding");
    idle.join(farm, "idle");
    idle_too.join(farm, "idle-too");
    const std::string job = farm.submit(c.request);
    ASSERT_TRUE(holding.next());
    std::this_thread::sleep_for(std::chrono::milliseconds(400));
    EXPECT_EQ(farm.status(job)->running.size(), c.frames) << c.what;
  }
}

TEST_F(SideBySide, AJobThatWaitsForMemoryGetsItBeforeAFurtherFrame) {
  const std::uint64_t frame_bytes = check_fake_settings(fake_settings(), {});
  FarmSettings farm_settings = whole_stages();
  farm_settings.memory_bytes = 3 * frame_bytes;
  Farm farm(farm_settings, blobs_);
  ScriptedWorker a, b;
  a.join(farm, "a");
  b.join(farm, "b");
  const std::string first = farm.submit(frames(8));
  auto held = hold_first(farm, a);
  ASSERT_TRUE(held);
  ASSERT_TRUE(runs(farm, first, {1, 2}));
  JobRequest wide = request(fake_settings(64, 16));  // two frames' memory
  const std::string second = farm.submit(wide);
  EXPECT_EQ(farm.status(second)->state, JobState::queued);
  // What memory is left is not enough for it, and no frame gets it, though a worker idles.
  ScriptedWorker c;
  c.join(farm, "c");
  std::this_thread::sleep_for(std::chrono::milliseconds(300));
  EXPECT_THAT(farm.status(first)->running, ElementsAre(1, 2));
  // The second frame's end frees its memory, and no third one takes it.
  std::thread helper([&] {
    while (!ended(farm.status(second)->state))
      for (ScriptedWorker* worker : {&b, &c})
        if (auto offer = worker->next(0.05)) do_it(*worker, *offer);
  });
  EXPECT_EQ(end_of(farm, second).state, JobState::done);
  helper.join();
  EXPECT_LT(farm.status(first)->frames_done, 8u);
  std::thread other([&] { serve(farm, c, first); });
  serve(farm, b, first);
  other.join();
  expect_right(farm, first, 8);
}

TEST_F(SideBySide, EarlierFramesAndOtherJobsComeBeforeAFurtherFrame) {
  FarmSettings farm_settings = settings(256);
  farm_settings.scheduler.in_flight = 1;
  Farm farm(farm_settings, blobs_);
  ScriptedWorker a, b;
  a.join(farm, "a");
  const std::string job = farm.submit(frames(2));
  for (int batch = 0; batch < 7; ++batch) do_it(a, *a.next());
  auto last = a.next();  // of the first frame's "scatter"
  ASSERT_TRUE(last);
  b.join(farm, "b");
  ASSERT_TRUE(runs(farm, job, {1, 2}));
  auto of_second = b.next();
  ASSERT_TRUE(of_second);
  EXPECT_EQ(of_second->work->stage, "scatter");
  // A job that comes later is served before the second frame's other batches.
  const std::string other = farm.submit(request());
  ASSERT_TRUE(eventually([&] { return !farm.status(other)->stages.empty(); }));
  do_it(b, *of_second);
  auto next = b.next();
  ASSERT_TRUE(next);
  EXPECT_EQ(next->work->job, other);
  // So is the first frame's next stage.
  do_it(a, *last);
  ASSERT_TRUE(eventually([&] {
    const auto stages = farm.status(job)->stages;
    return std::any_of(stages.begin(), stages.end(), [](const auto& stage) { return stage.name == "gather"; });
  }));
  farm.cancel(other);
  std::vector<std::string> order;
  for (int batch = 0; batch < 3; ++batch) {
    auto offer = b.next();
    ASSERT_TRUE(offer);
    if (offer->work->job == job) order.push_back(offer->work->stage);
    do_it(b, *offer);
    if (order.size() == 1) break;
  }
  // `a` may have had the other batch of "gather".
  EXPECT_THAT(order, ElementsAre(testing::AnyOf("gather", "scatter")));
  std::thread helper([&] { serve(farm, b, job); });
  serve(farm, a, job);
  helper.join();
  expect_right(farm, job, 2);
}

TEST_F(SideBySide, AFrameThatFailsEndsNoOther) {
  FarmSettings farm_settings = whole_stages();
  farm_settings.plan = [](const FrameSettings& frame, const SceneSummary& scene) {
    FrameSettings own = frame;
    if (frame.camera.origin[0] == 2 || frame.camera.origin[0] == 4) own.set["plan_throws"] = "1";
    return make_fake_plan(own, scene);
  };
  for (const int count : {1, 3}) {
    Farm farm(farm_settings, blobs_);
    std::vector<std::unique_ptr<ScriptedWorker>> workers;
    for (int i = 0; i < count; ++i) {
      workers.push_back(std::make_unique<ScriptedWorker>());
      workers.back()->join(farm, std::string("w").append(std::to_string(i)));
    }
    const std::string job = farm.submit(frames(5));
    std::vector<std::thread> helpers;
    for (auto& worker : workers) helpers.emplace_back([&] { serve(farm, *worker, job); });
    for (std::thread& helper : helpers) helper.join();
    const JobStatus status = end_of(farm, job);
    EXPECT_EQ(status.state, JobState::failed);
    EXPECT_THAT(status.message, AllOf(HasSubstr("2 of 5 frames failed"), HasSubstr("frame 2: the plan has lost"),
                                      HasSubstr("frame 4: the plan has lost"), Not(HasSubstr("frame 3"))));
    EXPECT_EQ(status.frames_done, 3u);
    EXPECT_EQ(status.frames_failed, 2u);
    EXPECT_THAT(status.written, ElementsAre(Pair(1, 1), Pair(3, 3), Pair(5, 5)));
    ASSERT_THAT(farm.files(job), SizeIs(9));
    for (const auto& file : farm.files(job)) EXPECT_TRUE(std::filesystem::exists(file)) << file;
    for (std::size_t i = 0; i < 3; ++i)
      EXPECT_EQ(report(farm, job, ".json", i)["pixels_sha256"], fake_pixels_sha256(fake_settings()));
  }
}

TEST_F(SideBySide, CancellingTakesAllFramesBack) {
  Farm farm(whole_stages(), blobs_);
  ScriptedWorker a, b;
  a.join(farm, "a");
  b.join(farm, "b");
  const std::string job = farm.submit(frames(4));
  const auto of_first = a.next();
  ASSERT_TRUE(of_first);
  ASSERT_TRUE(runs(farm, job, {1, 2}));
  const auto of_second = b.next();
  ASSERT_TRUE(of_second);
  farm.cancel(job);
  EXPECT_EQ(end_of(farm, job).state, JobState::cancelled);
  EXPECT_TRUE(a.was_revoked(of_first->lease));
  EXPECT_TRUE(b.was_revoked(of_second->lease));
  EXPECT_THAT(farm.files(job), IsEmpty());
}

TEST_F(SideBySide, ProgressNeverGoesBackwards) {
  FarmSettings farm_settings = settings(256);
  Farm farm(farm_settings, blobs_);
  std::vector<std::unique_ptr<ScriptedWorker>> workers;
  for (int i = 0; i < 4; ++i) {
    workers.push_back(std::make_unique<ScriptedWorker>());
    workers.back()->join(farm, std::string("w").append(std::to_string(i)));
  }
  const std::string job = farm.submit(frames(6));
  std::mt19937 random(7);
  double progress = 0;
  std::size_t most = 0;
  std::vector<std::pair<ScriptedWorker*, Offered>> held;
  while (!ended(farm.status(job)->state)) {
    for (auto& worker : workers)
      while (auto offer = worker->next(0.001)) held.emplace_back(worker.get(), *offer);
    if (!held.empty()) {
      std::swap(held[random() % held.size()], held.back());
      const auto [worker, offer] = held.back();
      held.pop_back();
      try {
        do_it(*worker, offer);
      } catch (const Error&) {
        // A copy of it came first, and what it reads has gone with its stage.
        EXPECT_TRUE(worker->was_revoked(offer.lease));
        if (!worker->was_revoked(offer.lease)) return;
      }
    }
    if (random() % 4 == 0) std::this_thread::sleep_for(std::chrono::milliseconds(30));
    const JobStatus status = *farm.status(job);
    EXPECT_GE(status.progress, progress);
    EXPECT_GE(status.progress, static_cast<double>(status.frames_done) / 6 - 1e-9);
    EXPECT_LE(status.progress, 1);
    progress = status.progress;
    most = std::max(most, status.running.size());
  }
  EXPECT_GE(most, 2u);
  expect_right(farm, job, 6);
}

class SideBySideJournal : public SideBySide {
 protected:
  FarmSettings journaled() {
    FarmSettings farm_settings = settings(256);
    farm_settings.scheduler.in_flight = 1;
    farm_settings.journal =
        std::make_shared<JournalWriter>(open_sqlite_journal(folder_.path() / "journal.sqlite"), farm_settings.log);
    farm_settings.scheduler.incarnation = farm_settings.journal->begin();
    farm_settings.records = folder_.path() / "records";
    return farm_settings;
  }
};

TEST_F(SideBySideJournal, TheNextFarmGoesOnWithEveryFrameThatWasBegun) {
  std::string job;
  {
    Farm farm(journaled(), blobs_);
    ScriptedWorker a, b;
    a.join(farm, "a");
    job = farm.submit(frames(3));
    for (int batch = 0; batch < 7; ++batch) do_it(a, *a.next());
    ASSERT_TRUE(a.next());  // the eighth, which is never answered
    b.join(farm, "b");
    ASSERT_TRUE(runs(farm, job, {1, 2}));
    for (int batch = 0; batch < 3; ++batch) do_it(b, *b.next());
  }
  Farm farm(journaled(), blobs_);
  EXPECT_EQ(farm.status(job)->frames_done, 0u);
  ScriptedWorker worker;
  worker.join(farm);
  std::map<std::string, int> batches;
  while (!ended(farm.status(job)->state))
    if (auto offer = worker.next(0.05)) {
      ++batches[offer->work->stage];
      do_it(worker, *offer);
    }
  EXPECT_EQ(batches["scatter"], 1 + 5 + 8);
  EXPECT_EQ(batches["gather"], 3 * 2);
  expect_right(farm, job, 3);
  EXPECT_THAT(report(farm, job, ".json", 1)["skips"].dump(), HasSubstr("accepted before the frame"));
}

TEST_F(SideBySideJournal, TheNextFarmKnowsWhichFramesAreOver) {
  std::string job;
  const auto failing = [&] {
    FarmSettings farm_settings = journaled();
    farm_settings.scheduler.fixed_batch_items = 1 << 20;
    farm_settings.scheduler.in_flight = 2;
    farm_settings.plan = [](const FrameSettings& frame, const SceneSummary& scene) {
      FrameSettings own = frame;
      if (frame.camera.origin[0] == 2) own.set["plan_throws"] = "1";
      return make_fake_plan(own, scene);
    };
    return farm_settings;
  };
  {
    Farm farm(failing(), blobs_);
    ScriptedWorker a, b;
    a.join(farm, "a");
    job = farm.submit(frames(4));
    ASSERT_TRUE(hold_first(farm, a));
    b.join(farm, "b");
    serve_frames(farm, b, job, 2);
  }
  Farm farm(failing(), blobs_);
  EXPECT_THAT(farm.status(job)->written, ElementsAre(Pair(3, 3)));
  EXPECT_EQ(farm.status(job)->frames_failed, 1u);
  ScriptedWorker worker;
  worker.join(farm);
  serve(farm, worker, job);
  const JobStatus status = end_of(farm, job);
  EXPECT_EQ(status.state, JobState::failed);
  EXPECT_THAT(status.message, HasSubstr("1 of 4 frames failed: frame 2: the plan has lost"));
  EXPECT_THAT(status.written, ElementsAre(Pair(1, 1), Pair(3, 4)));
  EXPECT_EQ(farm.totals().frames_written, 2u) << "what was over is left alone";
}

TEST(FrameSet, KeepsNeighboursTogether) {
  FrameSet set;
  std::set<std::uint64_t> model;
  std::mt19937 random(3);
  for (int i = 0; i < 400; ++i) {
    const std::uint64_t frame = random() % 200;
    set.insert(frame);
    model.insert(frame);
    ASSERT_EQ(set.count(), model.size());
    std::set<std::uint64_t> listed;
    std::uint64_t before = ~std::uint64_t{0} - 1;
    for (const auto& [first, last] : set.ranges()) {
      ASSERT_LE(first, last);
      ASSERT_NE(before + 1, first) << "neighbours in two ranges";
      for (std::uint64_t f = first; f <= last; ++f) listed.insert(f);
      before = last;
    }
    ASSERT_EQ(listed, model);
    for (std::uint64_t f = 0; f < 201; ++f) ASSERT_EQ(set.contains(f), model.contains(f));
  }
}

}  // namespace
}  // namespace gleaner::test

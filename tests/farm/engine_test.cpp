// The farm's engine with scripted workers: what is leased, what is accepted, what ends up on disk.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstring>
#include <future>
#include <span>
#include <stop_token>

#include "coordinator/blobs/sha256.h"
#include "coordinator/jobs/progress.h"
#include "kernels/denoise_records.h"
#include "tests/farm/scripted_farm.h"

namespace gleaner::test {
namespace {

using testing::HasSubstr;
using testing::SizeIs;

TEST_F(FarmEngine, RendersAFrameWithOneWorker) {
  Farm farm(settings(), blobs_);
  ScriptedWorker worker;
  worker.join(farm);
  std::string job = farm.submit(request());
  serve(farm, worker, job);
  JobStatus status = end_of(farm, job);
  ASSERT_EQ(status.state, JobState::done) << status.message;
  EXPECT_THAT(farm.files(job), SizeIs(3));
  for (const auto& path : farm.files(job)) EXPECT_TRUE(std::filesystem::exists(path)) << path;

  auto json = report(farm, job);
  EXPECT_EQ(json["pixels_sha256"], fake_pixels_sha256(fake_settings()));
  EXPECT_EQ(json["scene"], "fake.glb");
  EXPECT_EQ(json["method"], "fake");
  EXPECT_EQ(json["size"], (nlohmann::json{32, 16}));
  EXPECT_EQ(json["parameters"]["fake"], true);
  EXPECT_EQ(json["parameters"]["seed"], 5);
  EXPECT_GT(json["seconds"], 0.0);
  EXPECT_GE(json["seconds"], json["plan_seconds"].get<double>() + json["write_seconds"].get<double>());
  ASSERT_EQ(json["stages"].size(), 2u);
  const auto& scatter = json["stages"][0];
  EXPECT_EQ(scatter["name"], "scatter");
  EXPECT_EQ(scatter["kind"], "fake-scatter");
  EXPECT_EQ(scatter["items"], 2048);
  EXPECT_EQ(scatter["batches"], 8);
  EXPECT_EQ(scatter["workers"]["scripted"]["items"], 2048);
  EXPECT_NEAR(scatter["workers"]["scripted"]["seconds"], 0.08, 1e-9);
  EXPECT_NEAR(scatter["trace_seconds"], 0.04, 1e-9);
  EXPECT_NEAR(scatter["kernel_seconds"], 0.02, 1e-9);
  EXPECT_GE(scatter["seconds"], 0.0);
  EXPECT_EQ(json["stages"][1]["batches"], 2);
  std::uint64_t items = 2048 + 512;
  EXPECT_EQ(json["rays"]["camera"], items);
  EXPECT_EQ(json["rays"]["scatter"], 2 * items);
  EXPECT_EQ(json["rays"]["shadow"], 3 * items);
  EXPECT_EQ(json["rays"]["total"], 6 * items);
  EXPECT_EQ(json["bytes"]["downloaded"], 2048 * 8 + 512 * 4);
  EXPECT_EQ(json["skips"][0]["what"], "photons");
  EXPECT_EQ(json["skips"][0]["count"], 7);
  EXPECT_EQ(json["nonfinite"], 0);
  EXPECT_EQ(json["devices"][0]["name"], "a script");
}

TEST_F(FarmEngine, TheNextStageBeginsInTheCallThatEndsTheLastOne) {
  Farm farm(settings(), blobs_);
  ScriptedWorker worker;
  worker.join(farm);
  std::string job = farm.submit(request());
  for (int batch = 0; batch < 8; ++batch) {
    auto offer = worker.next();
    ASSERT_TRUE(offer);
    ASSERT_EQ(offer->work->stage, "scatter");
    EXPECT_EQ(worker.deliver(*offer, worker.compute(*offer, blobs_)), Verdict::accepted);
  }
  auto offer = worker.next();
  ASSERT_TRUE(offer);
  EXPECT_EQ(offer->work->stage, "gather");
  ASSERT_EQ(offer->work->inputs.size(), 1u);
  EXPECT_EQ(offer->work->inputs[0].name, "hashes");
  EXPECT_TRUE(blobs_.get(offer->work->inputs[0].blob)) << "an input is findable by its id while its stage runs";
  std::string input = offer->work->inputs[0].blob;
  offer.reset();
  farm.cancel(job);
  end_of(farm, job);
  EXPECT_TRUE(eventually([&] { return !blobs_.get(input); })) << "artifacts go with their frame";
}

TEST_F(FarmEngine, AWorkerHoldsItsNextLeaseWhileItRuns) {
  Farm farm(settings(), blobs_);
  ScriptedWorker worker;
  worker.join(farm);
  farm.submit(request());
  ASSERT_TRUE(worker.next());
  EXPECT_TRUE(worker.next()) << "one lease runs, one waits";
  EXPECT_FALSE(worker.next(0.1)) << "but not three";
}

TEST_F(FarmEngine, AnyOrderOfResultsGivesTheSamePixels) {
  Farm farm(settings(100), blobs_);
  ScriptedWorker first, second, third;
  first.join(farm, "first");
  second.join(farm, "second");
  third.join(farm, "third");
  std::string job = farm.submit(request());
  std::deque<std::pair<ScriptedWorker*, Offered>> held;
  int turn = 0;
  while (!ended(farm.status(job)->state)) {
    for (ScriptedWorker* worker : {&first, &second, &third})
      while (auto offer = worker->next(0.01)) held.push_back({worker, *offer});
    if (held.empty()) continue;
    // Mostly the youngest first: the oldest ones' results come long after they were handed out.
    const bool oldest = turn++ % 4 == 0;
    auto [worker, offer] = oldest ? held.front() : held.back();
    oldest ? held.pop_front() : held.pop_back();
    // What was revoked meanwhile has lost its inputs.
    if (!worker->was_revoked(offer.lease)) worker->deliver(offer, worker->compute(offer, blobs_));
  }
  ASSERT_EQ(end_of(farm, job).state, JobState::done);
  auto json = report(farm, job);
  EXPECT_EQ(json["pixels_sha256"], fake_pixels_sha256(fake_settings()));
  EXPECT_GE(json["stages"][0]["workers"].size(), 2u);
}

TEST_F(FarmEngine, DropsWhatItMustNotAccept) {
  Farm farm(settings(), blobs_);
  ScriptedWorker worker, stranger;
  worker.join(farm, "worker");
  stranger.join(farm, "stranger");
  std::string job = farm.submit(request());
  auto mine = worker.next(), theirs = stranger.next();
  ASSERT_TRUE(mine && theirs);
  Bytes records = worker.compute(*mine, blobs_);
  // Another worker's lease, a worker that nobody knows, an epoch that was never given.
  EXPECT_EQ(farm.result(stranger.id, mine->lease.id, mine->lease.epoch, records, {}), Verdict::wrong_worker);
  EXPECT_EQ(farm.result(999, mine->lease.id, mine->lease.epoch, records, {}), Verdict::unknown_lease);
  EXPECT_EQ(farm.result(worker.id, mine->lease.id, mine->lease.epoch + 1000000, records, {}), Verdict::stale);
  EXPECT_EQ(farm.result(worker.id, mine->lease.id + 1000000, mine->lease.epoch, records, {}), Verdict::unknown_lease);
  EXPECT_EQ(farm.status(job)->stages.at(0).items_done, 0u);
  EXPECT_EQ(worker.deliver(*mine, records), Verdict::accepted);
  EXPECT_EQ(farm.status(job)->stages.at(0).items_done, mine->lease.count);
  EXPECT_NE(worker.deliver(*mine, records), Verdict::accepted) << "the same result twice";
  EXPECT_EQ(farm.status(job)->stages.at(0).items_done, mine->lease.count);
  worker.deliver(*worker.next(), worker.compute(*mine, blobs_));
  stranger.deliver(*theirs, stranger.compute(*theirs, blobs_));
  farm.cancel(job);
  EXPECT_EQ(end_of(farm, job).state, JobState::cancelled);
  EXPECT_EQ(farm.result(worker.id, mine->lease.id, mine->lease.epoch, records, {}), Verdict::stage_gone);
}

TEST_F(FarmEngine, AResultOfAnotherSizeIsAFailureAndItsItemsComeBack) {
  Farm farm(settings(), blobs_);
  ScriptedWorker liar, honest;
  liar.join(farm, "liar");
  std::string job = farm.submit(request());
  auto offer = liar.next();
  ASSERT_TRUE(offer);
  Bytes records = liar.compute(*offer, blobs_);
  records.pop_back();
  EXPECT_NE(liar.deliver(*offer, records), Verdict::accepted);
  farm.leave(liar.id);
  honest.join(farm, "honest");
  serve(farm, honest, job);
  ASSERT_EQ(end_of(farm, job).state, JobState::done);
  EXPECT_EQ(report(farm, job)["pixels_sha256"], fake_pixels_sha256(fake_settings()));
}

TEST_F(FarmEngine, ALostWorkersItemsGoToAnotherAtOnce) {
  Farm farm(settings(1024), blobs_);
  ScriptedWorker lost, other;
  lost.join(farm, "lost");
  std::string job = farm.submit(request());
  ASSERT_TRUE(lost.next());
  ASSERT_TRUE(lost.next());
  other.join(farm, "other");
  farm.leave(lost.id);
  ASSERT_EQ(farm.workers().size(), 1u);
  serve(farm, other, job);
  ASSERT_EQ(end_of(farm, job).state, JobState::done);
  EXPECT_EQ(report(farm, job)["pixels_sha256"], fake_pixels_sha256(fake_settings()));
}

TEST_F(FarmEngine, ASilentWorkerIsGivenUp) {
  std::atomic<double> time{100};
  FarmSettings farm_settings = settings(1024);
  farm_settings.clock = [&] { return time.load(); };
  farm_settings.silence = 30;
  Farm farm(farm_settings, blobs_);
  ScriptedWorker silent, talks;
  silent.join(farm, "silent");
  std::string job = farm.submit(request());
  ASSERT_TRUE(silent.next());
  talks.join(farm, "talks");
  time = 125;
  farm.heard(talks.id);
  time = 131;
  EXPECT_TRUE(eventually([&] { return farm.workers().size() == 1; }));
  EXPECT_EQ(farm.workers().at(0).id, "talks");
  EXPECT_THAT(silent.closed(), HasSubstr("not heard of"));
  EXPECT_TRUE(talks.next()) << "its items are another's now";
}

TEST_F(FarmEngine, AFailedRangeGoesElsewhereAndManyFailuresEndTheJobWithItsMessage) {
  Farm farm(settings(), blobs_);
  std::vector<std::unique_ptr<ScriptedWorker>> workers;
  for (int i = 0; i < 4; ++i) {
    workers.push_back(std::make_unique<ScriptedWorker>());
    workers.back()->join(farm, std::string("w").append(std::to_string(i)));
  }
  std::string job = farm.submit(request());
  bool over = eventually([&] {
    for (auto& worker : workers)
      if (auto offer = worker->next(0.001))
        farm.failed(worker->id, offer->lease.id, offer->lease.epoch, "the device is on fire");
    return ended(farm.status(job)->state);
  });
  ASSERT_TRUE(over);
  JobStatus status = end_of(farm, job);
  EXPECT_EQ(status.state, JobState::failed);
  EXPECT_THAT(status.message, HasSubstr("the device is on fire"));
  EXPECT_THAT(status.message, HasSubstr("scatter"));
}

TEST_F(FarmEngine, ASingleWorkerThatAlwaysFailsEndsTheJobToo) {
  Farm farm(settings(), blobs_);
  ScriptedWorker worker;
  worker.join(farm);
  std::string job = farm.submit(request());
  EXPECT_TRUE(eventually([&] {
    if (auto offer = worker.next(0.001)) farm.failed(worker.id, offer->lease.id, offer->lease.epoch, "no memory");
    return ended(farm.status(job)->state);
  })) << "it must not wait for ever for a better worker";
  EXPECT_EQ(farm.status(job)->state, JobState::failed);
}

TEST_F(FarmEngine, CancelRevokesWhatIsOut) {
  Farm farm(settings(), blobs_);
  ScriptedWorker worker;
  worker.join(farm);
  std::string job = farm.submit(request());
  auto offer = worker.next();
  ASSERT_TRUE(offer);
  auto status = farm.cancel(job);
  ASSERT_TRUE(status);
  EXPECT_EQ(end_of(farm, job).state, JobState::cancelled);
  EXPECT_EQ(worker.revoked().size(), 2u);
  EXPECT_EQ(worker.deliver(*offer, worker.compute(*offer, blobs_)), Verdict::stage_gone);
  EXPECT_TRUE(farm.files(job).empty());
  EXPECT_FALSE(farm.cancel("no-such-job"));
}

TEST_F(FarmEngine, ACancelThatWasAcceptedHolds) {
  FarmSettings cancelling = settings();
  Farm* farm = nullptr;
  JobState answered = JobState::queued;
  // Where its files go is asked when the picture is made: no later moment can be cancelled in.
  cancelling.paths = [&, paths = cancelling.paths](const std::string& job, std::uint32_t frame) {
    answered = farm->cancel(job)->state;
    return paths(job, frame);
  };
  Farm cancelled(cancelling, blobs_);
  farm = &cancelled;
  ScriptedWorker worker;
  worker.join(cancelled);
  std::string job = cancelled.submit(request());
  serve(cancelled, worker, job);
  EXPECT_EQ(end_of(cancelled, job).state, JobState::cancelled);
  EXPECT_EQ(answered, JobState::running) << "who cancelled was not told that it is too late";
}

TEST_F(FarmEngine, TwoJobsRunAtTheSameTimeAndAThirdWaits) {
  Farm farm(settings(), blobs_);
  FrameSettings other = fake_settings();
  other.seed = 6;
  std::string first = farm.submit(request()), second = farm.submit(request(other)), third = farm.submit(request());
  EXPECT_EQ(farm.status(first)->state, JobState::running);
  EXPECT_EQ(farm.status(second)->state, JobState::running);
  EXPECT_EQ(farm.status(third)->state, JobState::queued);
  EXPECT_THAT(farm.why(third)->at(0), HasSubstr("waits until"));
  EXPECT_THAT(farm.why(first)->at(0), HasSubstr("no worker"));
  std::string fourth = farm.submit(request());
  farm.cancel(fourth);
  EXPECT_EQ(farm.status(fourth)->state, JobState::cancelled) << "a job that waits ends at once";
  ScriptedWorker a, b;
  a.join(farm, "a");
  b.join(farm, "b");
  std::thread helper([&] { serve(farm, b, third); });
  serve(farm, a, third);
  helper.join();
  for (const auto& job : {first, second, third}) ASSERT_EQ(end_of(farm, job).state, JobState::done) << job;
  EXPECT_EQ(report(farm, first)["pixels_sha256"], fake_pixels_sha256(fake_settings()));
  EXPECT_EQ(report(farm, second)["pixels_sha256"], fake_pixels_sha256(other));
  EXPECT_EQ(report(farm, third)["pixels_sha256"], fake_pixels_sha256(fake_settings()));
  EXPECT_THAT(farm.list(), SizeIs(4));
}

TEST_F(FarmEngine, ABrokenPlanFailsItsJobAndNoOther) {
  Farm farm(settings(), blobs_);
  ScriptedWorker worker;
  worker.join(farm);
  for (const char* defect : {"plan_throws", "input_unknown"}) {
    FrameSettings broken = fake_settings();
    broken.set[defect] = std::string("1");
    std::string job = farm.submit(request(broken));
    serve(farm, worker, job);
    JobStatus status = end_of(farm, job);
    EXPECT_EQ(status.state, JobState::failed) << defect;
    EXPECT_FALSE(status.message.empty());
  }
  std::string job = farm.submit(request());
  serve(farm, worker, job);
  EXPECT_EQ(end_of(farm, job).state, JobState::done);
}

TEST_F(FarmEngine, AnUnwritableFolderFailsTheJobAndTheFarmLives) {
  FarmSettings farm_settings = settings();
  std::ofstream(folder_.path() / "file") << "in the way";
  bool broken = true;
  auto good = farm_settings.paths;
  farm_settings.paths = [&](const std::string& job, std::uint32_t frame) {
    return broken ? FramePaths{folder_.path() / "file" / "a.exr", {}, {}} : good(job, frame);
  };
  Farm farm(farm_settings, blobs_);
  ScriptedWorker worker;
  worker.join(farm);
  std::string job = farm.submit(request());
  serve(farm, worker, job);
  JobStatus status = end_of(farm, job);
  EXPECT_EQ(status.state, JobState::failed);
  EXPECT_THAT(status.message, HasSubstr("file"));
  broken = false;
  job = farm.submit(request());
  serve(farm, worker, job);
  EXPECT_EQ(end_of(farm, job).state, JobState::done);
}

TEST_F(FarmEngine, RefusesWhatCannotBeAJob) {
  Farm farm(settings(), blobs_);
  JobRequest unknown = request();
  unknown.settings.method = "paint";
  EXPECT_THROW(farm.submit(unknown), Error);
  JobRequest blobless = request();
  blobless.scenes.front().scene_blob = std::string(64, 'a');
  EXPECT_THROW(farm.submit(blobless), Error);
  JobRequest backwards = request();
  backwards.first_frame = 3;
  backwards.last_frame = 2;
  EXPECT_THROW(farm.submit(backwards), Error);
  JobRequest endless = request();
  endless.first_frame = 0;
  for (std::uint32_t last : {4294967294u, 4294967295u}) {
    endless.last_frame = last;
    EXPECT_THROW(farm.submit(endless), Error) << last;
  }
  EXPECT_TRUE(farm.list().empty());
}

TEST_F(FarmEngine, AStageTooLargeForTheCoordinatorIsRefusedWithItsSize) {
  FarmSettings farm_settings = settings();
  farm_settings.artifact_bytes = 1000;
  Farm farm(farm_settings, blobs_);
  std::string job = farm.submit(request());
  JobStatus status = end_of(farm, job);
  EXPECT_EQ(status.state, JobState::failed);
  EXPECT_THAT(status.message, HasSubstr("1000 bytes"));
}

TEST_F(FarmEngine, APreviewShowsWhatCameIn) {
  Farm farm(settings(), blobs_);
  ScriptedWorker worker;
  worker.join(farm);
  std::string job = farm.submit(request());
  EXPECT_FALSE(farm.preview(job)) << "nothing came in";
  while (true) {
    auto offer = worker.next();
    ASSERT_TRUE(offer);
    bool gather = offer->work->stage == "gather";
    worker.deliver(*offer, worker.compute(*offer, blobs_));
    if (gather) break;  // the first half of the picture
  }
  ASSERT_TRUE(eventually([&] {
    auto film = farm.preview(job);
    return film && film->find("R")->values.at(0) != 0;
  }));
  EXPECT_EQ(farm.preview(job)->find("R")->values.back(), 0) << "the second half is not there yet";
  serve(farm, worker, job);
  EXPECT_EQ(end_of(farm, job).state, JobState::done);
}

TEST_F(FarmEngine, FramesOfAStillSceneAreRenderedOnce) {
  Farm farm(settings(), blobs_);
  ScriptedWorker worker;
  worker.join(farm);
  JobRequest frames = request();
  frames.first_frame = 3;
  frames.last_frame = 5;
  std::string job = farm.submit(frames);
  serve(farm, worker, job);
  JobStatus status = end_of(farm, job);
  ASSERT_EQ(status.state, JobState::done) << status.message;
  EXPECT_EQ(status.frames, 3u);
  EXPECT_EQ(status.frames_done, 3u);
  EXPECT_THAT(farm.files(job), SizeIs(9));
  auto first = report(farm, job, ".json", 0), last = report(farm, job, ".json", 2);
  EXPECT_EQ(first["frame"], 3);
  EXPECT_EQ(last["frame"], 5);
  EXPECT_EQ(last["pixels_sha256"], first["pixels_sha256"]);
  EXPECT_EQ(first["rays"]["total"], 6 * 2560);
  EXPECT_EQ(last["rays"]["total"], 0);
  EXPECT_THAT(last["skips"].back()["why"], HasSubstr("frame 3"));
}

TEST_F(FarmEngine, TheLastFrameNumbersEnd) {
  Farm farm(settings(), blobs_);
  ScriptedWorker worker;
  worker.join(farm);
  JobRequest frames = request();
  frames.first_frame = 4294967294u;
  frames.last_frame = 4294967295u;
  std::string job = farm.submit(frames);
  serve(farm, worker, job);
  JobStatus status = end_of(farm, job);
  ASSERT_EQ(status.state, JobState::done) << status.message;
  EXPECT_EQ(status.frames_done, 2u);
  EXPECT_EQ(report(farm, job, ".json", 1)["frame"], 4294967295u);
}

TEST_F(FarmEngine, ATimeLimitEndsTheFrameWithWhatThereIs) {
  std::atomic<double> time{0};
  FarmSettings farm_settings = timed_settings(time, 128);
  Farm farm(farm_settings, blobs_);
  ScriptedWorker worker;
  worker.join(farm);
  auto deliver = [&](int batches) {
    for (int batch = 0; batch < batches; ++batch) {
      auto offer = worker.next();
      ASSERT_TRUE(offer);
      EXPECT_EQ(worker.deliver(*offer, worker.compute(*offer, blobs_)), Verdict::accepted);
    }
  };
  JobRequest limited = request();
  limited.time_limit = 1000;

  // Within the second stage: 16 batches of the first one, 2 of the second one's 4, and a third that may come before the
  // job looks at the clock, between that and the frame's end, or after it.
  std::string job = farm.submit(limited);
  deliver(18);
  time = 2000;
  auto third = worker.next(0.01);
  const bool in_time = third && worker.deliver(*third, worker.compute(*third, blobs_)) == Verdict::accepted;
  JobStatus status = end_of(farm, job);
  ASSERT_EQ(status.state, JobState::done) << status.message;
  auto json = report(farm, job);
  EXPECT_EQ(json["time_limit"]["reached"], true);
  EXPECT_EQ(json["stages"][0]["items"], 2048);
  EXPECT_THAT(json["stages"][1]["items"].get<int>(), in_time ? testing::AnyOf(256, 384) : testing::AnyOf(256, 256));
  EXPECT_NE(json["pixels_sha256"], fake_pixels_sha256(fake_settings()));

  // Within the first stage, which must be whole: the second one is not waited for.
  job = farm.submit(limited);
  deliver(3);
  time = 4000;
  deliver(13);
  status = end_of(farm, job);
  ASSERT_EQ(status.state, JobState::done) << status.message;
  json = report(farm, job);
  EXPECT_EQ(json["time_limit"]["reached"], true);
  EXPECT_EQ(json["stages"][0]["items"], 2048);
  EXPECT_EQ(json["stages"][1]["items"], 0);

  // Early enough: the limit changes nothing.
  job = farm.submit(limited);
  serve(farm, worker, job);
  EXPECT_EQ(end_of(farm, job).state, JobState::done);
  EXPECT_EQ(report(farm, job)["pixels_sha256"], fake_pixels_sha256(fake_settings()));
  EXPECT_EQ(report(farm, job)["time_limit"]["reached"], false);
}

// As much work as the pace so far does in the seconds that are left.
TEST_F(FarmEngine, APlanKnowsWhatItsTimeLimitAllows) {
  std::atomic<double> time{0};
  FarmSettings farm_settings = timed_settings(time, 128);
  Farm farm(farm_settings, blobs_);
  ScriptedWorker worker;
  worker.join(farm);
  JobRequest limited = request();
  limited.time_limit = 1000;
  const std::string job = farm.submit(limited);
  for (int batch = 0; batch < 20; ++batch) {  // 16 of the first stage
    auto offer = worker.next();
    ASSERT_TRUE(offer);
    if (batch < 16) time = time + 10;
    EXPECT_EQ(worker.deliver(*offer, worker.compute(*offer, blobs_)), Verdict::accepted);
  }
  ASSERT_EQ(end_of(farm, job).state, JobState::done);
  const auto allowed = report(farm, job)["parameters"]["allowed"];
  ASSERT_EQ(allowed.size(), 3u);
  EXPECT_EQ(allowed[0], -1) << "nothing is known yet";
  EXPECT_NEAR(allowed[1].get<double>(), 128 / 10.0 * (1000 - 160), 1e-3);
  const std::string other = farm.submit(request());
  serve(farm, worker, other);
  ASSERT_EQ(end_of(farm, other).state, JobState::done);
  EXPECT_EQ(report(farm, other)["parameters"]["allowed"].size(), 0u) << "without a limit it is not asked";
}

TEST_F(FarmEngine, StreamedRecordsReachThePlanInItemOrderWhateverOrderTheyArriveIn) {
  FarmSettings many = settings(128);
  many.scheduler.in_flight = 16;
  Farm farm(many, blobs_);
  ScriptedWorker worker;
  worker.join(farm);
  FrameSettings streamed = fake_settings();
  streamed.set["stream"] = std::string("1");
  std::string job = farm.submit(request(streamed));
  for (const Offered& offer : all_of(worker, "scatter", 16)) worker.deliver(offer, worker.compute(offer, blobs_));
  std::vector<Offered> gathers = all_of(worker, "gather", 4);
  ASSERT_THAT(gathers, SizeIs(4));
  for (std::size_t i : {2u, 1u, 3u}) worker.deliver(gathers[i], worker.compute(gathers[i], blobs_));
  // The first batch has not arrived. (There may be a preview: the first stage's records were shown to the plan.)
  EXPECT_FALSE(eventually(
      [&] {
        const auto film = farm.preview(job);
        return (film && film->find("R")->values.at(256) != 0) || ended(farm.status(job)->state);
      },
      0.5));
  EXPECT_EQ(farm.status(job)->stages.at(1).items_done, 384u);
  worker.deliver(gathers[0], worker.compute(gathers[0], blobs_));
  JobStatus status = end_of(farm, job);
  ASSERT_EQ(status.state, JobState::done) << status.message;
  EXPECT_EQ(report(farm, job)["pixels_sha256"], fake_pixels_sha256(fake_settings()));
}

TEST_F(FarmEngine, ATimeLimitTakesWhatAStreamedStageHasInOrder) {
  std::atomic<double> time{0};
  FarmSettings many = settings(128);
  many.scheduler.in_flight = 16;
  many.clock = [&] { return time.load(); };
  many.silence = many.scheduler.lease_floor = 1e9;
  Farm farm(many, blobs_);
  ScriptedWorker worker;
  worker.join(farm);
  JobRequest limited = request();
  limited.settings.set["stream"] = std::string("1");
  limited.time_limit = 1000;
  std::string job = farm.submit(limited);
  for (const Offered& offer : all_of(worker, "scatter", 16)) worker.deliver(offer, worker.compute(offer, blobs_));
  std::vector<Offered> gathers = all_of(worker, "gather", 4);
  ASSERT_THAT(gathers, SizeIs(4));
  // In time, whether the plan has taken it yet or not.
  worker.deliver(gathers[0], worker.compute(gathers[0], blobs_));
  worker.deliver(gathers[2], worker.compute(gathers[2], blobs_));
  time = 2000;
  // The clock is looked at when something happens.
  worker.deliver(gathers[3], worker.compute(gathers[3], blobs_));
  JobStatus status = end_of(farm, job);
  ASSERT_EQ(status.state, JobState::done) << status.message;
  EXPECT_EQ(report(farm, job)["stages"][1]["items"], 128);
}

TEST_F(FarmEngine, ReleasedArtifactsAreFreedWhileTheFrameRuns) {
  Farm farm(settings(), blobs_);
  ScriptedWorker worker;
  worker.join(farm);
  const std::string unread = sha256_hex(bytes_of(unread_data()));
  FrameSettings releasing = fake_settings();
  releasing.set["release"] = std::string("1");
  std::string job = farm.submit(request(releasing));
  std::optional<Offered> offer = worker.next();
  EXPECT_TRUE(blobs_.get(unread));
  while (offer && offer->work->stage == "scatter") {
    worker.deliver(*offer, worker.compute(*offer, blobs_));
    offer = worker.next();
  }
  ASSERT_TRUE(offer);
  EXPECT_EQ(farm.status(job)->state, JobState::running);
  EXPECT_TRUE(eventually([&] { return !blobs_.get(unread); })) << "no stage reads it any more";
  EXPECT_TRUE(blobs_.get(offer->work->inputs.at(0).blob));
  worker.deliver(*offer, worker.compute(*offer, blobs_));
  serve(farm, worker, job);
  EXPECT_EQ(end_of(farm, job).state, JobState::done);
}

TEST_F(FarmEngine, EachFramesTimeLimitRunsFromItsOwnStart) {
  std::atomic<double> time{0};
  FarmSettings farm_settings = timed_settings(time, 2048);
  farm_settings.active_jobs = 1;
  Farm farm(farm_settings, blobs_);
  ScriptedWorker worker;
  worker.join(farm);
  std::string before = farm.submit(request());
  JobRequest limited = request();
  limited.time_limit = 1000;
  limited.last_frame = 2;
  limited.cameras = {limited.settings.camera, limited.settings.camera};
  limited.cameras[1].origin[0] = 1;
  std::string job = farm.submit(limited);
  time = 5000;  // it waited for longer than its frames may take
  serve(farm, worker, before);
  ASSERT_EQ(end_of(farm, before).state, JobState::done);
  while (!ended(farm.status(job)->state)) {  // two frames of two stages
    auto offer = worker.next(0.05);
    if (!offer) continue;
    time = time + 400;
    worker.deliver(*offer, worker.compute(*offer, blobs_));
  }
  ASSERT_EQ(end_of(farm, job).state, JobState::done);
  for (std::size_t frame : {0u, 1u}) {
    EXPECT_EQ(report(farm, job, ".json", frame)["time_limit"]["reached"], false) << "frame " << frame + 1;
    EXPECT_EQ(report(farm, job, ".json", frame)["stages"][1]["items"], 512);
  }
}

TEST_F(FarmEngine, WhatAPlanWarnsOfIsToldToPeople) {
  Farm farm(settings(), blobs_);
  ScriptedWorker worker;
  worker.join(farm);
  FrameSettings warning = fake_settings();
  warning.set["warn"] = "the target error was not reached";
  std::string job = farm.submit(request(warning));
  serve(farm, worker, job);
  JobStatus status = end_of(farm, job);
  EXPECT_EQ(status.state, JobState::done);
  EXPECT_THAT(status.message, HasSubstr("the target error was not reached"));
  EXPECT_EQ(report(farm, job)["warnings"][0], "the target error was not reached");
}

TEST_F(FarmEngine, ProgressCountsStagesAndFramesToCome) {
  std::atomic<double> time{0};
  FarmSettings farm_settings = timed_settings(time);
  Farm farm(farm_settings, blobs_);
  ScriptedWorker worker;
  worker.join(farm);
  JobRequest frames = request();
  frames.last_frame = 2;
  frames.cameras = {frames.settings.camera, frames.settings.camera};
  frames.cameras[1].origin[0] = 1;
  std::string job = farm.submit(frames);
  EXPECT_EQ(farm.status(job)->progress, 0);
  const auto deliver = [&] {
    auto offer = worker.next();
    ASSERT_TRUE(offer);
    time = time + 1;  // a batch a second
    worker.deliver(*offer, worker.compute(*offer, blobs_));
  };
  for (int batch = 0; batch < 5; ++batch) deliver();
  // Half a frame: 5 of the 8 batches of "scatter" and the 2 of "gather", which its plan has not asked for yet.
  JobStatus status = *farm.status(job);
  EXPECT_NEAR(status.frame_progress, 0.5, 1e-9);
  EXPECT_NEAR(status.progress, 0.25, 1e-9);
  EXPECT_NEAR(status.frame_seconds_left, 5, 1e-9);
  EXPECT_NEAR(status.seconds_left, 15, 1e-9);
  for (int batch = 5; batch < 13; ++batch) deliver();  // 3 of the second frame
  status = *farm.status(job);
  EXPECT_EQ(status.frames_done, 1u);
  EXPECT_NEAR(status.frame_progress, 0.3, 1e-9);
  EXPECT_NEAR(status.progress, 0.65, 1e-9);
  EXPECT_NEAR(status.seconds_left, 7, 1e-9);
  while (!ended(farm.status(job)->state)) {
    auto offer = worker.next(0.05);
    if (offer) worker.deliver(*offer, worker.compute(*offer, blobs_));
  }
  EXPECT_EQ(end_of(farm, job).progress, 1);
}

TEST(FrameProgress, NeverRunsBackwards) {
  FrameProgress progress(100);
  EXPECT_LT(progress.seconds_left(), 0) << "nothing is known yet";
  progress.update(101, 10, 10);
  EXPECT_EQ(progress.part(), 0.5);
  EXPECT_NEAR(progress.seconds_left(), 1, 1e-9);
  progress.update(102, 20, 180);  // the plan asks for ten times as much as was thought
  EXPECT_EQ(progress.part(), 0.5);
  EXPECT_NEAR(progress.seconds_left(), 18, 1e-9);
  progress.update(103, 150, 50);
  EXPECT_EQ(progress.part(), 0.75);
  // Only the last seconds count.
  for (int second = 104; second <= 140; ++second) progress.update(second, 150 + 0.1 * (second - 103), 50);
  EXPECT_NEAR(progress.seconds_left(), 500, 60);
}

TEST(FrameProgress, KnowsItsPace) {
  FrameProgress progress(100);
  EXPECT_EQ(progress.pace(), 0) << "nothing is known yet";
  progress.update(108, 10, 90);  // programs were compiled until then
  progress.update(109, 40, 60);
  EXPECT_NEAR(progress.pace(), 30, 1e-9);
  progress.update(110, 60, 40);
  EXPECT_NEAR(progress.pace(), 25, 1e-9);
}

TEST_F(FarmEngine, NamesAreUniqueAmongWhoIsThere) {
  Farm farm(settings(), blobs_);
  ScriptedWorker a, b, c;
  a.join(farm, "node");
  b.join(farm, "node");
  EXPECT_EQ(a.name, "node");
  EXPECT_EQ(b.name, "node-2");
  farm.leave(a.id);
  c.join(farm, "node");
  EXPECT_EQ(c.name, "node");
}

TEST_F(FarmEngine, ADrainingWorkerFinishesWhatItHoldsAndGetsNoMore) {
  Farm farm(settings(), blobs_);
  ScriptedWorker leaving, staying;
  leaving.join(farm, "leaving");
  std::string job = farm.submit(request());
  auto a = leaving.next(), b = leaving.next();
  ASSERT_TRUE(a && b);
  farm.drain(leaving.id);
  EXPECT_TRUE(leaving.drained);
  EXPECT_EQ(leaving.deliver(*a, leaving.compute(*a, blobs_)), Verdict::accepted);
  EXPECT_EQ(leaving.deliver(*b, leaving.compute(*b, blobs_)), Verdict::accepted);
  EXPECT_FALSE(leaving.next(0.2));
  staying.join(farm, "staying");
  serve(farm, staying, job);
  EXPECT_EQ(end_of(farm, job).state, JobState::done);
}

TEST_F(FarmEngine, NonFiniteItemsAreNamed) {
  Farm farm(settings(), blobs_);
  ScriptedWorker worker;
  worker.join(farm);
  std::string job = farm.submit(request());
  auto offer = worker.next();
  ASSERT_TRUE(offer);
  BatchCost cost;
  cost.seconds = 0.01;
  cost.nonfinite = 3;
  cost.nonfinite_items = {offer->lease.first + 1};
  EXPECT_EQ(farm.result(worker.id, offer->lease.id, offer->lease.epoch, worker.compute(*offer, blobs_), cost),
            Verdict::accepted);
  serve(farm, worker, job);
  auto json = report(farm, job);
  EXPECT_EQ(json["nonfinite"], 3);
  EXPECT_EQ(json["nonfinite_items"][0]["item"], offer->lease.first + 1);
  EXPECT_EQ(json["nonfinite_items"][0]["stage"], "scatter");
}

// They say that they live, and take what there is.
TEST_F(FarmEngine, FourMuteWorkersHoldNobodyUp) {
  FarmSettings farm_settings = settings(0);
  farm_settings.scheduler.lease_floor = 30;
  farm_settings.recheck_share = 0.02;
  Farm farm(farm_settings, blobs_);
  std::vector<std::unique_ptr<ScriptedWorker>> mute;
  for (int i = 0; i < 4; ++i) {
    mute.push_back(std::make_unique<ScriptedWorker>());
    mute.back()->join(farm, "mute-" + std::to_string(i));
  }
  JobRequest frame = request();
  frame.settings.set["solo"] = "";
  const auto begun = std::chrono::steady_clock::now();
  const std::string job = farm.submit(frame);
  for (const auto& worker : mute) worker->next(0.2);
  ScriptedWorker ada;
  ada.join(farm, "ada");
  serve(farm, ada, job);
  EXPECT_EQ(farm.status(job)->state, JobState::done);
  EXPECT_LT(std::chrono::duration<double>(std::chrono::steady_clock::now() - begun).count(), 12);
  EXPECT_EQ(report(farm, job)["pixels_sha256"], fake_pixels_sha256(fake_settings()));
}

TEST_F(FarmEngine, WhyNamesWhoIsWaitedForAndWhatGoesFirst) {
  Farm farm(settings(2048), blobs_);
  ScriptedWorker mute;
  mute.join(farm, "eve");
  const std::string job = farm.submit(request());
  ASSERT_TRUE(mute.next());  // of this job, before the other one has any
  JobRequest other = request();
  other.settings.seed += 1;
  const std::string later = farm.submit(other);
  ASSERT_TRUE(mute.next());
  other.settings.seed += 1;
  ASSERT_TRUE(eventually([&] { return !farm.status(later)->stages.empty(); }));
  std::string words;
  ASSERT_TRUE(eventually(
      [&] {
        words.clear();
        const auto reasons = farm.why(job);
        for (const std::string& line : *reasons) words += line;
        return !words.empty();
      },
      20));
  EXPECT_THAT(words, HasSubstr("stage scatter: worker eve has not answered its batch"));
}

TEST_F(FarmEngine, AFrameWhoseExrCannotBeWrittenLeavesNoPng) {
  FarmSettings farm_settings = settings();
  const std::filesystem::path exr = folder_.path() / "in_the_way.exr", png = folder_.path() / "frame.png";
  std::filesystem::create_directory(exr);
  farm_settings.paths = [&](const std::string&, std::uint32_t) { return FramePaths{exr, png, {}}; };
  Farm farm(farm_settings, blobs_);
  ScriptedWorker worker;
  worker.join(farm);
  const std::string job = farm.submit(request());
  serve(farm, worker, job);
  EXPECT_EQ(farm.status(job)->state, JobState::failed);
  EXPECT_THAT(farm.status(job)->message, HasSubstr("in_the_way.exr"));
  EXPECT_FALSE(std::filesystem::exists(png));
}

TEST_F(FarmEngine, DenoisingIsRefusedWhereNobodyCan) {
  Farm farm(settings(), blobs_);
  ScriptedWorker worker;
  worker.join(farm);
  JobRequest denoised = request();
  denoised.settings.denoise = Denoise::high;
  try {
    farm.submit(denoised);
    FAIL();
  } catch (const Error& error) {
    EXPECT_THAT(error.what(), testing::HasSubstr("none of 1 workers has Open Image Denoise"));
  }
  ScriptedWorker able;
  WorkerHello hello;
  hello.name = "able";
  hello.device.denoiser = "2.5.1";
  able.join_as(farm, hello);
  const std::string job = farm.submit(denoised);
  serve(farm, worker, job);
  EXPECT_EQ(end_of(farm, job).state, JobState::done);
}

TEST_F(FarmEngine, WhoDrainsDoesNotCountAmongThoseWhoCouldDenoise) {
  Farm farm(settings(), blobs_);
  WorkerHello hello;
  hello.name = "able";
  hello.device.denoiser = "2.5.1";
  ScriptedWorker worker, able;
  worker.join(farm);
  able.join_as(farm, hello);
  ASSERT_TRUE(farm.drain("able"));
  JobRequest denoised = request();
  denoised.settings.denoise = Denoise::high;
  try {
    farm.submit(denoised);
    ADD_FAILURE() << "nobody who takes batches can denoise";
  } catch (const Error& error) {
    EXPECT_THAT(error.what(), testing::HasSubstr("none of 1 workers has Open Image Denoise"));
  }
  // Only workers that drain: as in a farm without any, the job waits for one that joins.
  Farm other(settings(), blobs_);
  ScriptedWorker leaving;
  WorkerHello unable;
  unable.name = "unable";
  leaving.join_as(other, unable);
  ASSERT_TRUE(other.drain("unable"));
  EXPECT_NO_THROW(other.submit(denoised));
}

// A batch of stage "denoise" whose picture is of this colour everywhere.
void denoise_to(ScriptedWorker& worker, const Offered& offer, float color) {
  const std::vector<kernels::DenoiseRecord> records(offer.lease.count, {{color, color, color}, 0});
  kernels::DenoiseFacts facts{};
  std::strcpy(facts.version, "2.5.1");
  facts.denoised = 1;
  const auto bytes_of = [](const auto& values) {
    const auto bytes = std::as_bytes(std::span(values));
    return Bytes(bytes.begin(), bytes.end());
  };
  EXPECT_EQ(worker.deliver(offer, bytes_of(records), 0.01, bytes_of(std::span(&facts, 1))), Verdict::accepted);
}

TEST_F(FarmEngine, APictureOfAJobThatRunsIsDenoisedByWhoCan) {
  Farm farm(settings(), blobs_);
  ScriptedWorker worker, able;
  worker.join(farm);
  const std::string job = farm.submit(request());
  const auto first = worker.next();
  ASSERT_TRUE(first);
  EXPECT_FALSE(farm.can_denoise());
  WorkerHello hello;
  hello.name = "able";
  hello.device.denoiser = "2.5.1";
  able.join_as(farm, hello);
  EXPECT_TRUE(farm.can_denoise());

  const std::vector<float> grey(12, 0.25f);
  Film film{4, 3, {{"R", grey}, {"G", grey}, {"B", grey}}};
  auto denoised = std::async(std::launch::async, [&] { return farm.denoise(job, std::move(film), {}); });
  // The job's own stage cannot end: the first batch of it is out.
  for (;;) {
    const auto offer = able.next();
    ASSERT_TRUE(offer);
    if (offer->work->kind != "denoise") {
      able.deliver(*offer, able.compute(*offer, blobs_));
      continue;
    }
    EXPECT_EQ(offer->lease.count, 12u);
    denoise_to(able, *offer, 0.5f);
    break;
  }
  const std::optional<Farm::Picture> picture = denoised.get();
  ASSERT_TRUE(picture);
  EXPECT_EQ(picture->film.width, 4u);
  EXPECT_EQ(picture->film.find("G")->values, std::vector<float>(12, 0.5f));
  EXPECT_THAT(farm.list(), SizeIs(1)) << "it is in no list";

  // Nobody waits any more.
  std::stop_source stop;
  stop.request_stop();
  EXPECT_FALSE(farm.denoise(job, Film{4, 3, {{"R", grey}, {"G", grey}, {"B", grey}}}, stop.get_token()));
  able.leave();
  EXPECT_FALSE(farm.can_denoise());
  worker.deliver(*first, worker.compute(*first, blobs_));
  serve(farm, worker, job);
  EXPECT_EQ(end_of(farm, job).state, JobState::done);
  EXPECT_FALSE(farm.denoise(job, Film{4, 3, {{"R", grey}, {"G", grey}, {"B", grey}}}, {})) << "it has ended";
}

// A plan of one solo stage that denoises.
class DenoisingPlan final : public Plan {
 public:
  Step next(const FinishedStage* finished) override {
    Step step;
    step.done = finished != nullptr;
    if (finished) return step;
    StageSpec stage{.name = "denoise", .kind = "denoise", .items = 16, .solo = true, .denoises = true, .output = {}};
    stage.output.record_bytes = 4;
    step.stages.push_back(stage);
    return step;
  }
  void preview(const std::string&, std::uint64_t, std::uint64_t, const Bytes&) override {}
  Film preview_film(bool) const override { return film(); }
  Film film() const override {
    return {4, 4, {{"R", std::vector<float>(16)}, {"G", std::vector<float>(16)}, {"B", std::vector<float>(16)}}};
  }
  std::vector<Skip> skips() const override { return {}; }
  std::string parameters_json() const override { return "{}"; }
  std::vector<std::string> outline() const override { return {}; }
};

TEST_F(FarmEngine, WhoCanDenoiseDoes) {
  FarmSettings farm_settings = settings();
  farm_settings.plan = [](const FrameSettings&, const SceneSummary&) { return std::make_unique<DenoisingPlan>(); };
  Farm farm(farm_settings, blobs_);
  ScriptedWorker without[2], able;
  without[0].join(farm, "first");
  WorkerHello hello;
  hello.name = "able";
  hello.device.denoiser = "2.5.1";
  able.join_as(farm, hello);
  without[1].join(farm, "last");
  const std::string job = farm.submit(request());
  const auto offer = able.next(5);
  ASSERT_TRUE(offer);
  EXPECT_EQ(able.deliver(*offer, Bytes(64)), Verdict::accepted);
  EXPECT_EQ(end_of(farm, job).state, JobState::done);
  for (ScriptedWorker& worker : without) EXPECT_FALSE(worker.next(0.01));
}

}  // namespace
}  // namespace gleaner::test

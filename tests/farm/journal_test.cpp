// A farm that is made anew on the journal of one that is gone.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <ctime>
#include <fstream>
#include <map>

#include "coordinator/jobs/request_codec.h"
#include "coordinator/journal/journal_writer.h"
#include "coordinator/journal/sqlite_journal.h"
#include "tests/farm/scripted_farm.h"

namespace gleaner::test {
namespace {

using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::SizeIs;

class FarmJournal : public FarmEngine {
 protected:
  // Each farm opens the journal for itself, as a process would.
  FarmSettings journaled(std::uint64_t batch_items = 256) {
    FarmSettings farm_settings = settings(batch_items);
    farm_settings.active_jobs = 1;
    farm_settings.journal =
        std::make_shared<JournalWriter>(open_sqlite_journal(folder_.path() / "journal.sqlite"), farm_settings.log);
    farm_settings.scheduler.incarnation = farm_settings.journal->begin();
    farm_settings.records = folder_.path() / "records";
    return farm_settings;
  }

  JobRequest frames(std::uint32_t first, std::uint32_t last) {
    JobRequest job = request();
    job.first_frame = first;
    job.last_frame = last;
    for (std::uint32_t i = first; i <= last; ++i) {
      job.cameras.push_back(job.settings.camera);
      job.cameras.back().origin[0] = static_cast<float>(i);
    }
    return job;
  }

  // Serves until the farm has written so many frames.
  void serve_frames(Farm& farm, ScriptedWorker& worker, std::uint64_t count) {
    while (farm.totals().frames_written < count)
      if (auto offer = worker.next(0.05)) worker.deliver(*offer, worker.compute(*offer, blobs_));
  }
};

// Records that come long before their turn wait on disk, where the journal put them, and not in memory.
TEST_F(FarmJournal, WhatWaitsForALateBatchIsReadBack) {
  FarmSettings many = journaled(128);
  many.scheduler.in_flight = 16;
  many.arrived_bytes = 1;
  Farm farm(many, blobs_);
  ScriptedWorker worker;
  worker.join(farm);
  JobRequest streamed = request();
  streamed.settings.set["stream"] = std::string("1");
  const std::string job = farm.submit(streamed);
  for (const Offered& offer : all_of(worker, "scatter", 16)) worker.deliver(offer, worker.compute(offer, blobs_));
  const std::vector<Offered> gathers = all_of(worker, "gather", 4);
  ASSERT_THAT(gathers, SizeIs(4));
  for (const std::size_t i : {2u, 1u, 3u, 0u}) worker.deliver(gathers[i], worker.compute(gathers[i], blobs_));
  const JobStatus status = end_of(farm, job);
  ASSERT_EQ(status.state, JobState::done) << status.message;
  EXPECT_EQ(report(farm, job)["pixels_sha256"], fake_pixels_sha256(fake_settings()));
  EXPECT_EQ(farm.totals().batches_read_back, 3u);
}

TEST_F(FarmJournal, AnEndedJobIsListedWithItsFiles) {
  std::string done, cancelled;
  {
    Farm farm(journaled(), blobs_);
    ScriptedWorker worker;
    worker.join(farm);
    JobRequest warned = request();
    warned.settings.set["warn"] = "too dark";
    done = farm.submit(warned);
    serve(farm, worker, done);
    cancelled = farm.submit(request());
    farm.cancel(cancelled);
    end_of(farm, cancelled);
  }
  Farm farm(journaled(), blobs_);
  const auto list = farm.list();
  ASSERT_THAT(list, SizeIs(2));
  EXPECT_EQ(list[0].id, done);
  EXPECT_EQ(list[0].state, JobState::done);
  EXPECT_THAT(list[0].message, HasSubstr("too dark"));
  EXPECT_EQ(list[0].scene_name, "fake.glb");
  EXPECT_EQ(list[0].method, "fake");
  EXPECT_EQ(list[0].width, 32u);
  EXPECT_EQ(list[0].frames_done, 1u);
  EXPECT_LT(list[0].seconds, 60);
  EXPECT_THAT(farm.files(done), SizeIs(3));
  EXPECT_EQ(list[1].id, cancelled);
  EXPECT_EQ(list[1].state, JobState::cancelled);
}

TEST_F(FarmJournal, AJobGoesOnWithTheFrameThatWasNotWritten) {
  std::string running, waiting;
  {
    Farm farm(journaled(), blobs_);
    ScriptedWorker worker;
    worker.join(farm);
    running = farm.submit(frames(3, 6));
    waiting = farm.submit(request());
    serve_frames(farm, worker, 2);
  }
  Farm farm(journaled(), blobs_);
  EXPECT_EQ(farm.status(running)->state, JobState::running);
  EXPECT_EQ(farm.status(running)->frames_done, 2u);
  EXPECT_EQ(farm.status(waiting)->state, JobState::queued);
  ScriptedWorker worker;
  worker.join(farm);
  serve(farm, worker, waiting);
  EXPECT_EQ(end_of(farm, running).state, JobState::done);
  EXPECT_EQ(end_of(farm, running).frames_done, 4u);
  EXPECT_EQ(farm.totals().frames_written, 3u) << "frames that were there are not rendered again";
  for (std::size_t i = 0; i < 4; ++i)
    EXPECT_EQ(report(farm, running, ".json", i)["pixels_sha256"], fake_pixels_sha256(fake_settings()));
}

// Batches that `worker` was offered of each stage until the job's end.
std::map<std::string, int> batches_until_the_end(Farm& farm, ScriptedWorker& worker, BlobStore& blobs,
                                                 const std::string& job) {
  std::map<std::string, int> batches;
  while (!ended(farm.status(job)->state))
    if (auto offer = worker.next(0.05)) {
      ++batches[offer->work->stage];
      worker.deliver(*offer, worker.compute(*offer, blobs));
    }
  return batches;
}

// "scatter" has 8 batches of 256 items, "gather" 2.
class FarmRecords : public FarmJournal, public testing::WithParamInterface<const char*> {
 protected:
  // A farm that ends after so many accepted batches of a frame that was begun. Returns the job.
  std::string begin(int batches) {
    JobRequest job = request();
    if (*GetParam()) job.settings.set[GetParam()] = "";
    Farm farm(journaled(), blobs_);
    ScriptedWorker worker;
    worker.join(farm);
    const std::string id = farm.submit(job);
    for (int i = 0; i < batches; ++i) {
      auto offer = worker.next();
      EXPECT_TRUE(offer);
      if (!offer) break;
      EXPECT_EQ(worker.deliver(*offer, worker.compute(*offer, blobs_)), Verdict::accepted);
    }
    return id;
  }
  std::map<std::string, int> go_on(const std::string& job) {
    Farm farm(journaled(), blobs_);
    ScriptedWorker worker;
    worker.join(farm);
    const auto batches = batches_until_the_end(farm, worker, blobs_, job);
    EXPECT_EQ(end_of(farm, job).state, JobState::done) << end_of(farm, job).message;
    EXPECT_EQ(report(farm, job)["pixels_sha256"], fake_pixels_sha256(fake_settings()));
    return batches;
  }
  std::vector<std::filesystem::path> files() const {
    std::vector<std::filesystem::path> all;
    std::error_code code;
    for (const auto& entry : std::filesystem::recursive_directory_iterator(folder_.path() / "records", code))
      if (entry.is_regular_file()) all.push_back(entry.path());
    return all;
  }
};
INSTANTIATE_TEST_SUITE_P(Gather, FarmRecords, testing::Values("", "stream", "solo"),
                         [](const auto& kind) { return *kind.param ? std::string(kind.param) : "collect"; });

TEST_P(FarmRecords, OnlyWhatIsMissingIsComputed) {
  const std::string job = begin(3);
  EXPECT_EQ(files().size(), 1u);
  auto batches = go_on(job);
  EXPECT_EQ(batches["scatter"], 5);
  EXPECT_EQ(batches["gather"], std::string(GetParam()) == "solo" ? 1 : 2);
  EXPECT_TRUE(files().empty()) << "they go with their frame";
}

TEST_P(FarmRecords, AStageThatWasWholeIsNotRun) {
  const std::string job = begin(std::string(GetParam()) == "solo" ? 8 : 9);
  auto batches = go_on(job);
  EXPECT_EQ(batches["scatter"], 0);
  EXPECT_EQ(batches["gather"], 1);
}

TEST_P(FarmRecords, RecordsThatWereAlteredAreComputedAgain) {
  const std::string job = begin(3);
  ASSERT_EQ(files().size(), 1u);
  {
    std::fstream file(files()[0], std::ios::in | std::ios::out | std::ios::binary);
    file.seekp(256 * 8 + 100);
    file.put('#');
  }
  EXPECT_EQ(go_on(job)["scatter"], 6);
}

TEST_P(FarmRecords, RecordsThatAreGoneAreComputedAgain) {
  const std::string job = begin(3);
  std::filesystem::remove_all(folder_.path() / "records");
  EXPECT_EQ(go_on(job)["scatter"], 8);
}

TEST_P(FarmRecords, AFrameThatCannotBeRememberedIsRenderedAllTheSame) {
  std::ofstream(folder_.path() / "records") << "a file where the folder would be";
  const std::string job = begin(3);
  EXPECT_EQ(go_on(job)["scatter"], 8);
}

TEST_F(FarmJournal, ACancelledJobStaysCancelled) {
  std::string job;
  {
    Farm farm(journaled(), blobs_);
    job = farm.submit(request());
    farm.cancel(job);
  }
  Farm farm(journaled(), blobs_);
  EXPECT_EQ(farm.status(job)->state, JobState::cancelled);
}

TEST_F(FarmJournal, AJobWhoseSceneIsGoneFailsAlone) {
  std::string lost, whole;
  {
    Farm farm(journaled(), blobs_);
    lost = farm.submit(request());
    whole = farm.submit(request());
  }
  JobRequest other = request();
  BlobStore blobs;
  Farm farm(journaled(), blobs);
  EXPECT_EQ(farm.status(lost)->state, JobState::failed);
  EXPECT_THAT(farm.status(lost)->message, HasSubstr(other.scenes[0].scene_blob));
  EXPECT_TRUE(farm.list().size() == 2);
}

TEST_F(FarmJournal, AJobWhoseRecordCannotBeReadFailsAlone) {
  std::string good;
  {
    auto journal = open_sqlite_journal(folder_.path() / "journal.sqlite");
    journal->add({.id = "bad", .state = "queued", .message = {}, .request = bytes_of(std::vector<int>{-1, 7})}, {});
    const auto now = static_cast<double>(std::time(nullptr));
    journal->add({.id = "ended", .state = "done", .message = {}, .submitted = now, .ended = now, .request = {}}, {});
  }
  {
    Farm farm(journaled(), blobs_);
    EXPECT_EQ(farm.status("bad")->state, JobState::failed);
    EXPECT_THAT(farm.status("bad")->message, HasSubstr("cannot be read"));
    EXPECT_EQ(farm.status("ended")->state, JobState::done);
    good = farm.submit(request());
    ScriptedWorker worker;
    worker.join(farm);
    serve(farm, worker, good);
  }
  Farm farm(journaled(), blobs_);
  EXPECT_EQ(farm.status("bad")->state, JobState::failed);
  EXPECT_EQ(farm.status(good)->state, JobState::done);
}

TEST_F(FarmJournal, AJobThatCannotBeRememberedIsNotTaken) {
  FarmSettings farm_settings = journaled();
  struct Full final : Journal {
    std::string name() const override { return "full"; }
    std::uint64_t begin() override { return 1; }
    std::vector<JournalJob> jobs() override { return {}; }
    Bytes frames(const std::string&) override { return {}; }
    std::vector<JournalFrame> frames_over(const std::string&) override { return {}; }
    std::vector<JournalRange> ranges(const std::string&, std::uint64_t) override { return {}; }
    void add(const JournalJob&, const Bytes&) override { throw Error::failed("journal full: the disk is full"); }
    void write(const JournalChanges&) override {}
  };
  farm_settings.journal = std::make_shared<JournalWriter>(std::make_unique<Full>(), farm_settings.log);
  Farm farm(farm_settings, blobs_);
  EXPECT_THROW(farm.submit(request()), Error);
  EXPECT_THAT(farm.list(), IsEmpty());
}

TEST_F(FarmJournal, JobsBeyondTheBoundsAreForgottenThereToo) {
  FarmSettings farm_settings = journaled();
  farm_settings.ended_jobs = 1;
  std::string last;
  {
    Farm farm(farm_settings, blobs_);
    for (int i = 0; i < 3; ++i) {
      last = farm.submit(request());
      farm.cancel(last);
      end_of(farm, last);
    }
  }
  farm_settings.journal.reset();
  Farm farm(journaled(), blobs_);
  ASSERT_THAT(farm.list(), SizeIs(1));
  EXPECT_EQ(farm.list()[0].id, last);
}

TEST_F(FarmJournal, TheSameRequestIsOneJobAcrossARestart) {
  JobRequest named = request();
  named.request_id = "shot 7";
  std::string job;
  {
    Farm farm(journaled(), blobs_);
    job = farm.submit(named);
    EXPECT_EQ(farm.submit(named), job);
    EXPECT_NE(farm.submit(request()), job);
  }
  Farm farm(journaled(), blobs_);
  EXPECT_EQ(farm.submit(named), job);
  ScriptedWorker worker;
  worker.join(farm);
  serve(farm, worker, job);
  EXPECT_EQ(farm.submit(named), job) << "also where it has ended";
  EXPECT_THAT(farm.list(), SizeIs(2));
  named.settings.seed = 9;
  try {
    farm.submit(named);
    ADD_FAILURE() << "another request under the same id";
  } catch (const Error& error) {
    EXPECT_EQ(error.kind(), ErrorKind::usage);
    EXPECT_THAT(error.what(), testing::AllOf(HasSubstr("shot 7"), HasSubstr(job)));
  }
}

TEST_F(FarmJournal, APausedJobStaysPausedAndItsFramesAndCostsAreKnown) {
  std::string job, later;
  {
    Farm farm(journaled(), blobs_);
    ScriptedWorker worker;
    worker.join(farm);
    JobRequest listed = frames(1, 4);
    listed.numbers = {3, 4, 8, 20};
    listed.name = "night shot";
    listed.priority = 5;
    job = farm.submit(listed);
    JobRequest next = request();
    next.after = {job};
    later = farm.submit(next);
    serve_frames(farm, worker, 2);
    EXPECT_TRUE(farm.pause(job, true)->paused);
  }
  Farm farm(journaled(), blobs_);
  JobStatus status = *farm.status(job);
  EXPECT_TRUE(status.paused);
  EXPECT_EQ(status.state, JobState::queued);
  EXPECT_EQ(status.name, "night shot");
  EXPECT_EQ(status.priority, 5);
  EXPECT_EQ(status.frames_done, 2u);
  EXPECT_THAT(status.written, ElementsAre(std::pair(3u, 4u)));
  EXPECT_GT(status.worker_seconds, 0);
  EXPECT_GT(status.rays, 0u);
  EXPECT_THAT(farm.why(job)->front(), HasSubstr("gleaner resume " + job));
  EXPECT_THAT(farm.why(later)->front(), HasSubstr("until job " + job + " is done"));
  ScriptedWorker worker;
  worker.join(farm);
  EXPECT_FALSE(worker.next(0.1)) << "nothing of a paused job, nor of one that waits for it";
  farm.pause(job, false);
  serve(farm, worker, later);
  EXPECT_EQ(end_of(farm, job).state, JobState::done);
  EXPECT_THAT(farm.status(job)->written, ElementsAre(std::pair(3u, 4u), std::pair(8u, 8u), std::pair(20u, 20u)));
}

TEST_F(FarmJournal, CostsOfAFrameThatWasNotWrittenAreKnown) {
  std::atomic<double> time{0};
  std::string job;
  {
    FarmSettings farm_settings = journaled();
    farm_settings.clock = [&] { return time.load(); };
    farm_settings.silence = 1e9;
    Farm farm(farm_settings, blobs_);
    ScriptedWorker worker;
    worker.join(farm);
    job = farm.submit(request());
    auto offer = worker.next();
    ASSERT_TRUE(offer);
    worker.deliver(*offer, worker.compute(*offer, blobs_), 2.5);
    time = 100;
    ASSERT_TRUE(eventually(
        [&] { return farm_settings.journal->flush() && farm_settings.journal->jobs().at(0).worker_seconds > 0; }));
    // As if it were killed: nothing more is written that the next one reads.
  }
  Farm farm(journaled(), blobs_);
  EXPECT_EQ(farm.status(job)->worker_seconds, 2.5);
}

TEST_F(FarmJournal, FailedFramesAreRetriedAndTheOthersAreLeft) {
  FarmSettings farm_settings = journaled();
  const auto paths = farm_settings.paths;
  bool broken = true;
  farm_settings.paths = [&](const std::string& job, std::uint32_t frame) {
    FramePaths good = paths(job, frame);
    if (broken && frame == 2) good.exr = "/dev/null/no.exr";
    return good;
  };
  Farm farm(farm_settings, blobs_);
  ScriptedWorker worker;
  worker.join(farm);
  const std::string job = farm.submit(frames(1, 3));
  JobRequest next = request();
  next.after = {job};
  const std::string later = farm.submit(next);
  serve(farm, worker, job);
  ASSERT_EQ(end_of(farm, job).state, JobState::failed);
  EXPECT_EQ(farm.status(job)->frames_failed, 1u);
  EXPECT_THAT(farm.why(later)->front(), HasSubstr("gleaner retry " + job));
  const double cost = farm.status(job)->worker_seconds;
  broken = false;
  ASSERT_TRUE(farm.retry(job));
  EXPECT_EQ(farm.status(job)->frames_failed, 0u);
  EXPECT_EQ(farm.status(job)->frames_done, 2u);
  serve(farm, worker, later);
  EXPECT_EQ(end_of(farm, job).state, JobState::done) << end_of(farm, job).message;
  EXPECT_EQ(farm.totals().frames_written, 4u) << "frames that were written are not rendered again";
  EXPECT_GT(farm.status(job)->worker_seconds, cost);
  EXPECT_THROW(farm.retry(job), Error) << "it is done";
  EXPECT_FALSE(farm.retry("none"));
}

TEST(RequestCodec, EveryFieldComesBack) {
  JobRequest request;
  request.scene_name = "sc\xffne";
  request.camera_name = "left";
  request.settings = fake_settings(640, 480);
  request.settings.spp = 7;
  request.settings.depth = 3;
  request.settings.seed = ~std::uint64_t{0};
  request.settings.target_error = 0.1;
  request.settings.denoise = Denoise::fast;
  request.settings.set = {{"vpl.count", "12"}, {"odd\xfe", ""}};
  request.first_frame = 5;
  request.last_frame = 8;
  request.frame_step = 3;
  request.numbers = {5, 6, 9};
  request.name = "n\u00e4me";
  request.priority = -7;
  request.after = {"one", "two"};
  request.request_id = "again";
  request.content = "digest";
  request.exposure_stops = -1.25;
  request.time_limit = 1e-3;
  request.cameras = {request.settings.camera, request.settings.camera};
  request.cameras[1].origin[1] = std::nextafterf(1, 2);
  FrameScene scene{.scene_blob = std::string(64, 'a'), .bvh_blob = {}, .summary = {}, .state_blob = {}};
  scene.summary.needs.glossy = scene.summary.needs.iridescence = true;
  scene.summary.triangles = 1ull << 40;
  scene.summary.emissive_triangles = 2;
  scene.summary.lights = 3;
  scene.summary.bounds = {{-1, 0, 1}, {0.1f, 2, 3}};
  request.scenes = {scene, scene};
  request.scenes[1].state_blob = std::string(64, 'b');
  JobRequest back = decode_request(encode_request(request));
  decode_frames(encode_frames(request), back);
  EXPECT_EQ(encode_request(back), encode_request(request));
  EXPECT_EQ(encode_frames(back), encode_frames(request));
  EXPECT_EQ(back.scene_name, request.scene_name);
  EXPECT_EQ(back.camera_name, request.camera_name);
  EXPECT_EQ(back.settings.seed, request.settings.seed);
  EXPECT_EQ(back.settings.set, request.settings.set);
  EXPECT_EQ(back.settings.target_error, request.settings.target_error);
  EXPECT_EQ(back.settings.denoise, request.settings.denoise);
  EXPECT_EQ(back.settings.depth, 3u);
  EXPECT_EQ(back.settings.spp, 7u);
  EXPECT_EQ(back.time_limit, request.time_limit);
  EXPECT_EQ(back.exposure_stops, request.exposure_stops);
  EXPECT_EQ(back.last_frame, 8u);
  EXPECT_EQ(back.frame_step, 3u);
  EXPECT_EQ(back.numbers, request.numbers);
  EXPECT_EQ(back.name, request.name);
  EXPECT_EQ(back.priority, -7);
  EXPECT_EQ(back.after, request.after);
  EXPECT_EQ(back.request_id, "again");
  EXPECT_EQ(back.content, "digest");
  EXPECT_EQ(std::memcmp(back.cameras.data(), request.cameras.data(), 2 * sizeof(scene::Camera)), 0);
  EXPECT_EQ(back.scenes[1].summary.needs.bits(), scene.summary.needs.bits());
  EXPECT_EQ(back.scenes[1].summary.triangles, scene.summary.triangles);
  EXPECT_EQ(back.scenes[1].summary.bounds.upper, scene.summary.bounds.upper);
  EXPECT_EQ(back.scenes[1].scene_blob, scene.scene_blob);
  EXPECT_EQ(back.scenes[0].state_blob, "");
  EXPECT_EQ(back.scenes[1].state_blob, request.scenes[1].state_blob);
}

// A record of any length must be refused or read, never crash.
TEST(RequestCodec, DeepNestingIsRefused) {
  // Arrays of sixteen, each the first element of the one before.
  const Bytes bomb(100000, std::byte{0x90});
  EXPECT_THROW(decode_request(bomb), Error);
  JobRequest request;
  EXPECT_THROW(decode_frames(bomb, request), Error);
}

TEST(RequestCodec, TruncatedRecordsAreRefused) {
  JobRequest request;
  request.scenes.resize(1);
  const Bytes head = encode_request(request), frames = encode_frames(request);
  for (std::size_t size = 0; size < head.size(); ++size)
    EXPECT_THROW(decode_request(std::span(head).first(size)), Error) << size;
  for (std::size_t size = 0; size < frames.size(); ++size) {
    JobRequest back;
    EXPECT_THROW(decode_frames(std::span(frames).first(size), back), Error) << size;
  }
}

}  // namespace
}  // namespace gleaner::test

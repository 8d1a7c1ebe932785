// Workers that answer what they did not compute: they are found, put aside, and the picture is right.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstring>
#include <functional>
#include <limits>
#include <mutex>

#include "coordinator/journal/journal_writer.h"
#include "coordinator/journal/sqlite_journal.h"
#include "tests/farm/scripted_farm.h"

namespace gleaner::test {
namespace {

using testing::HasSubstr;
using testing::IsEmpty;

class Recheck : public FarmEngine {
 protected:
  FarmSettings checking(double share) {
    FarmSettings farm_settings = settings(64);  // "scatter" has 32 batches, "gather" 8
    farm_settings.recheck_share = share;
    farm_settings.log = [this](const std::string& line) {
      std::lock_guard lock(mutex_);
      log_ += line + "\n";
    };
    return farm_settings;
  }
  std::string log() {
    std::lock_guard lock(mutex_);
    return log_;
  }

  // Serves all of them until the job has ended; the first one tells `lie` of each batch that `lies` says.
  void serve_all(Farm& farm, const std::vector<ScriptedWorker*>& workers, const std::string& job,
                 const std::function<void(Bytes&)>& lie, const std::function<bool(const Offered&)>& lies) {
    while (!ended(farm.status(job)->state))
      for (ScriptedWorker* worker : workers)
        if (auto offer = worker->next(0.001)) {
          Bytes records = worker->compute(*offer, blobs_);
          if (worker == workers.front() && lies(*offer)) {
            lie(records);
            ++lies_told_;
          }
          worker->deliver(*offer, std::move(records));
        }
  }

  static std::string aside(Farm& farm, const std::string& name) {
    for (const WorkerStatus& worker : farm.workers())
      if (worker.id == name) return worker.aside;
    return "gone";
  }

  std::mutex mutex_;
  std::string log_;
  unsigned lies_told_ = 0;
};

void zeros(Bytes& records) { std::fill(records.begin(), records.end(), std::byte{0}); }
void one_bit(Bytes& records) { records[records.size() / 2] ^= std::byte{1}; }

class RecheckOf : public Recheck, public testing::WithParamInterface<const char*> {};
INSTANTIATE_TEST_SUITE_P(Gather, RecheckOf, testing::Values("", "stream"),
                         [](const auto& kind) { return *kind.param ? std::string(kind.param) : "collect"; });

TEST_P(RecheckOf, ALiarIsPutAsideAndThePictureIsRight) {
  for (const auto& lie : {zeros, one_bit}) {
    Farm farm(checking(0.02), blobs_);
    ScriptedWorker eve, ada, bob;
    eve.join(farm, "eve");
    ada.join(farm, "ada");
    bob.join(farm, "bob");
    JobRequest frame = request();
    if (*GetParam()) frame.settings.set[GetParam()] = "";
    const std::string job = farm.submit(frame);
    serve_all(farm, {&eve, &ada, &bob}, job, lie, [](const Offered&) { return true; });
    EXPECT_EQ(end_of(farm, job).state, JobState::done) << end_of(farm, job).message;
    EXPECT_EQ(report(farm, job)["pixels_sha256"], fake_pixels_sha256(fake_settings()));
    EXPECT_THAT(aside(farm, "eve"), HasSubstr("made other records than two others"));
    EXPECT_THAT(aside(farm, "ada"), IsEmpty());
    EXPECT_THAT(aside(farm, "bob"), IsEmpty());
    EXPECT_LE(lies_told_, 8u) << "found by its first batch";
    lies_told_ = 0;
    // It gets no more work.
    const std::string next = farm.submit(frame);
    serve_all(farm, {&eve, &ada, &bob}, next, lie, [](const Offered&) { return true; });
    EXPECT_EQ(lies_told_, 0u);
    EXPECT_THAT(farm.why(next), testing::Optional(IsEmpty()));
  }
}

TEST_F(Recheck, WhatOthersMadeIsTakenOver) {
  FarmSettings farm_settings = checking(1);
  farm_settings.journal =
      std::make_shared<JournalWriter>(open_sqlite_journal(folder_.path() / "journal.sqlite"), farm_settings.log);
  farm_settings.records = folder_.path() / "records";
  Farm farm(farm_settings, blobs_);
  ScriptedWorker eve, ada, bob;
  eve.join(farm, "eve");
  ada.join(farm, "ada");
  bob.join(farm, "bob");
  const std::string job = farm.submit(request());
  // An honest start, then a lie in the middle of the stage.
  serve_all(farm, {&eve, &ada, &bob}, job, one_bit,
            [](const Offered& offer) { return offer.work->stage == "scatter" && offer.lease.first >= 1024; });
  EXPECT_EQ(end_of(farm, job).state, JobState::done) << end_of(farm, job).message;
  EXPECT_EQ(report(farm, job)["pixels_sha256"], fake_pixels_sha256(fake_settings()));
  EXPECT_THAT(aside(farm, "eve"), HasSubstr("scatter"));
  std::uint64_t taken_over = 0;
  const auto written = report(farm, job);
  for (const auto& skip : written["skips"])
    if (skip["what"] == "stage scatter") taken_over += skip["count"].get<std::uint64_t>();
  EXPECT_GT(taken_over, 256u);
  EXPECT_LT(taken_over, 2048u);
}

TEST_F(Recheck, OneWordAgainstAnotherEndsTheJobWithBothNames) {
  Farm farm(checking(0.02), blobs_);
  ScriptedWorker eve, ada;
  eve.join(farm, "eve");
  ada.join(farm, "ada");
  const std::string job = farm.submit(request());
  serve_all(farm, {&eve, &ada}, job, zeros, [](const Offered&) { return true; });
  EXPECT_EQ(farm.status(job)->state, JobState::failed);
  EXPECT_THAT(farm.status(job)->message, HasSubstr("eve"));
  EXPECT_THAT(farm.status(job)->message, HasSubstr("ada"));
  EXPECT_THAT(farm.status(job)->message, HasSubstr("no third one"));
}

TEST_F(Recheck, OneThatIsAloneIsTrusted) {
  Farm farm(checking(1), blobs_);
  ScriptedWorker ada;
  ada.join(farm, "ada");
  const std::string job = farm.submit(request());
  serve(farm, ada, job);
  EXPECT_EQ(farm.status(job)->state, JobState::done);
  EXPECT_EQ(farm.totals().batches_rechecked, 0u);
}

TEST_F(Recheck, AWitnessThatLeavesHoldsNobodyUp) {
  Farm farm(checking(1), blobs_);
  ScriptedWorker ada;
  ada.join(farm, "ada");
  const std::string job = farm.submit(request());
  {
    ScriptedWorker mute;
    mute.join(farm, "mute");
    for (int i = 0; i < 40; ++i)
      if (auto offer = ada.next(0.01)) ada.deliver(*offer, ada.compute(*offer, blobs_));
    EXPECT_FALSE(ended(farm.status(job)->state)) << "batches wait to be compared";
  }
  serve(farm, ada, job);
  EXPECT_EQ(farm.status(job)->state, JobState::done) << farm.status(job)->message;
  EXPECT_EQ(report(farm, job)["pixels_sha256"], fake_pixels_sha256(fake_settings()));
}

// What was never going to be compared holds a frame for half a second, not for the time that a comparison may take.
TEST_F(Recheck, AWitnessThatNeverAnsweredIsHardlyWaitedFor) {
  Farm farm(checking(1), blobs_);
  ScriptedWorker ada, mute;
  ada.join(farm, "ada");
  mute.join(farm, "mute");
  const auto begun = std::chrono::steady_clock::now();
  const std::string job = farm.submit(request());
  serve(farm, ada, job);
  EXPECT_EQ(farm.status(job)->state, JobState::done) << farm.status(job)->message;
  EXPECT_THAT(log(), HasSubstr("does not answer"));
  EXPECT_LT(std::chrono::steady_clock::now() - begun, std::chrono::milliseconds(2800));
}

TEST_F(Recheck, HonestWorkersAgreeAndTheShareIsKept) {
  FarmSettings farm_settings = checking(0.25);
  Farm farm(farm_settings, blobs_);
  ScriptedWorker ada, bob;
  ada.join(farm, "ada");
  bob.join(farm, "bob");
  for (int i = 0; i < 5; ++i) {
    JobRequest frame = request();
    const std::string job = farm.submit(frame);
    serve_all(farm, {&ada, &bob}, job, zeros, [](const Offered&) { return false; });
    ASSERT_EQ(farm.status(job)->state, JobState::done) << farm.status(job)->message;
  }
  const auto totals = farm.totals();
  EXPECT_EQ(totals.liars_found, 0u);
  const double share = static_cast<double>(totals.batches_rechecked) / static_cast<double>(totals.batches_accepted);
  EXPECT_GT(share, 0.15);
  EXPECT_LT(share, 0.4);
}

class Insane : public Recheck, public testing::WithParamInterface<float> {};
INSTANTIATE_TEST_SUITE_P(Values, Insane,
                         testing::Values(std::numeric_limits<float>::quiet_NaN(),
                                         -std::numeric_limits<float>::infinity(), 3e38f));

TEST_P(Insane, NumbersThatNoLightHasAreRefusedOnArrival) {
  Farm farm(checking(0), blobs_);
  ScriptedWorker eve, ada;
  eve.join(farm, "eve");
  ada.join(farm, "ada");
  const std::string job = farm.submit(request());
  serve_all(
      farm, {&eve, &ada}, job, [](Bytes& records) { std::memcpy(records.data() + 8, &GetParam(), 4); },
      [](const Offered& offer) { return offer.work->stage == "gather"; });
  EXPECT_EQ(farm.status(job)->state, JobState::done) << farm.status(job)->message;
  EXPECT_EQ(report(farm, job)["pixels_sha256"], fake_pixels_sha256(fake_settings()));
  EXPECT_THAT(log(), HasSubstr("expected finite numbers"));
  EXPECT_THAT(log(), HasSubstr("worker eve"));
}

}  // namespace
}  // namespace gleaner::test

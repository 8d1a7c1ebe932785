// The farm's engine and outputs that stay with scripted workers: who is told to read what from whom, and what is
// computed again when somebody is lost. The workers' records are only digests here; agent_artifacts_test.cpp moves real
// ones.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <fstream>
#include <nlohmann/json.hpp>
#include <optional>
#include <random>

#include "coordinator/artifacts/artifact_id.h"
#include "coordinator/jobs/farm.h"
#include "proto/sha256.h"
#include "tests/farm/fake_chain.h"
#include "tests/farm/leased_worker.h"

namespace gleaner::test {
namespace {

using namespace coordinator;
using testing::Contains;
using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::Not;
using testing::SizeIs;

class HoldingWorker final : public LeasedWorker {
 public:
  ~HoldingWorker() override { leave(); }
  void join(Farm& farm, const std::string& wish, const std::string& device = "a script") {
    WorkerHello hello;
    hello.name = wish;
    hello.device.name = device;
    hello.token = token = "token of " + wish;
    hello.peer_address = wish + ":1";
    LeasedWorker::join(farm, hello);
  }

  void release(const std::vector<ArtifactId>& artifacts) override {
    std::lock_guard lock(mutex_);
    released_.insert(released_.end(), artifacts.begin(), artifacts.end());
  }
  void drop_part(const ArtifactId&, std::uint64_t first, const std::string&) override {
    std::lock_guard lock(mutex_);
    dropped_.push_back(first);
  }
  void send_part(std::uint64_t request, const PartRange&) override {
    std::lock_guard lock(mutex_);
    asked_.push_back(request);
  }

  static BatchOutput output_of(const Offered& offer, const FakeChain& chain) {
    const auto& [lease, work] = offer;
    Bytes image;
    if (work->kind == "fake-scatter") {
      image = bytes_of(std::vector<std::uint64_t>(chain.hashes.begin() + static_cast<long>(lease.first),
                                                  chain.hashes.begin() + static_cast<long>(lease.first + lease.count)));
    } else if (work->kind == "fake-spread") {
      image = chain.spread_image(lease.first, lease.count);
    } else {
      image = Bytes(chain.sums.begin() + static_cast<long>(lease.first * 4),
                    chain.sums.begin() + static_cast<long>((lease.first + lease.count) * 4));
    }
    BatchOutput output;
    if (work->output.placement == Placement::retain) {
      Sha256 hash;
      hash.update(image);
      const bool counted = work->output.counted;
      output.part = BatchOutput::Retained{.bytes = image.size(),
                                          .records = counted ? (image.size() - lease.count * 4) / 8 : lease.count,
                                          .digest = hash.raw(),
                                          .artifact = work->artifact,
                                          .items = {lease.first, lease.count}};
    } else {
      output.image = std::move(image);
    }
    return output;
  }
  Verdict deliver(const Offered& offer, BatchOutput output) {
    BatchCost cost;
    cost.seconds = 0.01;
    return farm_->result(id, offer.lease.id, offer.lease.epoch, std::move(output), cost);
  }
  // The next lease, done as it should be. Which stage it was of; empty: there was none.
  std::string work(const FakeChain& chain, double seconds = 5) {
    auto offer = next(seconds);
    if (!offer) return "";
    deliver(*offer, output_of(*offer, chain));
    return offer->work->stage;
  }

  std::vector<ArtifactId> released() {
    std::lock_guard lock(mutex_);
    return released_;
  }
  std::vector<std::uint64_t> dropped() {
    std::lock_guard lock(mutex_);
    return dropped_;
  }
  std::vector<std::uint64_t> asked() {
    std::lock_guard lock(mutex_);
    return asked_;
  }

  std::string token;

 private:
  std::vector<ArtifactId> released_;
  std::vector<std::uint64_t> dropped_, asked_;
};

class FarmRetained : public testing::Test {
 protected:
  FarmRetained() {
    settings_.plan = make_fake_chain;
    settings_.scheduler.fixed_batch_items = 512;
    settings_.scheduler.in_flight = 1;
    settings_.scheduler.lease_floor = 1000;
    settings_.paths = [this](const std::string& job, std::uint32_t frame) {
      std::string stem = (folder_.path() / job / std::string("frame").append(std::to_string(frame))).string();
      return FramePaths{stem + ".exr", {}, stem + ".json"};
    };
    settings_.log = [this](const std::string& line) {
      std::lock_guard lock(log_mutex_);
      log_ += line + "\n";
    };
  }

  JobRequest request(std::map<std::string, std::string> set = {}) {
    JobRequest job;
    job.scene_name = "fake.glb";
    job.scenes = {{blobs_.put(bytes_of(std::vector<int>{1, 2, 3})), {}, {}, {}}};
    job.settings = frame_;
    job.settings.set = std::move(set);
    return job;
  }

  static JobStatus end_of(Farm& farm, const std::string& job) {
    EXPECT_TRUE(eventually([&] { return ended(farm.status(job)->state); }));
    return *farm.status(job);
  }
  nlohmann::json report(Farm& farm, const std::string& job) {
    for (const auto& path : farm.files(job))
      if (path.extension() == ".json") {
        std::ifstream file(path);
        return nlohmann::json::parse(file);
      }
    ADD_FAILURE() << "no report";
    return {};
  }
  void expect_right(Farm& farm, const std::string& job) {
    const JobStatus status = end_of(farm, job);
    ASSERT_EQ(status.state, JobState::done) << status.message << "\n" << log();
    EXPECT_EQ(report(farm, job)["pixels_sha256"], chain_.pixels_sha256(frame_.width, frame_.height));
  }
  // Serves all of them in turn until the job has ended.
  void serve(Farm& farm, const std::vector<HoldingWorker*>& workers, const std::string& job) {
    for (int idle = 0; !ended(farm.status(job)->state) && idle < 500;) {
      bool worked = false;
      for (HoldingWorker* worker : workers) worked = !worker->work(chain_, 0.002).empty() || worked;
      idle = worked ? 0 : idle + 1;
    }
  }
  // Serves one of them until it has done so many batches of the stage; false: that does not happen.
  bool serve(HoldingWorker& worker, const std::string& stage, int batches) {
    for (int i = 0; i < 100 && batches > 0; ++i) {
      const std::string of = worker.work(chain_, 1);
      batches -= of == stage;
    }
    return batches == 0;
  }
  std::string log() {
    std::lock_guard lock(log_mutex_);
    return log_;
  }

  const FrameSettings frame_ = fake_settings(32, 16);  // 2048 items: 4 batches of "hashes" and of "spread", 1 of "sums"
  const FakeChain chain_{frame_};
  FarmSettings settings_;
  TemporaryFolder folder_;
  BlobStore blobs_;
  std::mutex log_mutex_;
  std::string log_;
};

TEST_F(FarmRetained, RecordsStayWithTheirWorkersAndReadersAreToldWhere) {
  Farm farm(settings_, blobs_);
  HoldingWorker ada, bob;
  ada.join(farm, "ada");
  bob.join(farm, "bob");
  const std::string job = farm.submit(request());
  EXPECT_EQ(ada.work(chain_), "hashes");
  EXPECT_EQ(bob.work(chain_), "hashes");
  EXPECT_EQ(bob.work(chain_), "hashes");
  EXPECT_EQ(ada.work(chain_), "hashes");
  // Each is given the items whose hashes it holds.
  auto of_ada = ada.next(), of_bob = bob.next();
  ASSERT_TRUE(of_ada && of_bob);
  EXPECT_EQ(of_ada->work->stage, "spread");
  EXPECT_EQ(of_ada->lease.first, 0u);
  EXPECT_EQ(of_bob->lease.first, 1024u);
  const StageWork::Input& input = of_ada->work->inputs.at(0);
  EXPECT_EQ(input.data, nullptr);
  EXPECT_TRUE(input.own_items);
  EXPECT_EQ(input.record_bytes, 8u);
  EXPECT_EQ(input.items, 2048u);
  const Farm::Located own = farm.locate(ada.token, of_ada->lease.epoch, input.blob);
  ASSERT_EQ(own.answer, Farm::Located::here);
  ASSERT_THAT(own.parts, SizeIs(1)) << "of its own items alone";
  EXPECT_TRUE(own.parts[0].own);
  ada.deliver(*of_ada, HoldingWorker::output_of(*of_ada, chain_));
  bob.deliver(*of_bob, HoldingWorker::output_of(*of_bob, chain_));
  EXPECT_EQ(bob.work(chain_), "spread");
  EXPECT_EQ(ada.work(chain_), "spread");
  std::optional<Offered> sums;
  HoldingWorker* reader = nullptr;
  for (HoldingWorker* worker : {&ada, &bob})
    if (!sums && (sums = worker->next(1))) reader = worker;
  ASSERT_TRUE(sums);
  const StageWork::Input& spread = sums->work->inputs.at(0);
  EXPECT_TRUE(spread.counted);
  EXPECT_EQ(sums->work->inputs.at(1).record_bytes, 4u) << "the plan's own numbers, one a pixel";
  const Farm::Located all = farm.locate(reader->token, sums->lease.epoch, spread.blob);
  ASSERT_EQ(all.answer, Farm::Located::here);
  ASSERT_THAT(all.parts, SizeIs(4));
  std::uint64_t items = 0, records = 0;
  for (const auto& at : all.parts) {
    EXPECT_EQ(at.part.items.first, items);
    EXPECT_EQ(at.part.records_before, records);
    EXPECT_EQ(at.part.records, chain_.offsets[items + at.part.items.count] - chain_.offsets[items]);
    items += at.part.items.count;
    records += at.part.records;
    EXPECT_EQ(at.own, at.holders.empty());
    if (at.own) continue;
    const HoldingWorker& other = reader == &ada ? bob : ada;
    EXPECT_EQ(at.holders[0].worker, other.name);
    EXPECT_EQ(at.holders[0].address, other.name + ":1");
    EXPECT_EQ(at.holders[0].ticket, artifact_ticket(other.token, spread.blob));
  }
  EXPECT_EQ(items, 2048u);
  EXPECT_EQ(records, chain_.offsets.back());
  reader->deliver(*sums, HoldingWorker::output_of(*sums, chain_));
  expect_right(farm, job);
  EXPECT_EQ(report(farm, job)["bytes"]["downloaded"], 32 * 16 * 4) << "the pixels alone";
  for (HoldingWorker* worker : {&ada, &bob})
    EXPECT_TRUE(eventually([&] { return worker->released().size() == 2; })) << "both artifacts are dropped";
}

TEST_F(FarmRetained, CollectedCountedRecordsComeWithTheirCounts) {
  settings_.scheduler.strikes = 100;
  Farm farm(settings_, blobs_);
  HoldingWorker ada;
  ada.join(farm, "ada");
  const std::string job = farm.submit(request({{"place", "collect"}}));
  EXPECT_TRUE(serve(ada, "hashes", 4));
  auto offer = ada.next();
  ASSERT_TRUE(offer);
  ASSERT_EQ(offer->work->stage, "spread");
  EXPECT_EQ(farm.expected_bytes(ada.id, offer->lease.id, offer->lease.epoch), 512 * (4 + 3 * 8));
  const BatchOutput right = HoldingWorker::output_of(*offer, chain_);
  struct {
    const char* what;
    std::function<void(Bytes&)> change;
  } const attacks[] = {
      {"no counts", [](Bytes& image) { image.resize(512 * 4 - 1); }},
      {"a count that is too large", [](Bytes& image) { image[4] = std::byte{4}; }},
      {"a count that overflows", [](Bytes& image) { image[7] = std::byte{0xff}; }},
      {"a record less than counted", [](Bytes& image) { image.resize(image.size() - 8); }},
      {"a byte more than counted", [](Bytes& image) { image.push_back(std::byte{1}); }},
  };
  // A worker that errs is quarantined after three failures: each comes from a worker of its own.
  for (const auto& [what, change] : attacks) {
    BatchOutput wrong = right;
    change(wrong.image);
    EXPECT_EQ(ada.deliver(*offer, wrong), Verdict::stale) << what;
    EXPECT_THAT(farm.why(job)->back(), HasSubstr("sent")) << what;
    ada.leave();
    ada.join(farm, what);
    offer = ada.next();
    ASSERT_TRUE(offer) << what << log();
  }
  ada.deliver(*offer, HoldingWorker::output_of(*offer, chain_));
  serve(farm, {&ada}, job);
  expect_right(farm, job);
}

TEST_F(FarmRetained, WhatALostWorkerHeldIsComputedAgainBeforeItIsRead) {
  Farm farm(settings_, blobs_);
  HoldingWorker ada, bob;
  ada.join(farm, "ada");
  bob.join(farm, "bob");
  const std::string job = farm.submit(request());
  EXPECT_EQ(ada.work(chain_), "hashes");  // 0 to 511
  EXPECT_TRUE(serve(bob, "hashes", 3));
  auto reading = bob.next();
  ASSERT_TRUE(reading);
  ASSERT_EQ(reading->work->stage, "spread");
  ada.leave();
  EXPECT_EQ(farm.locate(bob.token, reading->lease.epoch, reading->work->inputs.at(0).blob).answer, Farm::Located::here)
      << "its own items are not those that were lost";
  // It could not fetch them: nobody's fault.
  farm.failed(bob.id, reading->lease.id, reading->lease.epoch, "no holder could be read", true);
  auto again = bob.next();
  ASSERT_TRUE(again);
  EXPECT_EQ(again->work->stage, "hashes") << "not the stage that reads: " << again->work->stage;
  EXPECT_EQ(again->lease.first, 0u);
  EXPECT_EQ(again->lease.count, 512u);
  EXPECT_THAT(*farm.why(job), Contains(HasSubstr("computed again")));
  bob.deliver(*again, HoldingWorker::output_of(*again, chain_));
  serve(farm, {&bob}, job);
  expect_right(farm, job);
  std::map<std::string, int> items;
  const auto json = report(farm, job);
  for (const auto& stage : json["stages"]) items[stage["name"]] += stage["items"].get<int>();
  EXPECT_EQ(items,
            (std::map<std::string, int>{{"hashes", 2048}, {"hashes (again)", 512}, {"spread", 2048}, {"sums", 512}}));
}

TEST_F(FarmRetained, ALossWhileTheStageStillRunsIsMadeGoodToo) {
  Farm farm(settings_, blobs_);
  HoldingWorker ada, bob;
  ada.join(farm, "ada");
  bob.join(farm, "bob");
  const std::string job = farm.submit(request());
  EXPECT_EQ(ada.work(chain_), "hashes");
  auto running = ada.next();
  ASSERT_TRUE(running);
  ada.leave();  // a part, and a lease
  serve(farm, {&bob}, job);
  expect_right(farm, job);
  std::map<std::string, int> items;
  const auto json = report(farm, job);
  for (const auto& stage : json["stages"]) items[stage["name"]] += stage["items"].get<int>();
  EXPECT_EQ(items["hashes (again)"], 512);
}

TEST_F(FarmRetained, WhatWasReleasedIsComputedAgainWhereSomethingMadeOfItIsLost) {
  Farm farm(settings_, blobs_);
  HoldingWorker ada, bob;
  ada.join(farm, "ada");
  bob.join(farm, "bob");
  const std::string job = farm.submit(request());
  EXPECT_EQ(ada.work(chain_), "hashes");
  EXPECT_TRUE(serve(bob, "hashes", 3));
  EXPECT_EQ(ada.work(chain_), "spread");  // 0 to 511
  EXPECT_TRUE(serve(bob, "spread", 3));
  ASSERT_TRUE(eventually([&] { return bob.released().size() == 1; })) << "nothing else reads the hashes";
  ada.leave();
  // "spread" 0 to 511 reads the hashes of just these items.
  std::vector<std::string> stages;
  for (int i = 0; i < 3; ++i) {
    auto offer = bob.next(2);
    if (!offer) break;
    stages.push_back(offer->work->stage);
    if (offer->work->stage == "sums") {
      farm.failed(bob.id, offer->lease.id, offer->lease.epoch, "no holder could be read", true);
      --i;
      ASSERT_LT(stages.size(), 6u);
      continue;
    }
    EXPECT_EQ(offer->lease.first, 0u);
    EXPECT_EQ(offer->lease.count, 512u);
    bob.deliver(*offer, HoldingWorker::output_of(*offer, chain_));
    if (offer->work->stage == "spread") break;
  }
  std::erase(stages, "sums");
  EXPECT_THAT(stages, ElementsAre("hashes", "spread"));
  EXPECT_TRUE(eventually([&] { return bob.released().size() == 2; })) << "the hashes go again";
  serve(farm, {&bob}, job);
  expect_right(farm, job);
}

TEST_F(FarmRetained, ALossWhileSomethingIsComputedAgainIsMadeGoodToo) {
  Farm farm(settings_, blobs_);
  HoldingWorker ada, bob, eve;
  for (auto& [worker, name] : {std::pair(&ada, "ada"), {&bob, "bob"}, {&eve, "eve"}}) worker->join(farm, name);
  const std::string job = farm.submit(request());
  for (HoldingWorker* worker : {&ada, &ada, &bob, &eve}) EXPECT_EQ(worker->work(chain_), "hashes");
  auto reading = eve.next();
  ASSERT_TRUE(reading);
  ada.leave();
  farm.failed(eve.id, reading->lease.id, reading->lease.epoch, "no holder could be read", true);
  auto again = eve.next();
  ASSERT_TRUE(again);
  EXPECT_EQ(again->work->stage, "hashes");
  eve.deliver(*again, HoldingWorker::output_of(*again, chain_));
  eve.leave();  // with what it computed again
  serve(farm, {&bob}, job);
  expect_right(farm, job);
}

TEST_F(FarmRetained, RecordsThatDifferWhenComputedAgainAreDecidedByAThirdWorker) {
  for (const bool first_lied : {false, true}) {
    Farm farm(settings_, blobs_);
    HoldingWorker ada, bob, eve;
    for (auto& [worker, name] : {std::pair(&ada, "ada"), {&bob, "bob"}, {&eve, "eve"}}) worker->join(farm, name);
    const std::string job = farm.submit(request());
    auto offer = ada.next();
    BatchOutput lie = HoldingWorker::output_of(*offer, chain_);
    lie.part->digest[5] ^= 1;
    ada.deliver(*offer, first_lied ? lie : HoldingWorker::output_of(*offer, chain_));
    serve(bob, "hashes", 3);
    ada.leave();
    auto again = bob.next();
    ASSERT_TRUE(again);
    while (again->work->stage == "spread") {
      farm.failed(bob.id, again->lease.id, again->lease.epoch, "not there", true);
      again = bob.next();
      ASSERT_TRUE(again);
    }
    BatchOutput second = HoldingWorker::output_of(*again, chain_);
    if (!first_lied) second.part->digest[7] ^= 1;
    bob.deliver(*again, second);
    EXPECT_THAT(log(), HasSubstr("workers ada, bob made different records; none counts"));
    EXPECT_THAT(bob.dropped(), Contains(again->lease.first));
    serve(farm, {&eve, &bob}, job);
    expect_right(farm, job);
    EXPECT_THAT(log(), HasSubstr(std::string("worker ") + (first_lied ? "ada" : "bob") + " is quarantined"));
    const auto workers = farm.workers();
    const auto status =
        std::find_if(workers.begin(), workers.end(), [](const auto& worker) { return worker.id == "bob"; });
    ASSERT_NE(status, workers.end()) << "it stays connected";
    EXPECT_EQ(status->aside.empty(), first_lied);
    // Nothing that the liar made counts, nor what was made of it: the frame begins again, without the liar.
    EXPECT_THAT(log(), HasSubstr("the frame begins again"));
    std::lock_guard lock(log_mutex_);
    log_.clear();
  }
}

// Lies that nobody would meet by chance: what is kept is never computed twice, but for the share that is compared.
struct RetainedLie {
  const char* stage;  // that the liar lies in
  const char* spread;
};
class FarmRetainedLiar : public FarmRetained, public testing::WithParamInterface<RetainedLie> {};
INSTANTIATE_TEST_SUITE_P(Stage, FarmRetainedLiar,
                         testing::Values(RetainedLie{"hashes", ""}, RetainedLie{"spread", ""},
                                         RetainedLie{"spread", "solo"}),
                         [](const auto& lie) { return std::string(lie.param.stage) + lie.param.spread; });

TEST_P(FarmRetainedLiar, IsFoundByComparingAndWhatRestsOnItIsComputedAgain) {
  settings_.scheduler.fixed_batch_items = 64;
  settings_.recheck_share = *GetParam().spread ? 1 : 0.02;  // a solo stage is compared by chance alone
  Farm farm(settings_, blobs_);
  HoldingWorker eve, ada, bob;
  for (auto& [worker, name] : {std::pair(&eve, "eve"), {&ada, "ada"}, {&bob, "bob"}}) worker->join(farm, name);
  std::map<std::string, std::string> set = {{"spread", GetParam().spread}};
  if (!*GetParam().spread) set.clear();
  const std::string job = farm.submit(request(set));
  int lies = 0;
  for (int idle = 0; !ended(farm.status(job)->state) && idle < 1000; ++idle)
    for (HoldingWorker* worker : {&eve, &ada, &bob}) {
      auto offer = worker->next(0.002);
      if (!offer) continue;
      idle = 0;
      BatchOutput output = HoldingWorker::output_of(*offer, chain_);
      if (worker == &eve &&
          offer->work->kind ==
              std::string("fake-") + (GetParam().stage == std::string("hashes") ? "scatter" : "spread")) {
        output.part->digest[3] ^= 1;
        ++lies;
      }
      worker->deliver(*offer, std::move(output));
    }
  expect_right(farm, job);
  if (lies == 0) GTEST_SKIP() << "the liar was never asked";
  EXPECT_EQ(farm.totals().liars_found, 1u) << log();
  EXPECT_THAT(log(), HasSubstr("worker eve is quarantined"));
  EXPECT_LE(lies, 12) << "found by its first batch, of 32";
  for (const WorkerStatus& worker : farm.workers()) EXPECT_EQ(worker.aside.empty(), worker.id != "eve");
}

TEST_F(FarmRetained, HonestCopiesThatWereComparedMayBeRead) {
  settings_.recheck_share = 1;
  Farm farm(settings_, blobs_);
  HoldingWorker ada, bob;
  ada.join(farm, "ada");
  bob.join(farm, "bob");
  const std::string job = farm.submit(request());
  serve(farm, {&ada, &bob}, job);
  expect_right(farm, job);
  const FarmTotals totals = farm.totals();
  EXPECT_EQ(totals.batches_rechecked, totals.batches_accepted) << "of 9 batches all";
  EXPECT_EQ(totals.liars_found, 0u);
  EXPECT_THAT(ada.dropped(), IsEmpty());
  EXPECT_THAT(bob.dropped(), IsEmpty());
  // Both hold all of both artifacts, and are told to drop them.
  for (HoldingWorker* worker : {&ada, &bob}) EXPECT_TRUE(eventually([&] { return worker->released().size() == 2; }));
}

TEST_F(FarmRetained, WhereNobodyDecidesBetweenTwoTheJobEndsWithTheirNames) {
  Farm farm(settings_, blobs_);
  HoldingWorker ada, bob;
  ada.join(farm, "ada");
  bob.join(farm, "bob");
  const std::string job = farm.submit(request());
  EXPECT_EQ(ada.work(chain_), "hashes");
  EXPECT_TRUE(serve(bob, "hashes", 3));
  ada.leave();
  int answers = 0;
  for (; !ended(farm.status(job)->state) && answers < 100; ++answers) {
    auto offer = bob.next(1);
    if (!offer) break;
    if (offer->work->stage != "hashes") {
      farm.failed(bob.id, offer->lease.id, offer->lease.epoch, "no holder could be read", true);
      continue;
    }
    BatchOutput output = HoldingWorker::output_of(*offer, chain_);
    output.part->digest[5] ^= 1;
    bob.deliver(*offer, output);
  }
  const JobStatus status = end_of(farm, job);
  EXPECT_EQ(status.state, JobState::failed);
  EXPECT_LT(answers, 20);
  EXPECT_THAT(status.message, HasSubstr("the records differ each time they are computed (workers ada, bob)"));
}

TEST_F(FarmRetained, DevicesOfOtherKindsAreNotHeldToEachOthersBits) {
  Farm farm(settings_, blobs_);
  HoldingWorker ada, bob;
  ada.join(farm, "ada", "a GPU");
  bob.join(farm, "bob", "a CPU");
  const std::string job = farm.submit(request());
  auto offer = ada.next();
  BatchOutput rounded = HoldingWorker::output_of(*offer, chain_);
  rounded.part->digest[5] ^= 1;
  ada.deliver(*offer, rounded);
  serve(bob, "hashes", 3);
  ada.leave();
  serve(farm, {&bob}, job);
  expect_right(farm, job);
  EXPECT_THAT(log(), Not(HasSubstr("different records")));
}

TEST_F(FarmRetained, AHolderThatSendsOtherBytesLosesItsCopy) {
  Farm farm(settings_, blobs_);
  HoldingWorker ada, bob;
  ada.join(farm, "ada");
  bob.join(farm, "bob");
  const std::string job = farm.submit(request({{"spread", "solo"}}));
  serve(ada, "hashes", 1);
  serve(bob, "hashes", 3);
  auto reading = bob.next();
  ASSERT_TRUE(reading);
  ASSERT_EQ(reading->work->stage, "spread");
  const ArtifactId hashes = reading->work->inputs.at(0).blob;
  const auto located = farm.locate(bob.token, reading->lease.epoch, hashes);
  ASSERT_EQ(located.answer, Farm::Located::here);
  const auto bad = std::ranges::find_if(located.parts, [](const auto& at) { return !at.own; });
  ASSERT_NE(bad, located.parts.end());
  // Words that name nothing change nothing.
  farm.wrong_part(bob.id, hashes, bad->part.items.first, std::string(32, '?'), "ada");
  farm.wrong_part(bob.id, hashes, bad->part.items.first + 1, bad->part.digest, "ada");
  farm.wrong_part(bob.id, hashes, bad->part.items.first, bad->part.digest, "nobody");
  farm.wrong_part(bob.id, ArtifactId(64, 'f'), bad->part.items.first, bad->part.digest, "ada");
  farm.wrong_part(999, hashes, bad->part.items.first, bad->part.digest, "ada");
  EXPECT_EQ(farm.locate(bob.token, reading->lease.epoch, hashes).answer, Farm::Located::here);
  farm.wrong_part(bob.id, hashes, bad->part.items.first, bad->part.digest, "ada");
  EXPECT_EQ(farm.locate(bob.token, reading->lease.epoch, hashes).answer, Farm::Located::unavailable);
  EXPECT_THAT(ada.dropped(), ElementsAre(bad->part.items.first));
  farm.failed(bob.id, reading->lease.id, reading->lease.epoch, "no holder could be read", true);
  serve(farm, {&ada, &bob}, job);
  expect_right(farm, job);
}

TEST_F(FarmRetained, OnlyWhoHasALeaseThatReadsAnArtifactIsToldOfIt) {
  Farm farm(settings_, blobs_);
  HoldingWorker ada, bob;
  ada.join(farm, "ada");
  bob.join(farm, "bob");
  const std::string job = farm.submit(request());
  serve(ada, "hashes", 2);
  serve(bob, "hashes", 2);
  auto of_ada = ada.next(), of_bob = bob.next();
  ASSERT_TRUE(of_ada && of_bob);
  const ArtifactId hashes = of_ada->work->inputs.at(0).blob;
  const Epoch epoch = of_ada->lease.epoch;
  EXPECT_EQ(farm.locate(ada.token, epoch, hashes).answer, Farm::Located::here);
  struct {
    const char* what;
    std::string token;
    Epoch epoch;
    ArtifactId artifact;
  } const attacks[] = {
      {"no token", "", epoch, hashes},
      {"a token of nobody", "token", epoch, hashes},
      {"another worker's lease", bob.token, epoch, hashes},
      {"no lease", ada.token, epoch + 1000, hashes},
      {"an artifact that it does not read", ada.token, epoch, of_ada->work->artifact},
      {"an artifact that nobody knows", ada.token, epoch, ArtifactId(64, 'f')},
  };
  for (const auto& [what, token, of, artifact] : attacks) {
    EXPECT_EQ(farm.locate(token, of, artifact).answer, Farm::Located::refused) << what;
    EXPECT_EQ(farm.relay_source(token, of, "bob", {.artifact = artifact, .first = 0, .digest = {}}).answer,
              Farm::Located::refused)
        << what;
  }
  const auto parts = farm.locate(bob.token, of_bob->lease.epoch, hashes).parts;
  ASSERT_THAT(parts, SizeIs(1));
  PartRange range{.artifact = hashes, .first = parts[0].part.items.first, .digest = parts[0].part.digest};
  EXPECT_EQ(farm.relay_source(ada.token, epoch, "bob", range).answer, Farm::Located::here);
  EXPECT_EQ(farm.relay_source(ada.token, epoch, "bob", range).holder, bob.id);
  EXPECT_EQ(farm.relay_source(ada.token, epoch, "ada", range).answer, Farm::Located::unavailable) << "not its holder";
  range.digest[0] ^= 1;
  EXPECT_EQ(farm.relay_source(ada.token, epoch, "bob", range).answer, Farm::Located::unavailable) << "another version";
  EXPECT_TRUE(farm.ask_for_part(bob.id, 7, range));
  EXPECT_THAT(bob.asked(), ElementsAre(7));
  EXPECT_FALSE(farm.ask_for_part(999, 7, range));
  ada.deliver(*of_ada, HoldingWorker::output_of(*of_ada, chain_));
  EXPECT_EQ(farm.locate(ada.token, epoch, hashes).answer, Farm::Located::refused) << "its lease is over";
  bob.leave();
  EXPECT_FALSE(farm.worker_of(bob.token));
}

TEST_F(FarmRetained, PartsThatTheirItemsCannotHaveAreFailures) {
  Farm farm(settings_, blobs_);
  HoldingWorker ada;
  ada.join(farm, "ada");
  const std::string job = farm.submit(request());
  auto offer = ada.next();
  BatchOutput records;
  records.image = Bytes(512 * 8);
  EXPECT_EQ(ada.deliver(*offer, records), Verdict::stale);
  EXPECT_THAT(farm.why(job)->back(), HasSubstr("which it was to keep"));
  offer = ada.next();
  BatchOutput wrong = HoldingWorker::output_of(*offer, chain_);
  wrong.part->bytes += 8;
  EXPECT_EQ(ada.deliver(*offer, wrong), Verdict::stale);
  EXPECT_THAT(farm.why(job)->back(), HasSubstr("a shape that its items cannot have"));
}

TEST_F(FarmRetained, InputsThatCannotBeFetchedAreNobodysFaultUnlessThatLasts) {
  std::atomic<double> time{0};
  settings_.clock = [&time] { return time.load(); };
  settings_.silence = 1000;
  settings_.scheduler.lease_floor = 100000;
  Farm farm(settings_, blobs_);
  HoldingWorker ada;
  ada.join(farm, "ada");
  const std::string job = farm.submit(request());
  const auto fail = [&] {
    auto offer = ada.next(1);
    if (!offer) return false;
    farm.failed(ada.id, offer->lease.id, offer->lease.epoch, "no holder could be read", true);
    return true;
  };
  for (const double now : {0.0, 1.0, 2.0, 3.0, 900.0, 1059.0}) {
    time = now;
    ASSERT_TRUE(fail()) << now;
    EXPECT_EQ(farm.status(job)->state, JobState::running) << now;
  }
  time = 1061;  // a minute after whoever held them must have been found to be lost
  for (unsigned strike = 0; strike < settings_.scheduler.strikes; ++strike) ASSERT_TRUE(fail());
  const JobStatus status = end_of(farm, job);
  EXPECT_EQ(status.state, JobState::failed);
  EXPECT_THAT(status.message, HasSubstr("no holder could be read"));
}

// One stage as the test wants it.
class OneStagePlan final : public Plan {
 public:
  explicit OneStagePlan(Step step) : step_(std::move(step)) {}
  Step next(const FinishedStage* finished) override {
    Step step = step_;
    step.done = finished != nullptr;
    return step;
  }
  void preview(const std::string&, std::uint64_t, std::uint64_t, const Bytes&) override {}
  Film preview_film(bool) const override { return {}; }
  Film film() const override { return {}; }
  std::vector<Skip> skips() const override { return {}; }
  std::string parameters_json() const override { return "{}"; }
  std::vector<std::string> outline() const override { return {}; }

 private:
  Step step_;
};

TEST_F(FarmRetained, AStageThatTheFarmCannotTakeIsRefusedWithItsName) {
  Step step;
  const auto data = std::make_shared<Bytes>(40);
  const ArtifactId numbers = data_id(*data);
  struct {
    const char* says;
    StageOutput output;
    std::vector<StageInput> inputs;
  } const cases[] = {
      {"records of no bytes", {.record_bytes = 0}, {}},
      {"records of no bytes", {.record_bytes = 8, .counted = true, .most_records = 0}, {}},
      {"counted records cannot be streamed", {.record_bytes = 8, .counted = true, .placement = Placement::stream}, {}},
      {"records that nobody keeps are not reusable",
       {.record_bytes = 8, .placement = Placement::stream, .reusable = true},
       {}},
      {"are more than this coordinator takes", {.record_bytes = 1 << 30}, {}},
      {"names an artifact that the plan never gave", {.record_bytes = 8}, {{"numbers", ArtifactId(64, 'f')}}},
      {"has 0 items, expected its own 100", {.record_bytes = 8}, {{"numbers", numbers, Extent::own_items}}},
  };
  for (const auto& c : cases) {
    StageSpec stage;
    stage.name = "odd";
    stage.kind = "fake-odd";
    stage.items = 100;
    stage.output = c.output;
    stage.inputs = c.inputs;
    step.stages = {stage};
    step.artifacts = {{numbers, data}};
    settings_.plan = [&](const FrameSettings&, const SceneSummary&) { return std::make_unique<OneStagePlan>(step); };
    Farm farm(settings_, blobs_);
    const JobStatus status = end_of(farm, farm.submit(request()));
    EXPECT_EQ(status.state, JobState::failed) << c.says;
    EXPECT_THAT(status.message, HasSubstr("stage odd: ")) << c.says;
    EXPECT_THAT(status.message, HasSubstr(c.says));
  }
}

TEST_F(FarmRetained, AnotherFrameReadsWhatIsReusable) {
  settings_.active_jobs = 1;
  Farm farm(settings_, blobs_);
  HoldingWorker ada, bob;
  ada.join(farm, "ada");
  bob.join(farm, "bob");
  const std::string first = farm.submit(request({{"reusable", "1"}}));
  serve(farm, {&ada, &bob}, first);
  expect_right(farm, first);
  EXPECT_THAT(ada.released(), IsEmpty());
  const std::string second = farm.submit(request({{"reusable", "1"}}));
  serve(farm, {&ada, &bob}, second);
  expect_right(farm, second);
  EXPECT_THAT(report(farm, second)["stages"], SizeIs(1)) << "the sums alone";
  EXPECT_THAT(report(farm, second)["skips"], SizeIs(2));
  // A lost part of what nobody needs at the moment is not computed again; who needs it next has all of it made.
  ada.leave();
  EXPECT_FALSE(bob.next(0.1));
  const std::string third = farm.submit(request({{"reusable", "1"}}));
  serve(farm, {&bob}, third);
  expect_right(farm, third);
}

// Two frames that ask for the same at the same time; the second one's job may lose the first one's.
class FarmFollowers : public FarmRetained, public testing::WithParamInterface<const char*> {};
INSTANTIATE_TEST_SUITE_P(Places, FarmFollowers, testing::Values("collect", "retain"),
                         [](const auto& place) { return std::string(place.param); });

TEST_P(FarmFollowers, WhatTwoFramesAskForIsMadeOnce) {
  Farm farm(settings_, blobs_);
  HoldingWorker worker;
  worker.join(farm, "worker");
  const std::string first = farm.submit(request({{"reusable", "1"}, {"place", GetParam()}}));
  ASSERT_TRUE(serve(worker, "hashes", 1));
  const std::string second = farm.submit(request({{"reusable", "1"}, {"place", GetParam()}}));
  ASSERT_TRUE(eventually([&] { return !farm.status(second)->stages.empty(); }));
  std::map<std::string, int> batches;
  while (!ended(farm.status(first)->state) || !ended(farm.status(second)->state)) {
    const std::string stage = worker.work(chain_, 0.05);
    if (!stage.empty()) ++batches[stage];
  }
  const int all = static_cast<int>((chain_.pixels * items_a_pixel + 511) / 512);
  EXPECT_EQ(batches["hashes"], all - 1);
  EXPECT_EQ(batches["spread"], all);
  expect_right(farm, first);
  expect_right(farm, second);
  EXPECT_THAT(report(farm, second)["skips"].dump(), HasSubstr("made at the same time for another frame"));
}

TEST_P(FarmFollowers, WhoFollowsAFrameThatEndsGoesOnAlone) {
  Farm farm(settings_, blobs_);
  HoldingWorker worker;
  worker.join(farm, "worker");
  const std::string first = farm.submit(request({{"reusable", "1"}, {"place", GetParam()}}));
  ASSERT_TRUE(serve(worker, "hashes", 1));
  std::vector<std::string> others;
  others.push_back(farm.submit(request({{"reusable", "1"}, {"place", GetParam()}})));
  ASSERT_TRUE(eventually([&] { return !farm.status(others[0])->stages.empty(); }));
  farm.cancel(first);
  serve(farm, {&worker}, others[0]);
  expect_right(farm, others[0]);
}

TEST_F(FarmRetained, ReusableOutputsStayWithinTheirBound) {
  settings_.active_jobs = 1;
  settings_.retained_bytes = 2048 * 8 - 1;  // not even the hashes of one frame
  Farm farm(settings_, blobs_);
  HoldingWorker ada;
  ada.join(farm, "ada");
  const std::string job = farm.submit(request({{"reusable", "1"}}));
  serve(farm, {&ada}, job);
  expect_right(farm, job);
  EXPECT_THAT(ada.released(), SizeIs(2));
}

TEST_F(FarmRetained, ACancelledFrameReleasesAllAndAnotherOneThatReadsTheSameGoesOn) {
  Farm farm(settings_, blobs_);
  HoldingWorker ada, bob;
  ada.join(farm, "ada");
  bob.join(farm, "bob");
  const std::string one = farm.submit(request());
  EXPECT_TRUE(eventually([&] { return farm.status(one)->state == JobState::running; }));
  const std::string two = farm.submit(request());
  serve(ada, "hashes", 2);
  serve(bob, "hashes", 2);
  ada.leave();  // both frames need what it held
  farm.cancel(one);
  EXPECT_EQ(end_of(farm, one).state, JobState::cancelled);
  serve(farm, {&bob}, two);
  expect_right(farm, two);
  EXPECT_TRUE(eventually([&] { return bob.released().size() >= 2; }));
}

// Whatever is lost, whenever: the same pixels.
TEST_F(FarmRetained, RandomLossesGiveTheSamePixels) {
  std::mt19937 random(11);
  for (int round = 0; round < 12; ++round) {
    settings_.scheduler.fixed_batch_items = 64 + random() % 200;
    Farm farm(settings_, blobs_);
    std::vector<std::unique_ptr<HoldingWorker>> workers;
    int joined = 0;
    const auto join = [&] {
      workers.push_back(std::make_unique<HoldingWorker>());
      workers.back()->join(farm, std::string("w").append(std::to_string(++joined)));
    };
    for (int i = 0; i < 3; ++i) join();
    const std::string job = farm.submit(request(random() % 2 ? std::map<std::string, std::string>{{"spread", "solo"}}
                                                             : std::map<std::string, std::string>{}));
    for (int step = 0; step < 3000 && !ended(farm.status(job)->state); ++step) {
      workers[random() % workers.size()]->work(chain_, 0.001);
      if (joined < 12 && random() % 12 == 0) {
        workers.erase(workers.begin() + static_cast<long>(random() % workers.size()));
        join();
      }
    }
    std::vector<HoldingWorker*> all;
    for (auto& worker : workers) all.push_back(worker.get());
    serve(farm, all, job);
    expect_right(farm, job);
  }
}

}  // namespace
}  // namespace gleaner::test

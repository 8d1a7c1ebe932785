#pragma once
// A farm with scripted workers, on the fake frame's plan: the test says what each worker does, and when.

#include <gtest/gtest.h>

#include <algorithm>
#include <atomic>
#include <fstream>
#include <nlohmann/json.hpp>

#include "coordinator/jobs/farm.h"
#include "tests/farm/fake_frame.h"
#include "tests/farm/leased_worker.h"

namespace gleaner::test {

using namespace coordinator;

// A worker that does what the test says, when it says so.
class ScriptedWorker final : public LeasedWorker {
 public:
  ~ScriptedWorker() override { leave(); }
  void revoke(const Lease& lease) override {
    LeasedWorker::revoke(lease);
    std::lock_guard lock(mutex_);
    revoked_.push_back(lease);
  }
  void close(const std::string& reason) override {
    std::lock_guard lock(mutex_);
    closed_ = reason;
  }

  void join(Farm& farm, const std::string& wish = "scripted") {
    WorkerHello hello;
    hello.name = wish;
    hello.device.name = "a script";
    LeasedWorker::join(farm, hello);
  }
  void join_as(Farm& farm, const WorkerHello& hello) { LeasedWorker::join(farm, hello); }

  // The right records, from the blobs that the farm names.
  Bytes compute(const Offered& offer, BlobStore& blobs) const {
    const Lease& lease = offer.lease;
    if (offer.work->kind == "fake-scatter")
      return fake_scatter(values_of<std::uint64_t>(offer.work->parameters).at(0), lease.first, lease.count);
    Blob hashes = blobs.get(offer.work->inputs.at(0).blob);
    if (!hashes) throw Error::failed("the input is not there");
    return fake_gather(*hashes, lease.first, lease.count);
  }

  Verdict deliver(const Offered& offer, Bytes records, double seconds = 0.01, Bytes facts = {}) {
    BatchCost cost;
    cost.seconds = seconds;
    cost.trace_seconds = 0.5 * seconds;
    cost.kernel_seconds = 0.25 * seconds;
    cost.camera_rays = offer.lease.count;
    cost.scatter_rays = 2 * offer.lease.count;
    cost.shadow_rays = 3 * offer.lease.count;
    BatchOutput output{std::move(records)};
    output.facts = std::move(facts);
    return farm_->result(id, offer.lease.id, offer.lease.epoch, std::move(output), cost);
  }

  std::vector<Lease> revoked() {
    std::lock_guard lock(mutex_);
    return revoked_;
  }
  bool was_revoked(const Lease& lease) {
    auto all = revoked();
    return std::any_of(all.begin(), all.end(), [&](const Lease& gone) { return gone.epoch == lease.epoch; });
  }
  std::string closed() {
    std::lock_guard lock(mutex_);
    return closed_;
  }

 private:
  std::vector<Lease> revoked_;
  std::string closed_;
};

class FarmEngine : public testing::Test {
 protected:
  FarmSettings settings(std::uint64_t batch_items = 256) {
    FarmSettings farm_settings;
    farm_settings.plan = make_fake_plan;
    farm_settings.check = check_fake_settings;
    farm_settings.scheduler.fixed_batch_items = batch_items;
    farm_settings.scheduler.lease_floor = 1000;
    farm_settings.paths = [this](const std::string& job, std::uint32_t frame) {
      std::string stem = (folder_.path() / job / std::string("frame").append(std::to_string(frame))).string();
      return FramePaths{stem + ".exr", stem + ".png", stem + ".json"};
    };
    farm_settings.log = [](const std::string&) {};
    return farm_settings;
  }

  // The same by a clock that stands still but for the test: nobody is silent for too long.
  FarmSettings timed_settings(const std::atomic<double>& time, std::uint64_t batch_items = 256) {
    FarmSettings farm_settings = settings(batch_items);
    farm_settings.clock = [&time] { return time.load(); };
    farm_settings.silence = farm_settings.scheduler.lease_floor = 1e9;
    return farm_settings;
  }

  JobRequest request(const FrameSettings& frame = fake_settings()) {
    JobRequest job;
    job.scene_name = "fake.glb";
    job.scenes = {{blobs_.put(bytes_of(std::vector<int>{1, 2, 3})), {}, {}, {}}};
    job.settings = frame;
    return job;
  }

  static JobStatus end_of(Farm& farm, const std::string& job) {
    for (int i = 0; i < 40; ++i) {
      auto status = farm.wait(job, ~std::uint64_t{0}, 0.5);
      if (ended(status->state)) return *status;
    }
    ADD_FAILURE() << "job " << job << " does not end";
    return *farm.status(job);
  }

  // Serves the worker until the job has ended.
  void serve(Farm& farm, ScriptedWorker& worker, const std::string& job) {
    while (!ended(farm.status(job)->state)) {
      auto offer = worker.next(0.05);
      if (offer) worker.deliver(*offer, worker.compute(*offer, blobs_));
    }
  }

  // Offers of a whole stage, which the worker holds without answering.
  static std::vector<Offered> all_of(ScriptedWorker& worker, const std::string& stage, std::size_t batches) {
    std::vector<Offered> offers;
    while (offers.size() < batches) {
      auto offer = worker.next();
      if (!offer || offer->work->stage != stage) break;
      offers.push_back(*offer);
    }
    return offers;
  }

  nlohmann::json report(Farm& farm, const std::string& job, const std::string& extension = ".json",
                        std::size_t skip = 0) {
    for (const auto& path : farm.files(job)) {
      if (path.extension() != extension || skip-- > 0) continue;
      std::ifstream file(path);
      return nlohmann::json::parse(file);
    }
    ADD_FAILURE() << "no report";
    return {};
  }

  TemporaryFolder folder_;
  BlobStore blobs_;
};

}  // namespace gleaner::test

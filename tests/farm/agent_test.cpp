// Coordinator and workers over the wire, with devices that only do arithmetic.

#include "worker/agent/agent.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fstream>
#include <nlohmann/json.hpp>

#include "scene/model/error.h"
#include "tests/farm/fake_runner.h"
#include "tests/farm/wire_farm.h"

namespace gleaner::test {
namespace {

using coordinator::JobState;
using coordinator::JobStatus;
using testing::HasSubstr;

class FarmAgent : public testing::Test {
 protected:
  std::string submit(const coordinator::FrameSettings& settings = fake_settings()) {
    grpc::ClientContext context;
    pb::SubmitJobReply reply;
    grpc::Status status = people_->SubmitJob(&context, farm_.good_request(settings), &reply);
    EXPECT_TRUE(status.ok()) << status.error_message();
    return reply.job();
  }

  JobStatus end_of(const std::string& job) {
    EXPECT_TRUE(eventually([&] { return ended(farm_.farm().status(job)->state); }));
    return *farm_.farm().status(job);
  }

  nlohmann::json report(const std::string& job) {
    for (const auto& path : farm_.farm().files(job))
      if (path.extension() == ".json") {
        std::ifstream file(path);
        return nlohmann::json::parse(file);
      }
    ADD_FAILURE() << "no report";
    return {};
  }

  Stage stage_;
  WireFarm farm_;
  std::unique_ptr<pb::Farm::Stub> people_ = pb::Farm::NewStub(farm_.server().in_process_channel());
};

TEST_F(FarmAgent, AnyNumberOfWorkersGivesTheSamePixels) {
  for (int count : {1, 2, 3, 7}) {
    std::vector<std::unique_ptr<RunningAgent>> agents;
    for (int i = 0; i < count; ++i)
      // Some over a socket, some inside the process: the words are the same.
      agents.push_back(
          std::make_unique<RunningAgent>(i % 2 ? farm_.socket_channel() : farm_.server().in_process_channel(), stage_,
                                         std::string("w").append(std::to_string(i))));
    auto settings = fake_settings(96, 64);
    std::string job = submit(settings);
    JobStatus status = end_of(job);
    ASSERT_EQ(status.state, JobState::done) << status.message;
    EXPECT_EQ(report(job)["pixels_sha256"], fake_pixels_sha256(settings)) << count << " workers";
  }
}

TEST_F(FarmAgent, LargeResultsTravelInPieces) {
  auto settings =
      fake_settings(1024, 512);  // 2 Mi items of 8 bytes; a solo stage of 2 MiB in one result, a 16 MiB input
  settings.set["solo"] = "1";
  constexpr std::uint64_t down = (1 << 21) * 8 + (1 << 19) * 4, up = (1 << 21) * 8;
  for (const bool pack : {false, true}) {
    worker::AgentSettings worker = RunningAgent::settings("w");
    worker.pack = pack;
    RunningAgent agent(farm_.socket_channel(), stage_, worker);
    const std::string job = submit(settings);
    const JobStatus status = end_of(job);
    ASSERT_EQ(status.state, JobState::done) << status.message;
    const auto json = report(job);
    EXPECT_EQ(json["pixels_sha256"], fake_pixels_sha256(settings));
    EXPECT_EQ(json["stages"][1]["batches"], 1);
    const std::uint64_t came = json["bytes"]["downloaded"], went = json["bytes"]["uploaded"];
    EXPECT_GE(went, up) << "what is made of hashes, which get no smaller";
    if (pack)
      EXPECT_LT(came, down);
    else
      EXPECT_EQ(came, down);
  }
}

TEST_F(FarmAgent, AWarmWorkerFetchesNothingTwice) {
  RunningAgent agent(farm_.socket_channel(), stage_, "w");
  end_of(submit());
  std::string again = submit();
  end_of(again);
  EXPECT_EQ(stage_.scenes_loaded, 1);
  EXPECT_EQ(report(again)["bytes"]["uploaded"], 0) << "the scene and the artifact of the same bytes were there";
}

TEST_F(FarmAgent, ADeviceThatFailsIsAMessageAndNotACrash) {
  RunningAgent agent(farm_.socket_channel(), stage_, "w");
  stage_.fail = true;
  JobStatus status = end_of(submit());
  EXPECT_EQ(status.state, JobState::failed);
  EXPECT_THAT(status.message, HasSubstr("the device is on fire"));
  EXPECT_FALSE(agent.ended());
}

TEST_F(FarmAgent, ABlobThatCannotBeFetchedIsNotTheItemsFault) {
  const std::string job = submit(), id = farm_.good_request().scene_blob();
  const std::filesystem::path file = farm_.folder() / "blobs" / id.substr(0, 2) / id;
  const std::filesystem::path aside = farm_.folder() / "aside";
  std::filesystem::rename(file, aside);
  RunningAgent agent(farm_.socket_channel(), stage_, "w");
  // Far more often than items may fail.
  EXPECT_TRUE(eventually([&] { return farm_.farm().totals().batches_failed >= 8; }));
  EXPECT_EQ(farm_.farm().status(job)->state, JobState::running);
  EXPECT_THAT(*farm_.farm().why(job), testing::Contains(HasSubstr("no blob")));
  std::filesystem::rename(aside, file);
  const JobStatus status = end_of(job);
  EXPECT_EQ(status.state, JobState::done) << status.message;
}

TEST_F(FarmAgent, AStreamThatBreaksGivesItsItemsToOthers) {
  stage_.set_open(false);
  auto broken_context = std::make_unique<grpc::ClientContext>();
  auto stub = pb::WorkerHub::NewStub(farm_.socket_channel());
  auto stream = stub->Work(broken_context.get());
  pb::WorkerMessage hello;
  hello.mutable_hello()->set_protocol(protocol_version);
  hello.mutable_hello()->set_name("mortal");
  stream->Write(hello);
  pb::HubMessage heard;
  ASSERT_TRUE(stream->Read(&heard));
  auto settings = fake_settings();
  std::string job = submit(settings);
  ASSERT_TRUE(stream->Read(&heard));
  ASSERT_TRUE(heard.has_lease());
  broken_context->TryCancel();
  stream->Finish();
  stage_.set_open(true);
  RunningAgent agent(farm_.socket_channel(), stage_, "survivor");
  EXPECT_EQ(end_of(job).state, JobState::done);
  EXPECT_EQ(report(job)["pixels_sha256"], fake_pixels_sha256(settings));
}

TEST_F(FarmAgent, StoppingFinishesTheBatchAndSendsIt) {
  auto agent = std::make_unique<RunningAgent>(farm_.socket_channel(), stage_, "leaving");
  stage_.set_open(false);
  std::string job = submit();
  ASSERT_TRUE(eventually([&] { return stage_.batches == 1; }));
  agent->ask_to_stop();
  std::this_thread::sleep_for(std::chrono::milliseconds(100));
  EXPECT_FALSE(agent->ended()) << "its batch runs";
  stage_.set_open(true);
  EXPECT_EQ(agent->error(), "");
  EXPECT_EQ(farm_.farm().status(job)->stages.at(0).items_done, 256u) << "one batch was finished, none was begun";
  RunningAgent other(farm_.socket_channel(), stage_, "other");
  EXPECT_EQ(end_of(job).state, JobState::done);
}

TEST_F(FarmAgent, ADrainedWorkerFinishesAllItHoldsAndEnds) {
  RunningAgent agent(farm_.socket_channel(), stage_, "leaving");
  stage_.set_open(false);
  std::string job = submit();
  ASSERT_TRUE(eventually([&] { return stage_.batches == 1; }));
  ASSERT_TRUE(eventually([&] { return farm_.farm().workers().at(0).leases == 2; }));
  farm_.farm().drain(1);
  stage_.set_open(true);
  EXPECT_EQ(agent.error(), "");
  EXPECT_EQ(farm_.farm().status(job)->stages.at(0).items_done, 512u);
}

TEST_F(FarmAgent, SilenceIsBrokenByHeartbeats) {
  RunningAgent agent(farm_.socket_channel(), stage_, "patient");
  stage_.set_open(false);
  submit();
  ASSERT_TRUE(eventually([&] { return stage_.batches == 1; }));
  std::this_thread::sleep_for(std::chrono::milliseconds(700));
  EXPECT_LT(farm_.farm().workers().at(0).silent_seconds, 0.6) << "it speaks every 0.2 s though its batch runs";
  stage_.set_open(true);
}

TEST_F(FarmAgent, CancelledWorkIsDroppedAndTheWorkerGoesOn) {
  RunningAgent agent(farm_.socket_channel(), stage_, "w");
  stage_.set_open(false);
  std::string job = submit();
  ASSERT_TRUE(eventually([&] { return stage_.batches == 1; }));
  farm_.farm().cancel(job);
  EXPECT_EQ(end_of(job).state, JobState::cancelled);
  stage_.set_open(true);
  auto settings = fake_settings();
  settings.seed = 99;
  std::string next = submit(settings);
  EXPECT_EQ(end_of(next).state, JobState::done);
  EXPECT_EQ(report(next)["pixels_sha256"], fake_pixels_sha256(settings));
}

TEST(FarmAgentAlone, ARestartedCoordinatorGetsItsWorkersBack) {
  Stage stage;
  auto farm = std::make_unique<WireFarm>();
  std::string address = farm->server().address();
  RunningAgent agent(worker::dial(address), stage, "faithful");
  ASSERT_TRUE(eventually([&] { return farm->farm().workers().size() == 1; }));
  farm.reset();
  TemporaryFolder folder;
  coordinator::BlobStore blobs;
  coordinator::FarmSettings settings;
  settings.plan = make_fake_plan;
  settings.check = check_fake_settings;
  settings.paths = [&](const std::string&, std::uint32_t) {
    return coordinator::FramePaths{folder.path() / "a.exr", {}, {}};
  };
  coordinator::Farm again(settings, blobs);
  gateway::ServerSettings server_settings;
  server_settings.listen = address;
  gateway::Server server(again, blobs, server_settings);
  EXPECT_TRUE(eventually([&] { return again.workers().size() == 1; }));
}

TEST(FarmAgentAlone, WithoutACoordinatorItSaysSo) {
  Stage stage;
  RunningAgent agent(worker::dial("127.0.0.1:1"), stage, "lonely", false);
  EXPECT_THAT(agent.error(), HasSubstr("no connection"));
}

}  // namespace
}  // namespace gleaner::test

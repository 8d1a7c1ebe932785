// Records that stay with real agents: read from each other, through the coordinator, out of files; lost, wrong, and
// asked for by those who must not have them.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fstream>
#include <limits>
#include <nlohmann/json.hpp>

#include "proto/sha256.h"
#include "tests/farm/fake_runner.h"
#include "tests/farm/wire_farm.h"
#include "worker/agent/part_server.h"
#include "worker/artifacts/part_image.h"

namespace gleaner::test {
namespace {

using coordinator::JobState;
using coordinator::JobStatus;
using grpc::ClientContext;
using grpc::StatusCode;
using testing::HasSubstr;

constexpr std::uint32_t width = 64, height = 64;  // 16,384 items: 128 KiB of hashes, 64 batches
constexpr std::uint64_t all_items = std::uint64_t{width} * height * items_a_pixel;

coordinator::FrameSettings chain_settings(const std::map<std::string, std::string>& set = {}) {
  coordinator::FrameSettings settings = fake_settings(width, height);
  settings.set = set;
  settings.set["chain"] = "1";
  return settings;
}

class AgentArtifacts : public testing::Test {
 protected:
  std::string submit(const coordinator::FrameSettings& settings) {
    ClientContext context;
    pb::SubmitJobReply reply;
    grpc::Status status = people_->SubmitJob(&context, farm_.good_request(settings), &reply);
    EXPECT_TRUE(status.ok()) << status.error_message();
    return reply.job();
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
  nlohmann::json expect_right(const std::string& job) {
    EXPECT_TRUE(eventually([&] { return ended(farm_.farm().status(job)->state); }, 60));
    const JobStatus status = *farm_.farm().status(job);
    EXPECT_EQ(status.state, JobState::done) << status.message;
    if (status.state != JobState::done) return {};
    auto json = report(job);
    EXPECT_EQ(json["pixels_sha256"], fake_chain_sha256(chain_settings()));
    return json;
  }

  worker::AgentSettings settings(const std::string& name) {
    worker::AgentSettings agent = RunningAgent::settings(name);
    agent.log = [this, name](const std::string& line) {
      std::lock_guard lock(log_mutex_);
      log_ += name + ": " + line + "\n";
    };
    agent.peers = peers_;
    agent.pack = pack_;
    agent.cache_bytes = cache_bytes_;
    agent.retained_bytes = retained_bytes_;
    agent.parts = shared_parts_;
    return agent;
  }
  std::unique_ptr<RunningAgent> agent(const std::string& name) {
    return std::make_unique<RunningAgent>(farm_.socket_channel(), stage_, settings(name));
  }
  std::string log() {
    std::lock_guard lock(log_mutex_);
    return log_;
  }
  // Waits until the stage has so many items done.
  bool reached(const std::string& job, const std::string& name, std::uint64_t items) {
    return eventually([&] {
      const JobStatus status = *farm_.farm().status(job);
      for (const auto& stage : status.stages)
        if (stage.name == name) return stage.items_done >= items;
      return false;
    });
  }

  std::string peers_ = "127.0.0.1:0";
  bool pack_ = false;
  std::uint64_t cache_bytes_ = 1 << 30, retained_bytes_ = 1 << 30;
  std::shared_ptr<worker::PartStore> shared_parts_;
  std::mutex log_mutex_;
  std::string log_;
  Stage stage_;
  WireFarm farm_;
  std::unique_ptr<pb::Farm::Stub> people_ = pb::Farm::NewStub(farm_.server().in_process_channel());
  std::unique_ptr<pb::WorkerHub::Stub> hub_ = pb::WorkerHub::NewStub(farm_.socket_channel());
};

TEST_F(AgentArtifacts, HoweverTheRecordsTravelThePixelsAreTheSame) {
  const std::uint64_t pixels_bytes = std::uint64_t{width} * height * 4;
  struct Case {
    const char* what;
    const char* peers;
    std::uint64_t cache_bytes, retained_bytes;
    std::map<std::string, std::string> set;
    bool shared, pack = false;
  } const cases[] = {
      {"from each other", "127.0.0.1:0", 1 << 30, 1 << 30, {}, false},
      {"from each other, packed", "127.0.0.1:0", 1 << 30, 1 << 30, {}, false, true},
      {"through the coordinator", "", 1 << 30, 1 << 30, {}, false},
      {"in ranges, nothing kept", "127.0.0.1:0", 100, 1 << 30, {}, false},
      {"in ranges through the coordinator", "", 100, 1 << 30, {}, false},
      {"out of files", "127.0.0.1:0", 1 << 30, 0, {}, false},
      {"in one process", "", 1 << 30, 1 << 30, {}, true},
      {"a solo stage", "127.0.0.1:0", 1 << 30, 1 << 30, {{"spread", "solo"}}, false},
      {"collected", "127.0.0.1:0", 1 << 30, 1 << 30, {{"place", "collect"}}, false},
      {"collected, in ranges", "127.0.0.1:0", 100, 1 << 30, {{"place", "collect"}}, false},
      {"collected, in ranges, packed", "127.0.0.1:0", 100, 1 << 30, {{"place", "collect"}}, false, true},
  };
  for (const Case& c : cases) {
    SCOPED_TRACE(c.what);
    peers_ = c.peers;
    pack_ = c.pack;
    cache_bytes_ = c.cache_bytes;
    retained_bytes_ = c.retained_bytes;
    shared_parts_ = c.shared ? std::make_shared<worker::PartStore>(1 << 30) : nullptr;
    std::vector<std::unique_ptr<RunningAgent>> agents;
    for (int i = 0; i < 4; ++i) agents.push_back(agent(std::string("w").append(std::to_string(i))));
    ASSERT_TRUE(eventually([&] { return farm_.farm().workers().size() == 4; }));
    const auto json = expect_right(submit(chain_settings(c.set)));
    if (json.is_null()) continue;
    const auto bytes = json["bytes"];
    const std::uint64_t down = bytes["downloaded"], peers = bytes["peers"];
    if (c.set.contains("place")) {
      EXPECT_GT(down, all_items * 8 + pixels_bytes);
      EXPECT_EQ(peers, 0u);
    } else if (c.shared || !c.peers[0]) {
      EXPECT_EQ(peers, 0u);
      if (c.shared)
        EXPECT_EQ(down, pixels_bytes);
      else
        EXPECT_GT(down, pixels_bytes);
    } else {
      EXPECT_GT(peers, 0u);
      EXPECT_LE(down, pixels_bytes) << "the coordinator sees the pixels alone";
      EXPECT_EQ(down == pixels_bytes, !c.pack);
    }
    agents.clear();
    ASSERT_TRUE(eventually([&] { return farm_.farm().workers().empty(); }));
  }
}

TEST_F(AgentArtifacts, AListIsNotSentWholeToEveryWorker) {
  std::vector<std::unique_ptr<RunningAgent>> agents;
  for (int i = 0; i < 4; ++i) agents.push_back(agent(std::string("w").append(std::to_string(i))));
  const std::uint64_t scenes = 4 * farm_.blobs().source(farm_.good_request().scene_blob())->bytes();
  const auto json = expect_right(submit(chain_settings()));
  // Each pixel's number once, whoever computes it.
  EXPECT_EQ(json["bytes"]["uploaded"], width * height * 4 + scenes);
}

TEST_F(AgentArtifacts, AHolderLostMidWayCostsTimeAndNoPixels) {
  coordinator::WorkerId joined = 0;
  for (const char* peers : {"127.0.0.1:0", ""}) {
    SCOPED_TRACE(peers);
    peers_ = peers;
    joined += 4;
    std::vector<std::unique_ptr<RunningAgent>> agents;
    for (int i = 0; i < 4; ++i) agents.push_back(agent(std::string(peers[0] ? "p" : "r").append(std::to_string(i))));
    ASSERT_TRUE(eventually([&] { return farm_.farm().workers().size() == 4; }));
    stage_.set_open(false, "fake-sums");
    const std::string job = submit(chain_settings());
    ASSERT_TRUE(reached(job, "spread", all_items));
    farm_.farm().leave(joined - 1);  // with a quarter of both artifacts; "sums" reads all of them
    stage_.set_open(true);
    const auto json = expect_right(job);
    std::map<std::string, std::uint64_t> done;
    for (const auto& stage : json["stages"]) done[stage["name"]] += stage["items"].get<std::uint64_t>();
    EXPECT_GT(done["spread (again)"], 0u);
    EXPECT_LT(done["spread (again)"], all_items);
    EXPECT_GT(done["hashes (again)"], 0u) << "they had been released";
    agents.clear();
    ASSERT_TRUE(eventually([&] { return farm_.farm().workers().empty(); }));
  }
}

TEST_F(AgentArtifacts, WhatAHolderHasLostItselfIsComputedAgain) {
  for (const char* peers : {"127.0.0.1:0", ""}) {
    SCOPED_TRACE(peers);
    peers_ = peers;
    shared_parts_ = nullptr;
    auto one = agent(peers[0] ? "p1" : "r1");
    const auto store = shared_parts_ = std::make_shared<worker::PartStore>(1 << 30);
    auto two = agent(peers[0] ? "p2" : "r2");
    ASSERT_TRUE(eventually([&] { return farm_.farm().workers().size() == 2; }));
    stage_.set_open(false, "fake-sums");
    const std::string job = submit(chain_settings());
    ASSERT_TRUE(reached(job, "spread", all_items));
    ASSERT_GT(store->memory_bytes(), 0u) << "INCONCLUSIVE: the other one made all";
    store->clear(1);
    stage_.set_open(true);
    const auto json = expect_right(job);
    ASSERT_FALSE(json.is_null());
    std::uint64_t again = 0;
    for (const auto& stage : json["stages"])
      if (stage["name"] == "spread (again)") again += stage["items"].get<std::uint64_t>();
    EXPECT_GT(again, 0u);
    one.reset(), two.reset();
    ASSERT_TRUE(eventually([&] { return farm_.farm().workers().empty(); }));
  }
}

TEST_F(AgentArtifacts, ReleasedPartsLeaveTheirHolders) {
  shared_parts_ = std::make_shared<worker::PartStore>(1 << 30);
  auto one = agent("one");
  stage_.set_open(false, "fake-sums");
  const std::string job = submit(chain_settings());
  ASSERT_TRUE(reached(job, "spread", all_items));
  EXPECT_GT(shared_parts_->memory_bytes(), 0u);
  stage_.set_open(true);
  expect_right(job);
  EXPECT_TRUE(eventually([&] { return shared_parts_->memory_bytes() == 0; }));
}

// A worker that makes what it should and hands out something else.
class Liar final : public pb::WorkerPeer::Service {
 public:
  Liar(std::shared_ptr<grpc::Channel> channel, bool reachable) : hub_(pb::WorkerHub::NewStub(channel)) {
    grpc::ServerBuilder builder;
    int port = 0;
    builder.AddListeningPort("127.0.0.1:0", grpc::InsecureServerCredentials(), &port);
    builder.RegisterService(this);
    server_ = builder.BuildAndStart();
    stream_ = hub_->Work(&context_);
    pb::WorkerMessage hello;
    hello.mutable_hello()->set_protocol(protocol_version);
    hello.mutable_hello()->set_name("liar");
    // As the other workers' devices, so that its records count as theirs.
    hello.mutable_hello()->mutable_device()->set_name("arithmetic");
    hello.mutable_hello()->mutable_device()->set_tracer("none");
    if (reachable) hello.mutable_hello()->set_peer_address("127.0.0.1:" + std::to_string(port));
    stream_->Write(hello);
    thread_ = std::thread([this] { work(); });
  }
  ~Liar() override {
    context_.TryCancel();
    thread_.join();
    stream_->Finish();
    server_->Shutdown();
  }
  int lies() const { return lies_; }

  grpc::Status FetchPart(grpc::ServerContext*, const pb::FetchPartRequest* request,
                         grpc::ServerWriter<pb::PartPiece>* stream) override {
    pb::PartPiece piece;
    piece.set_data(answer(*request));
    stream->Write(piece);
    return grpc::Status::OK;
  }

 private:
  std::string answer(const pb::FetchPartRequest& request) {
    worker::ServedRange range;
    if (!worker::ServedRange::open(store_, request, range).ok()) return "";
    std::string bytes = range.bytes(0, range.length);
    if (request.sums() || bytes.empty()) return bytes;
    ++lies_;
    bytes[bytes.size() / 2] ^= 1;
    return bytes;
  }

  void work() {
    pb::HubMessage heard;
    while (stream_->Read(&heard)) {
      if (heard.has_welcome()) token_ = heard.welcome().token();
      if (heard.has_send_part()) {
        ClientContext context;
        pb::DeliverPartRequest delivery;
        pb::DeliverPartReply reply;
        delivery.set_token(token_);
        delivery.set_request(heard.send_part().request());
        delivery.set_data(answer(heard.send_part().range()));
        hub_->DeliverPart(&context, delivery, &reply);
      }
      if (!heard.has_lease()) continue;
      const pb::Lease& lease = heard.lease();
      pb::WorkerMessage message;
      if (lease.kind() == "fake-scatter") {
        Bytes seed(lease.parameters().size());
        std::memcpy(seed.data(), lease.parameters().data(), seed.size());
        auto part = store_.put(1, lease.artifact(), lease.first(), lease.count(), {},
                               fake_scatter(values_of<std::uint64_t>(seed).at(0), lease.first(), lease.count()));
        pb::Result& result = *message.mutable_result();
        result.set_lease(lease.lease());
        result.set_epoch(lease.epoch());
        result.mutable_cost()->set_seconds(0.01);
        result.mutable_part()->set_bytes(part->bytes());
        result.mutable_part()->set_records(lease.count());
        result.mutable_part()->set_digest(part->digest());
        result.mutable_part()->set_artifact(lease.artifact());
        result.mutable_part()->set_first(lease.first());
        result.mutable_part()->set_items(lease.count());
      } else {  // it takes no part in what follows
        message.mutable_failed()->set_lease(lease.lease());
        message.mutable_failed()->set_epoch(lease.epoch());
        message.mutable_failed()->set_message("not mine");
      }
      if (!stream_->Write(message)) return;
    }
  }

  std::unique_ptr<pb::WorkerHub::Stub> hub_;
  std::unique_ptr<grpc::Server> server_;
  ClientContext context_;
  std::unique_ptr<grpc::ClientReaderWriter<pb::WorkerMessage, pb::HubMessage>> stream_;
  worker::PartStore store_{1 << 30};
  std::string token_;
  std::atomic<int> lies_{0};
  std::thread thread_;
};

TEST_F(AgentArtifacts, BytesThatAreNotThoseOfTheDigestAreNeverUsed) {
  for (const bool reachable : {true, false}) {
    SCOPED_TRACE(reachable ? "from each other" : "through the coordinator");
    auto honest = agent(reachable ? "a" : "b");
    Liar liar(farm_.socket_channel(), reachable);
    ASSERT_TRUE(eventually([&] { return farm_.farm().workers().size() == 2; }));
    const std::string job = submit(chain_settings({{"spread", "solo"}}));
    expect_right(job);
    EXPECT_GT(liar.lies(), 0) << "it was asked";
    EXPECT_THAT(log(), HasSubstr("worker liar has no bytes of its digest"));
    honest.reset();
  }
}

TEST_F(AgentArtifacts, ServesPartsToThoseAloneWhoHaveATicket) {
  auto store = std::make_shared<worker::PartStore>(1 << 20);
  const std::string photons(64, 'a'), links(64, 'b');
  Bytes records(200000);
  for (std::size_t i = 0; i < records.size(); ++i) records[i] = static_cast<std::byte>(i * 37 >> 5);
  auto part = store->put(1, photons, 16, 25000, {}, records);
  store->put(1, links, 0, 1, {}, Bytes(8));
  worker::PeerServer server("127.0.0.1:0", store);
  auto peer = pb::WorkerPeer::NewStub(grpc::CreateChannel(server.address(), grpc::InsecureChannelCredentials()));
  const std::string token = new_token();
  pb::FetchPartRequest right;
  right.set_artifact(photons);
  right.set_first(16);
  right.set_digest(part->digest());
  right.set_offset(70000);
  right.set_length(100000);
  right.set_ticket(artifact_ticket(token, photons));
  const auto fetch = [&](const std::function<void(pb::FetchPartRequest&)>& change, std::string* out = nullptr) {
    pb::FetchPartRequest request = right;
    change(request);
    ClientContext context;
    auto reader = peer->FetchPart(&context, request);
    pb::PartPiece piece;
    std::string bytes;
    while (reader->Read(&piece)) bytes += piece.data();
    if (out) *out = bytes;
    const grpc::Status status = reader->Finish();
    EXPECT_TRUE(status.ok() || bytes.empty());
    return status.error_code();
  };
  EXPECT_EQ(fetch([](auto&) {}), StatusCode::PERMISSION_DENIED) << "not connected: nobody has a ticket";
  server.connected(token);
  std::string bytes;
  EXPECT_EQ(fetch([](auto&) {}, &bytes), StatusCode::OK);
  EXPECT_EQ(bytes, std::string(reinterpret_cast<const char*>(records.data()) + 70000, 100000));
  EXPECT_EQ(fetch([](auto& r) { r.set_sums(true), r.set_offset(0), r.set_length(4 * 32); }, &bytes), StatusCode::OK);
  EXPECT_EQ(bytes, std::string(reinterpret_cast<const char*>(part->sums().data()), part->sums().size()));
  constexpr std::uint64_t most = std::numeric_limits<std::uint64_t>::max();
  struct {
    const char* what;
    std::function<void(pb::FetchPartRequest&)> change;
    StatusCode code;
  } const attacks[] = {
      {"no ticket", [](auto& r) { r.clear_ticket(); }, StatusCode::PERMISSION_DENIED},
      {"another ticket", [](auto& r) { (*r.mutable_ticket())[3] ^= 1; }, StatusCode::PERMISSION_DENIED},
      {"the token itself", [&](auto& r) { r.set_ticket(token); }, StatusCode::PERMISSION_DENIED},
      {"another artifact's ticket", [&](auto& r) { r.set_ticket(artifact_ticket(token, links)); },
       StatusCode::PERMISSION_DENIED},
      {"another artifact", [&](auto& r) { r.set_artifact(links); }, StatusCode::PERMISSION_DENIED},
      {"an artifact that is not here",
       [&](auto& r) {
         r.set_artifact(std::string(64, 'c')), r.set_ticket(artifact_ticket(token, std::string(64, 'c')));
       },
       StatusCode::NOT_FOUND},
      {"another part", [](auto& r) { r.set_first(17); }, StatusCode::NOT_FOUND},
      {"another version", [](auto& r) { (*r.mutable_digest())[0] ^= 1; }, StatusCode::NOT_FOUND},
      {"no digest", [](auto& r) { r.clear_digest(); }, StatusCode::NOT_FOUND},
      {"a range over the end", [](auto& r) { r.set_offset(100001); }, StatusCode::OUT_OF_RANGE},
      {"an offset behind the end", [](auto& r) { r.set_offset(200001), r.set_length(0); }, StatusCode::OUT_OF_RANGE},
      {"a length that overflows", [](auto& r) { r.set_length(most); }, StatusCode::OUT_OF_RANGE},
      {"an offset that overflows", [](auto& r) { r.set_offset(most); }, StatusCode::OUT_OF_RANGE},
      {"both", [](auto& r) { r.set_offset(most), r.set_length(most); }, StatusCode::OUT_OF_RANGE},
      {"sums over the end", [](auto& r) { r.set_sums(true), r.set_offset(0), r.set_length(129); },
       StatusCode::OUT_OF_RANGE},
      {"a very long id", [](auto& r) { r.set_artifact(std::string(3000, 'x')); }, StatusCode::PERMISSION_DENIED},
      {"a request that is too long", [](auto& r) { r.set_holder(std::string(10000, 'x')); },
       StatusCode::RESOURCE_EXHAUSTED},
  };
  for (const auto& [what, change, code] : attacks) EXPECT_EQ(fetch(change), code) << what;
  EXPECT_EQ(fetch([](auto&) {}), StatusCode::OK) << "it goes on";
}

TEST_F(AgentArtifacts, TheCoordinatorPassesOnOnlyWhatALeaseReads) {
  peers_ = "";
  auto one = agent("one"), two = agent("two");
  ASSERT_TRUE(eventually([&] { return farm_.farm().workers().size() == 2; }));
  stage_.set_open(false, "fake-sums");
  const std::string job = submit(chain_settings());
  ASSERT_TRUE(reached(job, "spread", all_items));
  const auto locate = [&](const std::string& token, std::uint64_t epoch, const std::string& artifact) {
    ClientContext context;
    pb::LocateArtifactRequest request;
    request.set_token(token);
    request.set_epoch(epoch);
    request.set_artifact(artifact);
    pb::LocateArtifactReply reply;
    return hub_->LocateArtifact(&context, request, &reply).error_code();
  };
  EXPECT_EQ(locate("", 1, std::string(64, 'a')), StatusCode::PERMISSION_DENIED);
  EXPECT_EQ(locate(new_token(), 1, std::string(64, 'a')), StatusCode::PERMISSION_DENIED);
  EXPECT_EQ(locate(new_token(), 1, "\xff\xfe"), StatusCode::INTERNAL) << "not a string, says gRPC";
  {
    ClientContext context;
    pb::FetchPartRequest request;
    request.set_artifact(std::string(64, 'a'));
    request.set_ticket(new_token());
    request.set_length(std::numeric_limits<std::uint64_t>::max());
    auto reader = hub_->FetchPart(&context, request);
    pb::PartPiece piece;
    EXPECT_FALSE(reader->Read(&piece));
    EXPECT_EQ(reader->Finish().error_code(), StatusCode::PERMISSION_DENIED);
  }
  for (const std::string& token : {std::string(), new_token()}) {
    ClientContext context;
    pb::DeliverPartRequest request;
    request.set_token(token);
    request.set_data("x");
    pb::DeliverPartReply reply;
    EXPECT_EQ(hub_->DeliverPart(&context, request, &reply).error_code(), StatusCode::PERMISSION_DENIED);
  }
  stage_.set_open(true);
  expect_right(job);
}

}  // namespace
}  // namespace gleaner::test

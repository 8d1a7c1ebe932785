#pragma once
// A farm behind its gateway, with the fake frame's plan, for tests that speak the wire's language.

#include <grpcpp/grpcpp.h>

#include <memory>

#include "coordinator/gateway/convert.h"
#include "coordinator/gateway/server.h"
#include "gleaner/v1/farm.grpc.pb.h"
#include "gleaner/v1/worker.grpc.pb.h"
#include "tests/farm/fake_chain.h"
#include "tests/farm/small_scene.h"

namespace gleaner::test {

namespace pb = gleaner::v1;

struct WireBounds {
  std::uint64_t upload_bytes = 64 << 20;
  unsigned most_workers = 16;
  coordinator::Seconds silence = 30;
  std::shared_ptr<const Keys> keys{};
  gateway::CallerLimits caller{};
  std::size_t jobs_an_owner = 0;
};

class WireFarm {
 public:
  explicit WireFarm(const WireBounds& bounds)
      : blobs_(folder_.path() / "blobs"),
        farm_(farm_settings(bounds), blobs_),
        server_(farm_, blobs_, server_settings(bounds)) {}
  explicit WireFarm(std::uint64_t upload_bytes = 64 << 20, unsigned most_workers = 16,
                    coordinator::Seconds silence = 30, std::shared_ptr<const Keys> keys = {})
      : WireFarm(WireBounds{
            .upload_bytes = upload_bytes, .most_workers = most_workers, .silence = silence, .keys = std::move(keys)}) {}

  coordinator::Farm& farm() { return farm_; }
  coordinator::BlobStore& blobs() { return blobs_; }
  gateway::Server& server() { return server_; }
  const std::filesystem::path& folder() const { return folder_.path(); }

  std::shared_ptr<grpc::Channel> socket_channel() {
    return grpc::CreateChannel(server_.address(), grpc::InsecureChannelCredentials());
  }

  // A submission that the farm takes; its blobs are there.
  pb::SubmitJobRequest good_request(const coordinator::FrameSettings& settings = fake_settings()) {
    pb::SubmitJobRequest request;
    request.set_scene_name("triangle.glb");
    request.set_scene_blob(blobs_.put(scene::serialize(small_scene())));
    request.set_bvh_blob(blobs_.put(bytes_of(std::vector<int>{1, 2, 3})));
    *request.mutable_settings() = gateway::to_proto(settings);
    return request;
  }

 private:
  coordinator::FarmSettings farm_settings(const WireBounds& bounds) {
    coordinator::FarmSettings settings;
    settings.silence = bounds.silence;
    settings.jobs_an_owner = bounds.jobs_an_owner;
    settings.plan = [](const coordinator::FrameSettings& frame, const coordinator::SceneSummary& scene) {
      return frame.set.contains("chain") ? make_fake_chain(frame, scene) : make_fake_plan(frame, scene);
    };
    settings.check = check_fake_settings;
    settings.scheduler.fixed_batch_items = 256;
    settings.paths = [this](const std::string& job, std::uint32_t frame) {
      std::string stem = (folder_.path() / "jobs" / job / std::string("frame_").append(std::to_string(frame))).string();
      return coordinator::FramePaths{stem + ".exr", stem + ".png", stem + ".json"};
    };
    return settings;
  }
  static gateway::ServerSettings server_settings(const WireBounds& bounds) {
    gateway::ServerSettings settings;
    settings.listen = "127.0.0.1:0";
    settings.upload_bytes = bounds.upload_bytes;
    settings.most_workers = bounds.most_workers;
    settings.heartbeat_seconds = 0.2;
    settings.keys = bounds.keys;
    settings.caller = bounds.caller;
    return settings;
  }

  TemporaryFolder folder_;
  coordinator::BlobStore blobs_;
  coordinator::Farm farm_;
  gateway::Server server_;
};

}  // namespace gleaner::test

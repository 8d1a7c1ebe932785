#pragma once
// A farm behind its gateway, with the fake frame's plan, for tests that speak the wire's language.

#include <grpcpp/grpcpp.h>

#include <memory>

#include "coordinator/gateway/convert.h"
#include "coordinator/gateway/server.h"
#include "gleaner/v1/farm.grpc.pb.h"
#include "gleaner/v1/worker.grpc.pb.h"
#include "scene/model/blob.h"
#include "tests/farm/fake_frame.h"

namespace gleaner::test {

namespace pb = gleaner::v1;

// One triangle: enough of a scene for a blob that parses.
inline scene::Scene small_scene() {
  scene::Scene scene;
  scene.name = "triangle";
  scene.positions = {0, 0, 0, 1, 0, 0, 0, 1, 0};
  scene.normals = std::vector<float>(9, 0.0f);
  scene.indices = {0, 1, 2};
  scene.triangle_material = {0};
  scene.meshes = {{"triangle", 0, 1}};
  scene::Material material{};
  material.base_color[0] = material.base_color[1] = material.base_color[2] = 0.5f;
  material.alpha = 1;
  material.ior = 1.5f;
  material.roughness = 1;
  material.specular_color[0] = material.specular_color[1] = material.specular_color[2] = 1;
  material.base_color_texture = material.metallic_roughness_texture = material.normal_texture = GLEANER_NONE;
  material.emission_texture = material.transmission_texture = material.specular_texture = GLEANER_NONE;
  material.specular_color_texture = material.albedo_table = GLEANER_NONE;
  scene.materials = {material};
  scene.material_names = {"grey"};
  scene::finish_materials(scene);
  return scene;
}

class WireFarm {
 public:
  explicit WireFarm(std::uint64_t upload_bytes = 64 << 20, unsigned most_workers = 16,
                    coordinator::Seconds silence = 30)
      : blobs_(folder_.path() / "blobs"),
        farm_(farm_settings(silence), blobs_),
        server_(farm_, blobs_, server_settings(upload_bytes, most_workers)) {}

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
  coordinator::FarmSettings farm_settings(coordinator::Seconds silence) {
    coordinator::FarmSettings settings;
    settings.silence = silence;
    settings.plan = make_fake_plan;
    settings.check = check_fake_settings;
    settings.scheduler.fixed_batch_items = 256;
    settings.paths = [this](const std::string& job, std::uint32_t frame) {
      std::string stem = (folder_.path() / "jobs" / job / std::string("frame_").append(std::to_string(frame))).string();
      return coordinator::FramePaths{stem + ".exr", stem + ".png", stem + ".json"};
    };
    return settings;
  }
  static gateway::ServerSettings server_settings(std::uint64_t upload_bytes, unsigned most_workers) {
    gateway::ServerSettings settings;
    settings.listen = "127.0.0.1:0";
    settings.upload_bytes = upload_bytes;
    settings.most_workers = most_workers;
    settings.heartbeat_seconds = 0.2;
    return settings;
  }

  TemporaryFolder folder_;
  coordinator::BlobStore blobs_;
  coordinator::Farm farm_;
  gateway::Server server_;
};

}  // namespace gleaner::test

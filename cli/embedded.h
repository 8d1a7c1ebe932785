#pragma once
// The farm inside one process: the same coordinator and the same workers, joined by gRPC's in-process transport.

#include <functional>
#include <memory>
#include <thread>
#include <vector>

#include "coordinator/blobs/store.h"
#include "coordinator/gateway/server.h"
#include "coordinator/jobs/farm.h"
#include "worker/agent/agent.h"

namespace gleaner::cli {

struct EmbeddedSettings {
  unsigned workers = 1;
  // threads 0: the machine's, shared out among the workers; compiler: the first worker's.
  worker::DeviceChoice device;
  std::uint64_t batch_items = 0;  // 0 = adaptive
  std::function<coordinator::FramePaths(const std::string& job, std::uint32_t frame)> paths;
};

class EmbeddedFarm {
 public:
  // Opens the devices. Throws Error::failed where that fails.
  explicit EmbeddedFarm(const EmbeddedSettings& settings);
  ~EmbeddedFarm();
  EmbeddedFarm(const EmbeddedFarm&) = delete;
  EmbeddedFarm& operator=(const EmbeddedFarm&) = delete;

  bool needs_bvh() const { return needs_bvh_; }
  coordinator::BlobStore& blobs() { return blobs_; }
  coordinator::Farm& farm() { return farm_; }
  std::shared_ptr<grpc::Channel> channel() { return server_.in_process_channel(); }

 private:
  bool needs_bvh_ = false;
  coordinator::BlobStore blobs_;
  coordinator::Farm farm_;
  gateway::Server server_;
  std::vector<std::unique_ptr<worker::Agent>> agents_;
  std::vector<std::thread> threads_;
};

}  // namespace gleaner::cli

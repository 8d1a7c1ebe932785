#pragma once
// The worker's side of the farm: dials the coordinator, runs the leases that it is sent on one device, streams results
// back.

#include <grpcpp/channel.h>

#include <cstdint>
#include <functional>
#include <memory>
#include <string>

#include "worker/agent/runner.h"

namespace gleaner::worker {

struct AgentSettings {
  std::string name;                                    // 1 to 64 of [A-Za-z0-9._-]
  std::uint64_t cache_bytes = std::uint64_t{2} << 30;  // artifacts that are kept
  std::function<void(const std::string&)> log;         // one line each; empty: silence
  bool reconnect = true;                               // dial again when the connection is lost
  double give_up_seconds = 0;                          // without a connection for so long: run() throws; 0 = never
};

// A channel to a coordinator that notices a dead connection within half a minute.
std::shared_ptr<grpc::Channel> dial(const std::string& address);

class Agent {
 public:
  Agent(std::shared_ptr<grpc::Channel> channel, std::unique_ptr<Runner> runner, AgentSettings settings);
  ~Agent();
  Agent(const Agent&) = delete;
  Agent& operator=(const Agent&) = delete;

  // Works until stop(), or until the coordinator has drained this worker. Throws Error::connection where the
  // connection is lost and must not (or could not) be made again, Error::failed where the coordinator refuses the
  // worker.
  void run();
  // From any thread: the batch that runs is finished and its result sent, then run() returns.
  void stop();

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace gleaner::worker

#pragma once
// The worker's side of the farm: dials the coordinator, runs the leases that it is sent on one device, streams results
// back.

#include <grpcpp/channel.h>

#include <cstdint>
#include <functional>
#include <memory>
#include <string>

#include "proto/credentials.h"
#include "worker/agent/runner.h"
#include "worker/artifacts/part_store.h"

namespace gleaner::worker {

struct AgentSettings {
  std::string name;                                    // 1 to 64 of [A-Za-z0-9._-]
  std::uint64_t cache_bytes = std::uint64_t{2} << 30;  // of what was fetched and may be read again, all kinds together
  // Of the parts that this worker retains, those in memory; what does not fit lies in temporary files.
  std::uint64_t retained_bytes = std::uint64_t{1} << 30;
  // Null: the worker has a store of its own. Workers of one process share one, and read each other's parts where they
  // lie.
  std::shared_ptr<PartStore> parts;
  std::string peers;  // HOST:PORT on which other workers may fetch its parts; empty: through the coordinator alone
  bool pack = true;   // what is sent and fetched; false: the coordinator is in this process
  std::shared_ptr<const Keys> keys;             // for other workers; null: in the clear
  std::function<void(const std::string&)> log;  // one line each; empty: silence
  bool reconnect = true;                        // dial again when the connection is lost
  double give_up_seconds = 0;                   // without a connection for so long: run() throws; 0 = never
};

// Where a worker listens for others if nobody says: at any free port of loopback where the coordinator is there too
// (all on one machine), else nowhere (empty).
std::string usual_peers(const std::string& coordinator);

// A channel to a coordinator that notices a dead connection within half a minute.
std::shared_ptr<grpc::Channel> dial(const std::string& address, const Keys* keys = nullptr);

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

#pragma once
// The gRPC server: both services, reflection and the standard health service, on a socket or inside the process alone.

#include <grpcpp/channel.h>

#include <memory>
#include <string>

#include "coordinator/blobs/store.h"
#include "coordinator/gateway/callers.h"
#include "coordinator/jobs/farm.h"
#include "proto/credentials.h"

namespace gleaner::gateway {

struct ServerSettings {
  std::string listen;                                    // HOST:PORT, port 0 = any free one; empty = no socket
  std::uint64_t upload_bytes = std::uint64_t{64} << 30;  // largest blob
  unsigned most_workers = 4096;
  double heartbeat_seconds = 5;
  double hello_seconds = 10;   // in which a worker must say who it is
  double silent_seconds = 60;  // in which a peer that uploads or fetches must send or take a piece
  unsigned most_uploads = 256;
  unsigned most_sessions = 16;
  CallerLimits caller{.requests_a_second = 1000, .calls = 256};  // each of the people
  std::shared_ptr<const Keys> keys;                              // null: in the clear
};

class Server {
 public:
  // Throws Error::failed where it cannot listen.
  Server(coordinator::Farm& farm, coordinator::BlobStore& blobs, const ServerSettings& settings);
  ~Server();  // ends all calls
  Server(const Server&) = delete;
  Server& operator=(const Server&) = delete;

  const std::string& address() const;  // HOST:PORT as bound; empty without a socket
  std::shared_ptr<grpc::Channel> in_process_channel();
  void shutdown();

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace gleaner::gateway

#pragma once
// The other side of part_client.h: serves the parts that this process holds, to workers that reach it and to the
// coordinator.

#include <grpcpp/channel.h>
#include <grpcpp/support/status.h>

#include <condition_variable>
#include <deque>
#include <functional>
#include <memory>
#include <mutex>
#include <string>
#include <thread>
#include <vector>

#include "gleaner/v1/worker.grpc.pb.h"
#include "proto/credentials.h"
#include "worker/artifacts/part_store.h"

namespace gleaner::worker {

// What the request is of. NOT_FOUND: the part is not here. OUT_OF_RANGE: it has fewer bytes, or fewer sums.
struct ServedRange {
  std::shared_ptr<const StoredPart> part;
  bool sums = false;
  std::uint64_t offset = 0, length = 0;

  static grpc::Status open(const PartStore& store, const gleaner::v1::FetchPartRequest& request, ServedRange& out);
  // Bytes [from, from + count) of the range.
  std::string bytes(std::uint64_t from, std::uint64_t count) const;
};

// gleaner.v1.WorkerPeer on a socket.
class PeerServer {
 public:
  // HOST:PORT, port 0 = any free one. Throws Error::failed where it cannot listen.
  // Null keys: in the clear; else for workers alone.
  PeerServer(const std::string& listen, std::shared_ptr<PartStore> store, std::shared_ptr<const Keys> keys = {});
  ~PeerServer();
  const std::string& address() const;  // HOST:PORT as bound
  // The token of this worker's connection: tickets are made with it.
  void connected(const std::string& token);

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

// Answers the coordinator's SendPart with DeliverPart, on threads of its own.
class PartResponder {
 public:
  PartResponder(std::shared_ptr<grpc::Channel> coordinator, std::shared_ptr<PartStore> store);
  ~PartResponder();
  void connected(const std::string& token);
  void answer(const gleaner::v1::SendPart& request);  // queues it

 private:
  void work();

  std::unique_ptr<gleaner::v1::WorkerHub::Stub> stub_;
  std::shared_ptr<PartStore> store_;
  std::mutex mutex_;  // guards what follows
  std::condition_variable queued_;
  std::string token_;
  std::deque<gleaner::v1::SendPart> queue_;
  bool stopping_ = false;
  std::vector<std::thread> threads_;
};

}  // namespace gleaner::worker

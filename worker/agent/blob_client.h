#pragma once
// Blobs from the coordinator, checked against their ids, the last used ones kept.

#include <grpcpp/channel.h>

#include <cstdint>
#include <list>
#include <map>
#include <memory>
#include <string>

#include "gleaner/v1/worker.grpc.pb.h"
#include "scene/model/blob.h"

namespace gleaner::worker {

// One thread uses it.
class BlobClient {
 public:
  BlobClient(std::shared_ptr<grpc::Channel> channel, std::uint64_t cache_bytes);

  // Throws Error::failed where the coordinator does not have it, or sends other bytes than the id's.
  std::shared_ptr<const scene::Bytes> fetch(const std::string& id);
  // As fetch(), and the next fetch() of it is from the cache until other blobs need its room.
  std::shared_ptr<const scene::Bytes> fetch_and_keep(const std::string& id);
  std::uint64_t fetched_bytes() const { return fetched_bytes_; }  // so far

 private:
  std::unique_ptr<gleaner::v1::WorkerHub::Stub> stub_;
  std::uint64_t cache_bytes_, cached_bytes_ = 0, fetched_bytes_ = 0;
  struct Entry {
    std::shared_ptr<const scene::Bytes> blob;
    std::list<std::string>::iterator use;
  };
  std::map<std::string, Entry> cache_;
  std::list<std::string> uses_;  // last used first
};

}  // namespace gleaner::worker

#pragma once
// Bytes from the coordinator: blobs, which are checked against their ids, and what lies there of a frame's artifacts.

#include <grpcpp/channel.h>

#include <atomic>
#include <cstdint>
#include <functional>
#include <memory>
#include <span>
#include <string>

#include "gleaner/v1/worker.grpc.pb.h"
#include "scene/model/blob.h"

namespace gleaner::worker {

// Thread-safe.
class BlobClient {
 public:
  // `packs`: bytes are packed for the way.
  BlobClient(std::shared_ptr<grpc::Channel> channel, bool packs);

  // All of a blob whose id is the SHA-256 of its bytes. Throws Error::connection where other bytes come, or none.
  std::shared_ptr<const scene::Bytes> fetch(const std::string& id);
  // Copies bytes [offset, offset + out.size()); they are taken as they come. `stride`: of the records that begin there,
  // 1 where nothing is known of them. Throws as fetch(), and Error::failed where the blob has no such range.
  void read(const std::string& id, std::uint64_t offset, std::span<std::byte> out, std::uint32_t stride = 1);
  std::uint64_t fetched_bytes() const { return fetched_bytes_; }  // so far, as they travelled

 private:
  // Asks for the range, and hands on what arrives until `take` returns false.
  grpc::Status pieces(const gleaner::v1::FetchBlobRequest& request,
                      const std::function<bool(std::uint64_t total, std::span<const std::byte> bytes)>& take);

  std::unique_ptr<gleaner::v1::WorkerHub::Stub> stub_;
  bool packs_;
  std::atomic<std::uint64_t> fetched_bytes_{0};
};

}  // namespace gleaner::worker

#pragma once
// Parts of retained artifacts that other workers hold: where they lie, and their bytes, checked piece by piece.

#include <grpcpp/channel.h>

#include <atomic>
#include <chrono>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <span>
#include <string>
#include <vector>

#include "gleaner/v1/worker.grpc.pb.h"
#include "proto/credentials.h"
#include "scene/model/blob.h"
#include "worker/artifacts/byte_cache.h"
#include "worker/artifacts/part_store.h"

namespace gleaner::worker {

// A part, and the lease that reads it.
struct LocatedPart {
  std::string artifact;
  std::uint64_t epoch = 0;
  gleaner::v1::Part part;
};

// Thread-safe but for connected().
class PartClient {
 public:
  // Reports a holder whose bytes are not those of the digest.
  using Report = std::function<void(const gleaner::v1::WrongPart&)>;

  PartClient(std::shared_ptr<grpc::Channel> coordinator, std::shared_ptr<PartStore> own,
             std::shared_ptr<ByteCache> cache, std::shared_ptr<const Keys> keys, Report report);

  // A connection begins, under this token.
  void connected(const std::string& token);
  // Throws Error::connection where the artifact is not whole at the moment, or the coordinator cannot be asked;
  // Error::failed where it refuses.
  std::vector<LocatedPart> locate(const std::string& artifact, std::uint64_t epoch);
  // Copies bytes [offset, offset + out.size()) of the part's image: from this process, from a holder, or through the
  // coordinator. Throws Error::connection where none of them has the right bytes.
  void read(const LocatedPart& from, std::uint64_t offset, std::span<std::byte> out);
  std::shared_ptr<const StoredPart> own(const LocatedPart& part) const;  // null: it is not here

  std::uint64_t peer_bytes() const { return peer_bytes_; }  // fetched from other workers directly, so far

 private:
  struct Source;  // one way to one holder
  using Clock = std::chrono::steady_clock;
  std::vector<Source> sources_of(const LocatedPart& from);
  std::shared_ptr<const scene::Bytes> sums_of(const LocatedPart& from, const Source& source);
  void read_checked(const LocatedPart& from, const Source& source, std::uint64_t offset, std::span<std::byte> out);
  void fetch(const LocatedPart& from, const Source& source, bool sums, std::uint64_t offset, std::uint64_t length,
             const std::function<void(std::span<const std::byte>)>& take);
  std::shared_ptr<gleaner::v1::WorkerPeer::Stub> peer(const std::string& address);

  std::unique_ptr<gleaner::v1::WorkerHub::Stub> hub_;
  std::shared_ptr<PartStore> own_;
  std::shared_ptr<ByteCache> cache_;
  std::shared_ptr<const Keys> keys_;  // for other workers; null: in the clear
  Report report_;
  std::atomic<std::uint64_t> peer_bytes_{0};
  std::mutex mutex_;  // guards what follows
  std::string token_;
  std::map<std::string, std::shared_ptr<gleaner::v1::WorkerPeer::Stub>> peers_;  // by address
  std::map<std::string, Clock::time_point> unreachable_;  // by address: until when it is not tried
};

}  // namespace gleaner::worker

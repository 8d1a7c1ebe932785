#pragma once
// Bytes by name. What is put is content-addressed (its id is the SHA-256 of its bytes) and stays: in files, where there
// is a folder, else in memory. What is lent is found by the id that its owner gives it, for as long as the owner keeps
// it.

#include <condition_variable>
#include <cstdint>
#include <filesystem>
#include <future>
#include <map>
#include <memory>
#include <mutex>
#include <span>
#include <string>
#include <vector>

#include "coordinator/blobs/sha256.h"
#include "scene/model/blob.h"

namespace gleaner::coordinator {

using scene::Bytes;
using Blob = std::shared_ptr<const Bytes>;

// A blob of which ranges are read. Thread-safe.
class BlobSource {
 public:
  virtual ~BlobSource() = default;
  virtual std::uint64_t bytes() const = 0;
  // Copies bytes [offset, offset + out.size()). Throws Error::bad_input where the blob has fewer, Error::failed where
  // they cannot be read.
  virtual void read(std::uint64_t offset, std::span<std::byte> out) const = 0;
};

class BlobStore {
 public:
  // Empty folder: everything in memory. Throws Error::failed where the folder cannot be made or written.
  explicit BlobStore(std::filesystem::path folder = {});

  bool has(const std::string& id) const;  // it was put here (what is lent does not count)
  // Null where it is unknown. A file's bytes are checked against its id once; whoever asks meanwhile waits for that.
  // Throws Error::failed where the file is damaged (it is renamed, so that the blob can be sent again).
  std::shared_ptr<const BlobSource> source(const std::string& id);
  // All bytes in one piece of memory; those who ask at the same time share one copy. Null and throws as source().
  Blob get(const std::string& id);
  // Returns the id. Throws Error::failed where it cannot be written.
  std::string put(Bytes bytes);
  // The bytes of the segments, one behind the other, are found by the id until the last other owner of a segment
  // releases it. The id must not be one that was put. The other one lends under the SHA-256 of the bytes, and returns
  // it.
  void lend(const std::string& id, const std::vector<Blob>& segments);
  std::string lend(Blob blob);
  std::uint64_t bytes_checked() const;  // of files, against their ids, so far

  // One blob on its way in, piece by piece; nothing remains of it unless commit() returns.
  class Upload {
   public:
    Upload(BlobStore& store, std::string id, std::uint64_t bytes);
    ~Upload();
    Upload(const Upload&) = delete;
    Upload& operator=(const Upload&) = delete;
    // Throws Error::bad_input where more comes than was said, Error::failed where it cannot be written.
    void append(std::span<const std::byte> piece);
    // Throws Error::bad_input where the bytes are too few or are not those of the id.
    void commit();

   private:
    friend class BlobStore;
    BlobStore& store_;
    std::string id_;
    std::uint64_t expected_, received_ = 0;
    Sha256 hash_;
    Bytes memory_;                // where the store has no folder
    std::filesystem::path file_;  // where it has one
    int descriptor_ = -1;
    bool claims_ = false;  // others that upload the same blob wait for this one
  };

  // Null: the store has the blob, because another upload that was under way has brought it. One that has made no
  // progress for `patience` seconds is waited for no longer. Throws as Upload's constructor.
  std::unique_ptr<Upload> begin_upload(const std::string& id, std::uint64_t bytes, double patience = 10);

 private:
  class MemorySource;
  class FileSource;
  std::filesystem::path path_of(const std::string& id) const;
  std::vector<Blob> in_memory(const std::string& id) const;  // mutex held; empty: not in memory
  std::shared_ptr<const BlobSource> open_file(const std::string& id);
  void check_file(const std::string& id, const FileSource& file);
  void end_claim(const std::string& id);

  std::filesystem::path folder_;
  mutable std::mutex mutex_;
  std::map<std::string, Blob> kept_;  // without a folder
  // By each of its lenders, or read from a file and still in use. Two frames may have equal lists: when one has ended,
  // the other's must still be found.
  using LentSegments = std::vector<std::weak_ptr<const Bytes>>;
  std::multimap<std::string, LentSegments> lent_;
  std::map<std::string, std::shared_future<Blob>> reading_;         // by get(), at the moment
  std::map<std::string, std::shared_future<void>> checking_;        // by source(), at the moment
  std::map<std::string, std::filesystem::file_time_type> checked_;  // files whose bytes are those of their ids
  std::map<std::string, std::uint64_t> uploading_;                  // claimed: bytes received
  std::condition_variable upload_ended_;
  std::uint64_t uploads_ = 0, bytes_checked_ = 0;
};

}  // namespace gleaner::coordinator

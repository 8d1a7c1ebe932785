#pragma once
// The content-addressed store: a blob's id is the SHA-256 of its bytes. What is put stays (in files, where there is a
// folder; else in memory); what is lent is found by its id for as long as its owner keeps it.

#include <cstdint>
#include <filesystem>
#include <map>
#include <memory>
#include <mutex>
#include <span>
#include <string>

#include "coordinator/blobs/sha256.h"
#include "scene/model/blob.h"

namespace gleaner::coordinator {

using scene::Bytes;
using Blob = std::shared_ptr<const Bytes>;

class BlobStore {
 public:
  // Empty folder: everything in memory. Throws Error::failed where the folder cannot be made or written.
  explicit BlobStore(std::filesystem::path folder = {});

  bool has(const std::string& id) const;  // it was put here (what is lent does not count)
  // Null where it is unknown. Throws Error::failed where the file is damaged (it is put aside, so that it can be sent
  // again).
  Blob get(const std::string& id);
  // Returns the id. Throws Error::failed where it cannot be written.
  std::string put(Bytes bytes);
  // Findable until the last other owner lets go. Returns the id.
  std::string lend(Blob blob);

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
    BlobStore& store_;
    std::string id_;
    std::uint64_t expected_, received_ = 0;
    Sha256 hash_;
    Bytes memory_;                // where the store has no folder
    std::filesystem::path file_;  // where it has one
    int descriptor_ = -1;
  };

 private:
  std::filesystem::path path_of(const std::string& id) const;

  std::filesystem::path folder_;
  mutable std::mutex mutex_;
  std::map<std::string, Blob> kept_;                        // without a folder
  std::map<std::string, std::weak_ptr<const Bytes>> lent_;  // lent out, or read from a file and still in use
  std::uint64_t uploads_ = 0;
};

}  // namespace gleaner::coordinator

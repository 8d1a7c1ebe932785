#pragma once
// What was fetched and may be read again, of all kinds under one bound; the least recently used is dropped first.
// Thread-safe.

#include <cstdint>
#include <list>
#include <map>
#include <memory>
#include <mutex>
#include <string>
#include <vector>

#include "scene/model/blob.h"

namespace gleaner::worker {

// Whole bytes; of a counted artifact its records, and where each item's begin.
struct CachedBytes {
  std::shared_ptr<const scene::Bytes> bytes;
  std::shared_ptr<const std::vector<std::uint64_t>> offsets{};

  std::uint64_t size() const { return bytes->size() + (offsets ? offsets->size() * sizeof(std::uint64_t) : 0); }
};

class ByteCache {
 public:
  explicit ByteCache(std::uint64_t most_bytes) : most_(most_bytes) {}

  CachedBytes find(const std::string& id);  // `bytes` is null where it is not here
  // What is larger than the bound is not kept, and displaces nothing.
  void put(const std::string& id, const CachedBytes& entry);
  std::uint64_t most_bytes() const { return most_; }
  std::uint64_t bytes() const;

 private:
  struct Entry {
    CachedBytes what;
    std::list<std::string>::iterator use;
  };
  const std::uint64_t most_;
  mutable std::mutex mutex_;
  std::map<std::string, Entry> entries_;
  std::list<std::string> uses_;  // last used first
  std::uint64_t bytes_ = 0;
};

}  // namespace gleaner::worker

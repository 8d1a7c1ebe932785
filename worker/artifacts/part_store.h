#pragma once
// Parts of retained artifacts that this process holds: in memory up to a bound, beyond it in temporary files that have
// no name (they vanish with the process, whatever ends it). Thread-safe.

#include <cstdint>
#include <filesystem>
#include <map>
#include <memory>
#include <mutex>
#include <span>
#include <string>
#include <tuple>
#include <vector>

#include "scene/model/blob.h"
#include "worker/artifacts/artifact.h"

namespace gleaner::worker {

class SpillFile;

// One part; it stays readable for as long as somebody has it, also after it was dropped from the store.
class StoredPart {
 public:
  std::uint64_t bytes() const { return bytes_; }  // of the image
  std::uint64_t items() const { return items_; }
  const scene::Bytes& sums() const { return sums_; }  // of the image's pieces
  const std::string& digest() const { return digest_; }
  // Copies bytes [offset, offset + out.size()) of the image. Throws Error::failed where it has fewer, or where the file
  // cannot be read.
  void read(std::uint64_t offset, std::span<std::byte> out) const;
  // The records, where they lie in memory; else null.
  const std::shared_ptr<const scene::Bytes>& records_in_memory() const { return records_; }

 private:
  friend class PartStore;
  std::uint64_t items_ = 0, bytes_ = 0;
  scene::Bytes sums_;
  std::string digest_;
  scene::Bytes counts_;                          // in memory: of a counted artifact
  std::shared_ptr<const scene::Bytes> records_;  // in memory
  std::shared_ptr<const SpillFile> file_;        // else
  std::uint64_t at_ = 0;                         // where the image begins in the file
};

class PartStore {
 public:
  // A worker that has parts here. Workers of one process may share a store: each reads what the others have, and drops
  // its own alone.
  using Owner = std::uint64_t;

  // `folder`: where the files are; empty: $TMPDIR, or /tmp.
  explicit PartStore(std::uint64_t memory_bytes, std::filesystem::path folder = {});

  Owner new_owner();
  // `counts`: one an item for a counted artifact, else empty. Throws Error::failed where a file cannot be written.
  std::shared_ptr<const StoredPart> put(Owner owner, const std::string& artifact, std::uint64_t first,
                                        std::uint64_t items, const std::vector<std::uint32_t>& counts,
                                        scene::Bytes records);
  // Null: it is not here. The digest tells it from other versions of the part.
  std::shared_ptr<const StoredPart> find(const std::string& artifact, std::uint64_t first,
                                         const std::string& digest) const;
  // What the owner has put of the artifact. A part is gone when no owner has it.
  void drop(Owner owner, const std::string& artifact);
  // One put() of the part less.
  void drop(Owner owner, const std::string& artifact, std::uint64_t first, const std::string& digest);
  void clear(Owner owner);

  std::uint64_t memory_bytes() const;  // of the parts that lie in memory
  std::uint64_t file_bytes() const;    // of those that lie in files

 private:
  using Key = std::tuple<std::string, std::uint64_t, std::string>;  // artifact, first item, digest
  struct Entry {
    std::shared_ptr<const StoredPart> part;
    std::map<Owner, unsigned> puts;
  };
  using Entries = std::map<Key, Entry>;
  // Forgets so many puts (0: all) of the owner's, and the part with the last one of all. Returns the next entry.
  Entries::iterator forget(Entries::iterator at, Owner owner, unsigned puts);

  const std::uint64_t most_memory_;
  const std::filesystem::path folder_;
  mutable std::mutex mutex_;
  Owner owners_ = 0;
  Entries parts_;
  std::map<std::string, std::shared_ptr<SpillFile>> files_;  // one an artifact
  std::uint64_t in_memory_ = 0, in_files_ = 0;
};

}  // namespace gleaner::worker

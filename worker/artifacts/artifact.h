#pragma once
// An artifact as a stage reads it. Its bytes may lie in this process, in a file, or with another worker; a stage that
// needs only some of them, or that copies them into a device buffer, reads ranges and never holds the whole.

#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "scene/model/blob.h"

namespace gleaner::worker {

class ArtifactSource {
 public:
  virtual ~ArtifactSource() = default;
  virtual std::uint64_t bytes() const = 0;
  // Copies bytes [offset, offset + out.size()). Throws Error::failed where there are fewer, Error::connection where
  // they cannot be fetched (the batch is then tried again later: who catches it must throw it on). Thread-safe.
  virtual void read(std::uint64_t offset, std::span<std::byte> out) const = 0;
  // All bytes, where they lie in one piece of memory already; else empty.
  virtual std::span<const std::byte> in_memory() const { return {}; }

 protected:
  void check_range(std::uint64_t offset, std::uint64_t length) const;  // throws as read()
};

class MemoryArtifact final : public ArtifactSource {
 public:
  explicit MemoryArtifact(std::shared_ptr<const scene::Bytes> bytes) : bytes_(std::move(bytes)) {}
  std::uint64_t bytes() const override { return bytes_->size(); }
  void read(std::uint64_t offset, std::span<std::byte> out) const override;
  std::span<const std::byte> in_memory() const override { return *bytes_; }
  const std::shared_ptr<const scene::Bytes>& shared() const { return bytes_; }

 private:
  std::shared_ptr<const scene::Bytes> bytes_;
};

// One input of a stage, as far as a batch may see it.
struct TaskInput {
  TaskInput() = default;
  // Bytes in memory, the whole artifact.
  TaskInput(std::shared_ptr<const scene::Bytes> all) : source(std::make_shared<MemoryArtifact>(std::move(all))) {}
  TaskInput(std::shared_ptr<scene::Bytes> all) : TaskInput(std::shared_ptr<const scene::Bytes>(std::move(all))) {}

  std::string artifact;  // id; equal ids, equal bytes: what tables made of inputs are kept by. Empty: not known
  std::shared_ptr<const ArtifactSource> source;  // records [first record of first_item, ...), without counts
  bool own_items = false;                        // the source holds the records of the batch's items alone
  std::uint64_t first_item = 0;                  // own_items: the item to whom the source's first record belongs
  // Counted: where each item's records begin, in records from the source's start; one more at the end. Else null.
  std::shared_ptr<const std::vector<std::uint64_t>> offsets;

  std::uint64_t bytes() const { return source ? source->bytes() : 0; }
  std::span<const std::byte> in_memory() const { return source ? source->in_memory() : std::span<const std::byte>{}; }
  // The bytes in one piece of memory: where they lie, or read into a new one. For small inputs.
  std::shared_ptr<const scene::Bytes> load() const;
};

}  // namespace gleaner::worker

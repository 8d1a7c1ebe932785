#pragma once
// Device memory that batches use again: taking 64 MB anew for each batch costs a page fault every 4 KiB.

#include <cstdint>
#include <map>
#include <mutex>
#include <string>

#include "worker/device/device.h"

namespace gleaner::worker {

// Within a batch thread-safe: its threads take buffers, each by names of its own.
class Workspace {
 public:
  // `most`: bytes that stay between batches. A batch itself gets what it asks for.
  Workspace(const Device& device, std::size_t most) : device_(device), most_(most) {}

  // A buffer of at least `bytes`; what it holds is whatever its last user left. Within a batch a name is one buffer,
  // over batches all stages that use a name for the same purpose share its memory. Throws cl::Error.
  cl::Buffer take(const std::string& name, std::size_t bytes);

  // Gives back what the last batches did not use, and the longest unused beyond the bound. Call between batches: who
  // still holds a buffer keeps it alive.
  void end_batch();

  std::size_t bytes() const;

 private:
  struct Entry {
    cl::Buffer buffer{};
    std::size_t bytes = 0;
    std::size_t wanted = 0;       // the most that was asked for since `since`
    std::uint64_t since = 0;      // batch
    std::uint64_t last_used = 0;  // batch
  };
  using Entries = std::map<std::string, Entry>;
  Entries::iterator drop(Entries::iterator entry);

  const Device& device_;
  mutable std::mutex mutex_;  // of what follows
  std::size_t most_, bytes_ = 0;
  std::uint64_t batch_ = 0;
  Entries entries_;
};

}  // namespace gleaner::worker

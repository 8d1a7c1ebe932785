#include "worker/wavefront/workspace.h"

#include <algorithm>

namespace gleaner::worker {
namespace {

// A buffer that so many batches in a row did not use, or of which they used less than a quarter, is given back.
constexpr std::uint64_t kPatience = 64;

}  // namespace

cl::Buffer Workspace::take(const std::string& name, std::size_t bytes) {
  std::lock_guard lock(mutex_);
  Entry& entry = entries_[name];
  entry.last_used = batch_;
  if (entry.bytes < bytes) {
    bytes_ -= entry.bytes;
    entry = {};  // give back before taking more
    entry.last_used = entry.since = batch_;
    entry.buffer = device_.make_buffer(bytes);
    entry.bytes = bytes;
    bytes_ += bytes;
  }
  entry.wanted = std::max(entry.wanted, bytes);
  return entry.buffer;
}

std::size_t Workspace::bytes() const {
  std::lock_guard lock(mutex_);
  return bytes_;
}

// With the lock.
Workspace::Entries::iterator Workspace::drop(Entries::iterator entry) {
  bytes_ -= entry->second.bytes;
  return entries_.erase(entry);
}

void Workspace::end_batch() {
  std::lock_guard lock(mutex_);
  ++batch_;
  for (auto it = entries_.begin(); it != entries_.end();) {
    Entry& entry = it->second;
    const bool review = batch_ - entry.since >= kPatience;
    if (batch_ - entry.last_used >= kPatience || (review && entry.wanted < entry.bytes / 4)) {
      it = drop(it);
      continue;
    }
    if (review) {
      entry.since = batch_;
      entry.wanted = 0;
    }
    ++it;
  }
  while (bytes_ > most_ && !entries_.empty())
    drop(std::ranges::min_element(entries_, {}, [](const auto& e) { return e.second.last_used; }));
}

}  // namespace gleaner::worker

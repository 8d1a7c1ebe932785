#include "worker/artifacts/byte_cache.h"

namespace gleaner::worker {

CachedBytes ByteCache::find(const std::string& id) {
  std::lock_guard lock(mutex_);
  const auto found = entries_.find(id);
  if (found == entries_.end()) return {};
  uses_.splice(uses_.begin(), uses_, found->second.use);
  return found->second.what;
}

void ByteCache::put(const std::string& id, const CachedBytes& entry) {
  std::lock_guard lock(mutex_);
  if (entries_.contains(id) || entry.size() > most_) return;
  while (bytes_ + entry.size() > most_) {
    const auto oldest = entries_.find(uses_.back());
    bytes_ -= oldest->second.what.size();
    entries_.erase(oldest);
    uses_.pop_back();
  }
  uses_.push_front(id);
  entries_[id] = {entry, uses_.begin()};
  bytes_ += entry.size();
}

std::uint64_t ByteCache::bytes() const {
  std::lock_guard lock(mutex_);
  return bytes_;
}

}  // namespace gleaner::worker

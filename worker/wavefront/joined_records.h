#pragma once
// Records of items that yield any number of them, as host threads make them.

#include <cstdint>
#include <map>
#include <mutex>
#include <span>
#include <utility>

#include "scene/model/blob.h"

namespace gleaner::worker {

// Pieces are appended as soon as those before them are: host threads claim items in order, so that next to none waits,
// and no thread copies all of them at the end. Thread-safe.
class JoinedRecords {
 public:
  explicit JoinedRecords(std::uint64_t items) : items_(items) {}

  // Those of `items` items from `first` on; each item once.
  void add(std::uint64_t first, std::uint64_t items, std::span<const std::byte> records) {
    const std::lock_guard lock(mutex_);
    if (first != next_) {
      waiting_.try_emplace(first, items, scene::Bytes(records.begin(), records.end()));
      return;
    }
    append(items, records);
    for (auto piece = waiting_.begin(); piece != waiting_.end() && piece->first == next_; piece = waiting_.erase(piece))
      append(piece->second.first, piece->second.second);
  }

  // All of them, in the items' order. Once.
  scene::Bytes take() { return std::move(joined_); }

 private:
  void append(std::uint64_t items, std::span<const std::byte> records) {
    next_ += items;
    // Room for all, were the rest as many: what is not written to costs no memory.
    const std::size_t bytes = joined_.size() + records.size();
    if (bytes > joined_.capacity())
      joined_.reserve(bytes +
                      static_cast<std::size_t>(1.1 * static_cast<double>(bytes) * static_cast<double>(items_ - next_) /
                                               static_cast<double>(next_)));
    joined_.insert(joined_.end(), records.begin(), records.end());
  }

  std::mutex mutex_;
  std::uint64_t items_, next_ = 0;
  scene::Bytes joined_;
  std::map<std::uint64_t, std::pair<std::uint64_t, scene::Bytes>> waiting_;  // by first item
};

}  // namespace gleaner::worker

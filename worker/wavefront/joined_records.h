#pragma once
// Records of items that yield any number of them, as host threads make them.

#include <algorithm>
#include <cstdint>
#include <mutex>
#include <utility>
#include <vector>

#include "scene/model/blob.h"

namespace gleaner::worker {

class JoinedRecords {
 public:
  // Those of the items from `first` on. Thread-safe.
  void add(std::uint64_t first, scene::Bytes records) {
    const std::lock_guard lock(mutex_);
    pieces_.emplace_back(first, std::move(records));
  }

  // All of them, in the items' order. Once.
  scene::Bytes take() {
    std::ranges::sort(pieces_, {}, &Piece::first);
    std::size_t bytes = 0;
    for (const Piece& piece : pieces_) bytes += piece.second.size();
    scene::Bytes records;
    records.reserve(bytes);
    for (Piece& piece : pieces_) {
      records.insert(records.end(), piece.second.begin(), piece.second.end());
      scene::Bytes().swap(piece.second);
    }
    return records;
  }

 private:
  using Piece = std::pair<std::uint64_t, scene::Bytes>;
  std::mutex mutex_;
  std::vector<Piece> pieces_;
};

}  // namespace gleaner::worker

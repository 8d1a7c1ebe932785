#include "coordinator/schedule/item_pool.h"

#include <algorithm>
#include <cassert>
#include <iterator>

namespace gleaner::coordinator {

bool FailureHistory::by(WorkerId worker) const {
  return std::find(workers.begin(), workers.end(), worker) != workers.end();
}

void FailureHistory::add(WorkerId worker) {
  ++strikes;
  if (!by(worker)) workers.push_back(worker);
}

void ItemPool::put(const Piece& piece) {
  if (piece.count == 0) return;
  items_ += piece.count;
  if (piece.failures.strikes > 0) {
    failed_.emplace(piece.first, piece);
    return;
  }
  [[maybe_unused]] auto [at, fresh] = clean_.emplace(piece.first, piece.count);
  assert(fresh);
  if (const auto after = std::next(at); after != clean_.end() && at->first + at->second == after->first) {
    at->second += after->second;
    clean_.erase(after);
  }
  if (at != clean_.begin()) {
    const auto before = std::prev(at);
    if (before->first + before->second == at->first) {
      before->second += at->second;
      clean_.erase(at);
    }
  }
}

void ItemPool::take(std::uint64_t first, std::uint64_t count) {
  items_ -= count;
  if (const auto at = clean_.find(first); at != clean_.end()) {
    const std::uint64_t left = at->second - count;
    clean_.erase(at);
    if (left > 0) clean_.emplace(first + count, left);
    return;
  }
  const auto at = failed_.find(first);
  assert(at != failed_.end());
  Piece rest = std::move(at->second);
  failed_.erase(at);
  rest.first += count;
  rest.count -= count;
  if (rest.count > 0) failed_.emplace(rest.first, std::move(rest));
}

}  // namespace gleaner::coordinator

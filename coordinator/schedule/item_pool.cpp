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
  if (!piece.failures.clean()) {
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

Piece ItemPool::within(std::uint64_t first, std::uint64_t count, std::uint32_t tile) const {
  auto at = clean_.upper_bound(first);
  if (at != clean_.begin() && std::prev(at)->first + std::prev(at)->second > first) --at;
  for (; at != clean_.end() && at->first < first + count; ++at) {
    const std::uint64_t run_end = at->first + at->second;
    const std::uint64_t begin = (std::max(first, at->first) + tile - 1) / tile * tile;
    std::uint64_t end = std::min(first + count, run_end);
    if (end < run_end) end = end / tile * tile;
    if (begin < end) return {begin, end - begin, {}};
  }
  return {};
}

void ItemPool::take(std::uint64_t first, std::uint64_t count) {
  items_ -= count;
  if (auto at = clean_.upper_bound(first); at != clean_.begin()) {
    --at;
    const std::uint64_t end = at->first + at->second;
    if (first < end) {
      if (at->first < first)
        at->second = first - at->first;
      else
        clean_.erase(at);
      if (first + count < end) clean_.emplace(first + count, end - first - count);
      return;
    }
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

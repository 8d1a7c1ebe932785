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
  std::uint64_t first = piece.first, end = piece.first + piece.count;
  auto after = clean_.lower_bound(first);
  assert(after == clean_.end() || after->first >= end);
  if (after != clean_.begin()) {
    const auto before = std::prev(after);
    if (before->first + before->second == first) {
      first = before->first;
      erase(before);
    }
  }
  if (after != clean_.end() && after->first == end) {
    end += after->second;
    erase(after);
  }
  insert(first, end - first);
}

void ItemPool::insert(std::uint64_t first, std::uint64_t count) {
  clean_.emplace(first, count);
  by_count_.emplace(count, first);
}

void ItemPool::erase(Clean::iterator run) {
  by_count_.erase({run->second, run->first});
  clean_.erase(run);
}

ItemPool::Clean::const_iterator ItemPool::run_of(std::uint64_t item) const {
  const auto after = clean_.upper_bound(item);
  if (after == clean_.begin()) return clean_.end();
  const auto run = std::prev(after);
  return item < run->first + run->second ? run : clean_.end();
}

Piece ItemPool::from(std::uint64_t first) const {
  const auto run = run_of(first);
  if (run == clean_.end()) return {};
  return {first, run->first + run->second - first, {}};
}

Piece ItemPool::longest() const {
  if (by_count_.empty()) return {};
  const auto [count, first] = *by_count_.rbegin();
  return {first, count, {}};
}

Piece ItemPool::within(std::uint64_t first, std::uint64_t count, std::uint32_t tile) const {
  auto at = run_of(first);
  if (at == clean_.end()) at = clean_.upper_bound(first);
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
  if (const auto run = run_of(first); run != clean_.end()) {
    const std::uint64_t begin = run->first, end = run->first + run->second;
    erase(clean_.find(begin));
    if (begin < first) insert(begin, first - begin);
    if (first + count < end) insert(first + count, end - first - count);
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

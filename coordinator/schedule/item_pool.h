#pragma once
// The items of a stage that nobody holds, as intervals.

#include <cstdint>
#include <map>
#include <set>
#include <utility>
#include <vector>

#include "coordinator/schedule/scheduler.h"

namespace gleaner::coordinator {

// What went wrong with a range so far; inherited by its pieces.
struct FailureHistory {
  unsigned strikes = 0;
  std::vector<WorkerId> workers;  // who failed it (or must not have it), each once

  bool clean() const { return strikes == 0 && workers.empty(); }
  bool by(WorkerId worker) const;
  void add(WorkerId worker);
};

struct Piece {
  std::uint64_t first = 0, count = 0;
  FailureHistory failures;
};

class ItemPool {
 public:
  std::uint64_t items() const { return items_; }
  std::size_t pieces() const { return clean_.size() + failed_.size(); }

  void put(const Piece& piece);

  // The piece to serve next: ranges that failed come first, so that a stage that must fail does so early. `may_run` is
  // asked about the failures of a piece. None: count is 0. `looked_at` grows by the pieces seen.
  template <typename MayRun>
  Piece front(const MayRun& may_run, std::uint64_t& looked_at) const {
    for (const auto& [first, piece] : failed_) {
      ++looked_at;
      if (may_run(piece.failures)) return piece;
    }
    ++looked_at;
    if (clean_.empty()) return {};
    return {clean_.begin()->first, clean_.begin()->second, {}};
  }

  // Items of [first, first + count) that nobody failed and that begin at a multiple of `tile`: the first run of them,
  // cut at multiples of `tile` (or where the run itself ends). None: count is 0.
  Piece within(std::uint64_t first, std::uint64_t count, std::uint32_t tile) const;

  // The items that nobody failed from `first` on, up to the next that is not free. None: count is 0.
  Piece from(std::uint64_t first) const;
  // The longest run of items that nobody failed. None: count is 0.
  Piece longest() const;

  // Takes `count` items from `first` on: off the beginning of a piece that failed, from anywhere in one that did not.
  void take(std::uint64_t first, std::uint64_t count);

  // Any piece that failed before, for the one who asks why it waits.
  const Piece* any_failed() const { return failed_.empty() ? nullptr : &failed_.begin()->second; }

 private:
  using Clean = std::map<std::uint64_t, std::uint64_t>;  // first -> count
  void insert(std::uint64_t first, std::uint64_t count);
  void erase(Clean::iterator run);
  Clean::const_iterator run_of(std::uint64_t item) const;

  Clean clean_;                                                 // neighbours are merged
  std::set<std::pair<std::uint64_t, std::uint64_t>> by_count_;  // (count, first) of the same
  std::map<std::uint64_t, Piece> failed_;                       // kept apart: each piece has its own history
  std::uint64_t items_ = 0;
};

}  // namespace gleaner::coordinator

#pragma once
// Where each worker goes on in a stage, so that its batches lie next to each other: what it makes is then one range, or
// few, and so is what it reads of its own items' inputs later.

#include <cstdint>
#include <map>

#include "coordinator/schedule/item_pool.h"

namespace gleaner::coordinator {

class Adjoining {
 public:
  // Free items for the worker: those behind its last ones; else those of the longest free run, but where another
  // worker is about to go on at its beginning, its second half, or its last items where `wanted` ones are more than
  // that. None that nobody failed: count is 0.
  Piece offer(const ItemPool& pool, WorkerId worker, std::uint32_t tile, double wanted) const;
  // The worker got the items before `end`.
  void gave(WorkerId worker, std::uint64_t end);
  // The worker goes on nowhere.
  void forget(WorkerId worker);

 private:
  std::map<WorkerId, std::uint64_t> next_;   // where each goes on
  std::map<std::uint64_t, WorkerId> there_;  // who goes on there
};

}  // namespace gleaner::coordinator

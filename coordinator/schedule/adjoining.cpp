#include "coordinator/schedule/adjoining.h"

#include <algorithm>

namespace gleaner::coordinator {

Piece Adjoining::offer(const ItemPool& pool, WorkerId worker, std::uint32_t tile, double wanted) const {
  if (const auto next = next_.find(worker); next != next_.end())
    if (const Piece behind = pool.from(next->second); behind.count > 0) return behind;
  const Piece run = pool.longest();
  if (!there_.contains(run.first)) return run;
  if (wanted >= static_cast<double>(run.count)) return run;
  // Whole batches: what is left over stays where the other goes on.
  const auto batch = static_cast<std::uint64_t>(std::max(wanted, 1.0));
  const std::uint64_t items = ((run.count + 1) / 2 + batch - 1) / batch * batch;
  if (items >= run.count) return run;
  const std::uint64_t begin = (run.first + run.count - items) / tile * tile;
  return begin > run.first ? pool.from(begin) : run;
}

void Adjoining::gave(WorkerId worker, std::uint64_t end) {
  forget(worker);
  next_[worker] = end;
  there_[end] = worker;
}

void Adjoining::forget(WorkerId worker) {
  const auto next = next_.find(worker);
  if (next == next_.end()) return;
  if (const auto there = there_.find(next->second); there != there_.end() && there->second == worker)
    there_.erase(there);
  next_.erase(next);
}

}  // namespace gleaner::coordinator

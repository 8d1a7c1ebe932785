#include "coordinator/jobs/arrived_records.h"

#include <utility>

namespace gleaner::coordinator {

void ArrivedRecords::put(Batch batch) {
  bytes_ += batch.records.size();
  const std::uint64_t first = batch.first;
  batches_.emplace(first, std::move(batch));
}

std::optional<ArrivedRecords::Batch> ArrivedRecords::next() {
  if (!ready()) return std::nullopt;
  Batch batch = std::move(batches_.begin()->second);
  batches_.erase(batches_.begin());
  given_ += batch.count;
  bytes_ -= batch.records.size();
  return batch;
}

std::uint64_t ArrivedRecords::ready_end() const {
  std::uint64_t end = given_;
  for (auto batch = batches_.find(end); batch != batches_.end(); batch = batches_.find(end)) end += batch->second.count;
  return end;
}

}  // namespace gleaner::coordinator

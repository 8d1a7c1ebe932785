#include "coordinator/artifacts/artifact_data.h"

#include <cstring>

namespace gleaner::coordinator {

namespace {

constexpr std::uint64_t stride = 1024;  // items between two remembered sums

std::uint32_t count_at(const scene::Bytes& counts, std::uint64_t item) {
  std::uint32_t count;
  std::memcpy(&count, counts.data() + item * sizeof count, sizeof count);
  return count;
}

}  // namespace

CountIndex::CountIndex(std::shared_ptr<const scene::Bytes> counts) : counts_(std::move(counts)) {
  const std::uint64_t items = counts_->size() / sizeof(std::uint32_t);
  std::uint64_t sum = 0;
  for (std::uint64_t item = 0; item < items; ++item) {
    if (item % stride == 0) before_.push_back(sum);
    sum += count_at(*counts_, item);
  }
  if (items % stride == 0) before_.push_back(sum);
}

std::uint64_t CountIndex::first_record(std::uint64_t item) const {
  std::uint64_t sum = before_.at(item / stride);
  for (std::uint64_t at = item / stride * stride; at < item; ++at) sum += count_at(*counts_, at);
  return sum;
}

}  // namespace gleaner::coordinator

#include "worker/stages/vpl/rows.h"

#include <algorithm>

#include "kernels/vpl_records.h"
#include "scene/model/order.h"
#include "worker/wavefront/input_rows.h"

namespace gleaner::worker {

std::vector<float> input_rows(const StageTask& task, const std::string& name, std::size_t words) {
  const InputRows input(task, name, words * 4);
  std::vector<float> rows(input.rows() * words);
  input.visit(0, input.rows(), [&](std::uint64_t first, std::span<const std::byte> piece) {
    std::memcpy(&rows[first * words], piece.data(), piece.size());
  });
  return rows;
}

std::size_t random_row(std::size_t k, std::uint64_t key, std::size_t count, std::size_t parts) {
  const double place =
      (static_cast<double>(k) + scene::unit_hash(key)) * static_cast<double>(count) / static_cast<double>(parts);
  return std::min(count - 1, static_cast<std::size_t>(place));
}

bool is_point(const float* row) {
  std::uint32_t triangle = GLEANER_NONE;
  std::memcpy(&triangle, row + POINT_TRIANGLE, 4);
  return triangle != GLEANER_NONE;
}

BatchResult counted_rows(const std::vector<float>& rows, std::size_t words) {
  BatchResult result;
  result.records.resize(rows.size() * 4);
  if (!rows.empty()) std::memcpy(result.records.data(), rows.data(), result.records.size());
  result.counts = {static_cast<std::uint32_t>(rows.size() / words)};
  return result;
}

}  // namespace gleaner::worker

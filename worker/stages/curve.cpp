#include "worker/stages/curve.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <utility>

#include "scene/model/order.h"

namespace gleaner::worker {

std::uint32_t side_of(const float* normal) {
  std::uint32_t axis = 0;
  for (std::uint32_t k = 1; k < 3; ++k)
    if (std::abs(normal[k]) > std::abs(normal[axis])) axis = k;
  return 2 * axis + (normal[axis] < 0 ? 1 : 0);
}

std::vector<std::uint32_t> curve_order(std::span<const float> rows, std::size_t stride, double cells, bool by_side) {
  const std::size_t count = rows.size() / stride;
  std::array<double, 3> lower{1e300, 1e300, 1e300}, upper{-1e300, -1e300, -1e300};
  for (std::size_t i = 0; i < count; ++i)
    for (unsigned k = 0; k < 3; ++k) {
      lower[k] = std::min(lower[k], double{rows[i * stride + k]});
      upper[k] = std::max(upper[k], double{rows[i * stride + k]});
    }
  double edge = 1e-30;
  for (unsigned k = 0; k < 3; ++k) edge = std::max(edge, upper[k] - lower[k]);
  std::vector<std::pair<std::uint64_t, std::uint32_t>> keys(count);
  for (std::size_t i = 0; i < count; ++i) {
    const float* row = &rows[i * stride];
    std::array<std::uint32_t, 3> cell{};
    for (unsigned k = 0; k < 3; ++k)
      cell[k] = static_cast<std::uint32_t>(std::clamp((row[k] - lower[k]) / edge * cells, 0.0, 1023.0));
    const std::uint64_t side = by_side ? side_of(row + 3) : 0;
    keys[i] = {side << 32 | scene::morton(cell), static_cast<std::uint32_t>(i)};
  }
  std::sort(keys.begin(), keys.end());
  std::vector<std::uint32_t> order(count);
  std::ranges::transform(keys, order.begin(), [](const auto& key) { return key.second; });
  return order;
}

}  // namespace gleaner::worker

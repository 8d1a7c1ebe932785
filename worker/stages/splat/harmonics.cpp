#include "worker/stages/splat/harmonics.h"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace gleaner::worker {

void hemispherical_harmonics(std::uint32_t order, double z, std::span<double> values) {
  const double x = 2 * z - 1, sine = 2 * std::sqrt(std::max(0.0, z * (1 - z)));
  const auto at = [&](std::uint32_t l, std::uint32_t m) -> double& { return values[l * (l + 1) / 2 + m]; };
  // Associated Legendre functions by the usual recurrences, without the sign (-1)^m.
  double diagonal = 1;
  for (std::uint32_t m = 0; m < order; ++m) {
    at(m, m) = diagonal;
    if (m + 1 < order) at(m + 1, m) = x * (2 * m + 1) * diagonal;
    for (std::uint32_t l = m + 2; l < order; ++l)
      at(l, m) = ((2 * l - 1) * x * at(l - 1, m) - (l + m - 1) * at(l - 2, m)) / (l - m);
    diagonal *= (2 * m + 1) * sine;
  }
  for (std::uint32_t l = 0; l < order; ++l) {
    double ratio = 1;  // (l - m)! / (l + m)!
    for (std::uint32_t m = 0; m <= l; ++m) {
      if (m > 0) ratio /= static_cast<double>(l - m + 1) * (l + m);
      at(l, m) *= std::sqrt((m > 0 ? 2 : 1) * (2 * l + 1) * ratio / (2 * std::numbers::pi));
    }
  }
}

}  // namespace gleaner::worker

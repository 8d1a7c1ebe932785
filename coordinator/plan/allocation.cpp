#include "coordinator/plan/allocation.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>

namespace gleaner::coordinator {

std::vector<float> neighbours_variance(const PixelNoise& noise, int radius) {
  const std::size_t w = noise.width, h = noise.height;
  // Sums over windows from a summed-area table.
  std::vector<double> table((w + 1) * (h + 1), 0.0);
  for (std::size_t y = 0; y < h; ++y) {
    double row = 0;
    for (std::size_t x = 0; x < w; ++x) {
      row += noise.chunk_variance[y * w + x];
      table[(y + 1) * (w + 1) + x + 1] = table[y * (w + 1) + x + 1] + row;
    }
  }
  std::vector<float> result(w * h);
  const std::size_t r = static_cast<std::size_t>(radius);
  for (std::size_t y = 0; y < h; ++y)
    for (std::size_t x = 0; x < w; ++x) {
      const std::size_t x0 = x >= r ? x - r : 0, x1 = std::min(x + r + 1, w);
      const std::size_t y0 = y >= r ? y - r : 0, y1 = std::min(y + r + 1, h);
      const double others = static_cast<double>((x1 - x0) * (y1 - y0) - 1);
      const double sum = table[y1 * (w + 1) + x1] - table[y0 * (w + 1) + x1] - table[y1 * (w + 1) + x0] +
                         table[y0 * (w + 1) + x0] - noise.chunk_variance[y * w + x];
      // A picture of one pixel has no neighbours; any number serves, as nothing competes with it.
      result[y * w + x] = others > 0 ? static_cast<float>(std::max(0.0, sum / others)) : 1.0f;
    }
  return result;
}

std::vector<std::uint32_t> allocate_chunks(const std::vector<float>& variance, const std::vector<std::uint32_t>& chunks,
                                           std::uint64_t extra) {
  const std::size_t n = variance.size();
  std::vector<std::uint32_t> more(n, 0);
  if (extra == 0 || n == 0) return more;
  std::vector<float> deviation(n);
  double largest = 0;
  for (std::size_t i = 0; i < n; ++i) {
    deviation[i] = std::sqrt(variance[i]);
    largest = std::max(largest, static_cast<double>(deviation[i]));
  }
  if (!(largest > 0)) {
    // Nothing is known to be noisy: evenly.
    for (std::size_t i = 0; i < n; ++i) more[i] = static_cast<std::uint32_t>(extra * (i + 1) / n - extra * i / n);
    return more;
  }
  // The scale at which max(0, scale * deviation - chunks) sums to `extra`, by bisection: the sum grows with the scale.
  const auto wanted = [&](double scale) {
    double sum = 0;
    for (std::size_t i = 0; i < n; ++i) sum += std::max(0.0, scale * deviation[i] - chunks[i]);
    return sum;
  };
  double low = 0, high = 1 / largest;
  while (wanted(high) < static_cast<double>(extra)) high *= 2;
  for (int step = 0; step < 60; ++step) {
    const double middle = (low + high) / 2;
    (wanted(middle) < static_cast<double>(extra) ? low : high) = middle;
  }
  double carried = 0;
  std::uint64_t given = 0;
  for (std::size_t i = 0; i < n && given < extra; ++i) {
    carried += std::max(0.0, high * deviation[i] - chunks[i]);
    const auto whole = static_cast<std::uint64_t>(std::max(0.0, std::floor(carried + 1e-9)));
    const std::uint64_t take =
        std::min<std::uint64_t>({whole, extra - given, std::numeric_limits<std::uint32_t>::max()});
    more[i] = static_cast<std::uint32_t>(take);
    carried -= static_cast<double>(take);
    given += take;
  }
  // What the last rounding left over goes to the noisiest pixel.
  if (given < extra)
    more[static_cast<std::size_t>(std::max_element(deviation.begin(), deviation.end()) - deviation.begin())] +=
        static_cast<std::uint32_t>(extra - given);
  return more;
}

}  // namespace gleaner::coordinator

#include "coordinator/plan/allocation.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <string>
#include <utility>

#include "scene/model/error.h"

namespace gleaner::coordinator {

namespace {

// Of edges' variance, what counts. Measured on two Cornell boxes at 8 to 24 samples: enough for a lamp's edge to be
// found whatever the luck, next to nothing for texture.
constexpr float kEdge = 0.03f;

}  // namespace

std::vector<float> neighbours_variance(const PixelNoise& noise, int radius) {
  const std::size_t w = noise.width, h = noise.height;
  // Sums over windows from a summed-area table for each colour.
  std::vector<double> tables[2];
  for (std::size_t color = 0; color < 2; ++color) {
    std::vector<double>& table = tables[color];
    table.assign((w + 1) * (h + 1), 0.0);
    for (std::size_t y = 0; y < h; ++y) {
      double row = 0;
      for (std::size_t x = 0; x < w; ++x) {
        if ((x + y) % 2 == color) row += noise.chunk_variance[y * w + x];
        table[(y + 1) * (w + 1) + x + 1] = table[y * (w + 1) + x + 1] + row;
      }
    }
  }
  std::vector<float> result(w * h);
  const std::size_t r = static_cast<std::size_t>(radius);
  for (std::size_t y = 0; y < h; ++y)
    for (std::size_t x = 0; x < w; ++x) {
      const std::size_t x0 = x >= r ? x - r : 0, x1 = std::min(x + r + 1, w);
      const std::size_t y0 = y >= r ? y - r : 0, y1 = std::min(y + r + 1, h);
      const std::size_t other = (x + y + 1) % 2, area = (x1 - x0) * (y1 - y0);
      // A window of odd area has one more of its corner's colour.
      const auto count = static_cast<double>((x0 + y0) % 2 == other ? (area + 1) / 2 : area / 2);
      const std::vector<double>& table = tables[other];
      const double sum =
          table[y1 * (w + 1) + x1] - table[y0 * (w + 1) + x1] - table[y1 * (w + 1) + x0] + table[y0 * (w + 1) + x0];
      result[y * w + x] = count > 0 ? static_cast<float>(std::max(0.0, sum / count)) : 1.0f;
    }
  return result;
}

std::vector<float> edge_variance(const PixelNoise& noise) {
  const std::size_t w = noise.width, h = noise.height;
  std::vector<float> result(w * h, 0.0f);
  if (noise.mean.empty()) return result;
  for (std::size_t y = 0; y < h; ++y)
    for (std::size_t x = 0; x < w; ++x) {
      const float* at = &noise.mean[y * w + x];
      double sum = 0, square = 0;
      int count = 0;
      const auto add = [&](bool there, std::ptrdiff_t step) {
        if (!there) return;
        const double value = at[step];
        sum += value;
        square += value * value;
        ++count;
      };
      add(x > 0, -1);
      add(x + 1 < w, 1);
      add(y > 0, -static_cast<std::ptrdiff_t>(w));
      add(y + 1 < h, static_cast<std::ptrdiff_t>(w));
      if (count < 2) continue;
      const double variance = std::max(0.0, square / count - sum / count * (sum / count));
      if (std::isfinite(variance)) result[y * w + x] = static_cast<float>(variance / noise.chunk_samples);
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
    if (!(variance[i] >= 0) || !std::isfinite(variance[i]))
      throw Error::failed("sample allocation: pixel " + std::to_string(i) + " has variance " +
                          std::to_string(variance[i]) + ", expected a finite number that is not negative");
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
  // A double's range is doubled through in this many steps, and halved to a billionth in fewer.
  constexpr int kMostSteps = 2200;
  for (int step = 0; step < kMostSteps && wanted(high) < static_cast<double>(extra); ++step) high *= 2;
  // What is left of the interval moves less than a chunk in all.
  for (int step = 0; step < kMostSteps && high - low > high * 1e-9; ++step) {
    const double middle = (low + high) / 2;
    (wanted(middle) < static_cast<double>(extra) ? low : high) = middle;
  }
  std::uint64_t given = 0;
  for (std::size_t i = 0; i < n; ++i) {
    const double share = std::clamp(std::floor(high * deviation[i] - chunks[i]), 0.0, static_cast<double>(extra));
    more[i] = static_cast<std::uint32_t>(std::min<std::uint64_t>(
        {static_cast<std::uint64_t>(share), extra - given, std::numeric_limits<std::uint32_t>::max()}));
    given += more[i];
  }
  // One more chunk takes v / c - v / (c + 1) off.
  const auto gain = [&](std::size_t i) {
    const double c = static_cast<double>(chunks[i]) + more[i];
    return c > 0 ? variance[i] / (c * (c + 1)) : std::numeric_limits<double>::infinity();
  };
  std::vector<std::pair<double, std::size_t>> best(n);
  for (std::size_t i = 0; i < n; ++i) best[i] = {-gain(i), i};
  const auto rest = static_cast<std::size_t>(std::min<std::uint64_t>(extra - given, n));
  std::nth_element(best.begin(), best.begin() + static_cast<std::ptrdiff_t>(rest), best.end());
  for (std::size_t k = 0; k < rest; ++k) ++more[best[k].second];
  // Shares below one each and their sum leave less than n; what the bisection's own rounding adds is next to nothing.
  more[static_cast<std::size_t>(std::max_element(deviation.begin(), deviation.end()) - deviation.begin())] +=
      static_cast<std::uint32_t>(extra - given - rest);
  return more;
}

std::vector<std::uint32_t> allocate_by_noise(const PixelNoise& noise, const std::vector<std::uint32_t>& chunks,
                                             std::uint64_t extra, int radius) {
  std::vector<float> variance = neighbours_variance(noise, radius);
  const std::vector<float> edges = edge_variance(noise);
  const std::size_t n = variance.size();
  for (std::size_t i = 0; i < n; ++i) variance[i] += kEdge * edges[i];
  std::vector<std::uint32_t> more(n, 0);
  std::uint64_t left = extra;
  for (std::size_t color : {1u, 0u}) {
    std::vector<std::size_t> pixels;
    for (std::size_t i = 0; i < n; ++i)
      if ((i % noise.width + i / noise.width) % 2 == color) pixels.push_back(i);
    std::vector<float> of_color;
    std::vector<std::uint32_t> have;
    for (const std::size_t i : pixels) of_color.push_back(variance[i]), have.push_back(chunks[i]);
    // The corner's colour, of which there is never less, takes what the division leaves.
    const std::uint64_t part = color ? extra / n * pixels.size() + extra % n * pixels.size() / n : left;
    left -= part;
    const std::vector<std::uint32_t> given = allocate_chunks(of_color, have, part);
    for (std::size_t k = 0; k < pixels.size(); ++k) more[pixels[k]] = given[k];
  }
  return more;
}

}  // namespace gleaner::coordinator

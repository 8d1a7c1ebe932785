#include "coordinator/plan/allocation.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
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
  const std::size_t r = static_cast<std::size_t>(radius);
  // Sums over windows from a summed-area table for each colour, of which only a window's rows are held.
  const std::size_t held_rows = 2 * r + 2;
  std::vector<double> tables[2];
  for (std::vector<double>& table : tables) table.assign(held_rows * (w + 1), 0.0);
  const auto row_of = [&](std::size_t color, std::size_t y) { return &tables[color][y % held_rows * (w + 1)]; };
  std::size_t rows = 0;  // of pixels that the tables sum
  const auto sum_to = [&](std::size_t end) {
    for (; rows < end; ++rows)
      for (std::size_t color = 0; color < 2; ++color) {
        const double* above = row_of(color, rows);
        double* table = row_of(color, rows + 1);
        double row = 0;
        for (std::size_t x = 0; x < w; ++x) {
          if ((x + rows) % 2 == color) row += noise.chunk_variance[rows * w + x];
          table[x + 1] = above[x + 1] + row;
        }
      }
  };
  std::vector<float> result(w * h);
  for (std::size_t y = 0; y < h; ++y) {
    const std::size_t y0 = y >= r ? y - r : 0, y1 = std::min(y + r + 1, h);
    sum_to(y1);
    for (std::size_t x = 0; x < w; ++x) {
      const std::size_t x0 = x >= r ? x - r : 0, x1 = std::min(x + r + 1, w);
      const std::size_t other = (x + y + 1) % 2, area = (x1 - x0) * (y1 - y0);
      // A window of odd area has one more of its corner's colour.
      const auto count = static_cast<double>((x0 + y0) % 2 == other ? (area + 1) / 2 : area / 2);
      const double *low = row_of(other, y0), *high = row_of(other, y1);
      const double sum = high[x1] - low[x1] - high[x0] + low[x0];
      result[y * w + x] = count > 0 ? static_cast<float>(std::max(0.0, sum / count)) : 1.0f;
    }
  }
  return result;
}

double sample_error(const PixelNoise& noise, int radius) {
  if (noise.chunks.empty() || *std::ranges::min_element(noise.chunks) < 2) return 0;
  double sum = 0;
  for (const float variance : neighbours_variance(noise, radius)) sum += std::sqrt(double{variance});
  return sum / static_cast<double>(noise.chunks.size()) * std::sqrt(double{noise.chunk_samples});
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

namespace {

// allocate_chunks() among some pixels: `more` of the others stays.
class ChunkAllocation {
 public:
  ChunkAllocation(const std::vector<float>& variance, const std::vector<std::uint32_t>& chunks,
                  std::vector<std::uint32_t> pixels, std::vector<std::uint32_t>& more)
      : variance_(variance), chunks_(chunks), pixels_(std::move(pixels)), more_(more), deviation_(pixels_.size()) {
    for (std::size_t i = 0; i < pixels_.size(); ++i) {
      const float of_pixel = variance_[pixels_[i]];
      if (!(of_pixel >= 0) || !std::isfinite(of_pixel))
        throw Error::failed("sample allocation: pixel " + std::to_string(pixels_[i]) + " has variance " +
                            std::to_string(of_pixel) + ", expected a finite number that is not negative");
      deviation_[i] = std::sqrt(of_pixel);
      largest_ = std::max(largest_, static_cast<double>(deviation_[i]));
    }
  }

  void give(std::uint64_t extra) {
    const std::size_t n = pixels_.size();
    if (extra == 0 || n == 0) return;
    if (!(largest_ > 0)) {
      // Nothing is known to be noisy: evenly.
      for (std::size_t i = 0; i < n; ++i)
        more_[pixels_[i]] = static_cast<std::uint32_t>(extra * (i + 1) / n - extra * i / n);
      return;
    }
    give_rest(extra - give_shares(extra));
  }

 private:
  // What max(0, scale * deviation - chunks) sums to.
  double wanted(double scale) const {
    double sum = 0;
    for (std::size_t i = 0; i < pixels_.size(); ++i) sum += std::max(0.0, scale * deviation_[i] - chunks_[pixels_[i]]);
    return sum;
  }

  // The scale at which that is `extra`, by bisection: the sum grows with the scale. Returns how many were given, of
  // shares that are rounded down.
  std::uint64_t give_shares(std::uint64_t extra) {
    double low = 0, high = 1 / largest_;
    // A double's range is doubled through in this many steps, and halved to a billionth in fewer.
    constexpr int kMostSteps = 2200;
    for (int step = 0; step < kMostSteps && wanted(high) < static_cast<double>(extra); ++step) high *= 2;
    // What is left of the interval moves less than a chunk in all.
    for (int step = 0; step < kMostSteps && high - low > high * 1e-9; ++step) {
      const double middle = (low + high) / 2;
      (wanted(middle) < static_cast<double>(extra) ? low : high) = middle;
    }
    std::uint64_t given = 0;
    for (std::size_t i = 0; i < pixels_.size(); ++i) {
      const double share =
          std::clamp(std::floor(high * deviation_[i] - chunks_[pixels_[i]]), 0.0, static_cast<double>(extra));
      const auto of_pixel = static_cast<std::uint32_t>(std::min<std::uint64_t>(
          {static_cast<std::uint64_t>(share), extra - given, std::numeric_limits<std::uint32_t>::max()}));
      more_[pixels_[i]] = of_pixel;
      given += of_pixel;
    }
    return given;
  }

  // One chunk more takes v / c - v / (c + 1) off.
  double gain(std::uint32_t pixel) const {
    const double c = static_cast<double>(chunks_[pixel]) + more_[pixel];
    return c > 0 ? variance_[pixel] / (c * (c + 1)) : std::numeric_limits<double>::infinity();
  }

  void give_rest(std::uint64_t rest) {
    // Shares below one each and their sum leave less than a chunk a pixel; what the bisection's own rounding adds is
    // next to nothing, and goes where the noise is largest.
    const std::uint32_t noisiest =
        pixels_[static_cast<std::size_t>(std::ranges::max_element(deviation_) - deviation_.begin())];
    const std::uint64_t singles = std::min<std::uint64_t>(rest, pixels_.size());
    std::ranges::nth_element(pixels_, pixels_.begin() + static_cast<std::ptrdiff_t>(singles),
                             [&](std::uint32_t a, std::uint32_t b) {
                               const double gain_a = gain(a), gain_b = gain(b);
                               return gain_a != gain_b ? gain_a > gain_b : a < b;
                             });
    for (std::uint64_t k = 0; k < singles; ++k) ++more_[pixels_[k]];
    more_[noisiest] += static_cast<std::uint32_t>(rest - singles);
  }

  const std::vector<float>& variance_;
  const std::vector<std::uint32_t>& chunks_;
  std::vector<std::uint32_t> pixels_;
  std::vector<std::uint32_t>& more_;
  std::vector<float> deviation_;
  double largest_ = 0;
};

}  // namespace

std::vector<std::uint32_t> allocate_chunks(const std::vector<float>& variance, const std::vector<std::uint32_t>& chunks,
                                           std::uint64_t extra) {
  std::vector<std::uint32_t> more(variance.size(), 0), pixels(variance.size());
  std::iota(pixels.begin(), pixels.end(), 0u);
  ChunkAllocation(variance, chunks, std::move(pixels), more).give(extra);
  return more;
}

Allocation allocate_by_noise(PixelNoise noise, std::uint64_t extra, int radius) {
  // A film may be large: what is not needed any more is freed (`= {}` would keep a vector's memory).
  std::vector<float> variance = neighbours_variance(noise, radius);
  noise.chunk_variance = std::vector<float>();
  {
    const std::vector<float> edges = edge_variance(noise);
    for (std::size_t i = 0; i < variance.size(); ++i) variance[i] += kEdge * edges[i];
  }
  noise.mean = std::vector<float>();
  const std::size_t n = variance.size();
  Allocation out{std::vector<std::uint32_t>(n, 0), std::move(noise.chunks)};
  std::uint64_t left = extra;
  for (std::size_t color : {1u, 0u}) {
    std::vector<std::uint32_t> pixels;
    pixels.reserve(n / 2 + 1);
    for (std::size_t i = 0; i < n; ++i)
      if ((i % noise.width + i / noise.width) % 2 == color) pixels.push_back(static_cast<std::uint32_t>(i));
    // The corner's colour, of which there is never less, takes what the division leaves.
    const std::uint64_t part = color ? extra / n * pixels.size() + extra % n * pixels.size() / n : left;
    left -= part;
    ChunkAllocation(variance, out.chunks, std::move(pixels), out.more).give(part);
  }
  return out;
}

}  // namespace gleaner::coordinator

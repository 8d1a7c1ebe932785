#include "worker/denoise/blend.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <functional>
#include <numbers>
#include <numeric>
#include <thread>

#include "worker/wavefront/run_threads.h"

namespace gleaner::worker {
namespace {

// Pixels. Squared errors of single pixels have a standard deviation larger than themselves: the choice rests on
// some hundred neighbours, and what is told of the picture on more.
constexpr double kChoiceRadius = 4, kErrorRadius = 8;
constexpr double kErrorNeighbours = 4 * std::numbers::pi * kErrorRadius * kErrorRadius;
// How far the halves' pictures are apart is less noisy.
constexpr double kVarianceRadius = 2;
// What the picture's variance says of a place is not made smaller than by this.
constexpr double kLeastFactor = 0.25;
// What a denoiser is off by, its neighbours share: blocks of this size are taken for independent of each other. Small
// pictures have smaller ones, so that there are some.
std::uint32_t block_of(std::uint32_t width, std::uint32_t height) {
  return std::clamp(std::min(width, height) / 8, 8u, 32u);
}

using Plane = std::vector<float>;

std::vector<float> gaussian(double sigma) {
  const int radius = static_cast<int>(std::ceil(3 * sigma));
  std::vector<float> weights(static_cast<std::size_t>(2 * radius + 1));
  for (int i = -radius; i <= radius; ++i)
    weights[static_cast<std::size_t>(i + radius)] = static_cast<float>(std::exp(-0.5 * i * i / (sigma * sigma)));
  return weights;
}

// For each of `length` places, the sum of the weights of its neighbours that exist.
Plane sums_of_weights(std::size_t length, const std::vector<float>& weights) {
  const std::size_t radius = weights.size() / 2;
  Plane sums(length);
  for (std::size_t i = 0; i < length; ++i)
    for (std::size_t k = i < radius ? 0 : i - radius; k <= std::min(length - 1, i + radius); ++k)
      sums[i] += weights[k + radius - i];
  return sums;
}

// Adds `weight` times the values that lie `step` behind (before, where it is negative) each place, where there are
// some.
void add_shifted(float* to, const float* from, std::size_t length, std::ptrdiff_t step, float weight) {
  const auto end = static_cast<std::ptrdiff_t>(length);
  for (std::ptrdiff_t i = std::max<std::ptrdiff_t>(0, -step); i < std::min(end, end - step); ++i)
    to[i] += weight * from[i + step];
}

// Rows a thread has at least: below that starting it takes longer.
constexpr std::uint32_t kLeastRows = 32;

// Calls run(first, last) for shares of the rows, side by side.
template <typename Run>
void for_rows(std::uint32_t height, Run run) {
  const std::uint32_t threads = std::clamp(height / kLeastRows, 1u, std::max(1u, std::thread::hardware_concurrency()));
  const auto row = [&](std::uint64_t k) { return static_cast<std::uint32_t>(height * k / threads); };
  run_threads(threads, [&](unsigned k) { run(row(k), row(k + 1)); });
}

// Each pixel becomes the weighted mean of its neighbours that exist.
void smooth(Plane& plane, std::uint32_t width, std::uint32_t height, double sigma) {
  const std::vector<float> weights = gaussian(sigma);
  const auto radius = static_cast<std::ptrdiff_t>(weights.size() / 2);
  const Plane in_row = sums_of_weights(width, weights), in_column = sums_of_weights(height, weights);
  const auto weight = [&](std::ptrdiff_t step) { return weights[static_cast<std::size_t>(step + radius)]; };
  Plane from(plane.size());
  from.swap(plane);
  for_rows(height, [&](std::uint32_t first, std::uint32_t last) {
    for (std::size_t row = std::size_t{first} * width; row < std::size_t{last} * width; row += width) {
      for (std::ptrdiff_t step = -radius; step <= radius; ++step)
        add_shifted(&plane[row], &from[row], width, step, weight(step));
      for (std::uint32_t x = 0; x < width; ++x) plane[row + x] /= in_row[x];
    }
  });
  from.assign(plane.size(), 0);
  from.swap(plane);
  for_rows(height, [&](std::ptrdiff_t first, std::ptrdiff_t last) {
    for (std::ptrdiff_t y = first; y < last; ++y) {
      float* const row = &plane[static_cast<std::size_t>(y) * width];
      for (std::ptrdiff_t k = std::max<std::ptrdiff_t>(0, y - radius);
           k <= std::min<std::ptrdiff_t>(height - 1, y + radius); ++k)
        add_shifted(row, &from[static_cast<std::size_t>(k) * width], width, 0, weight(k - y));
      for (std::uint32_t x = 0; x < width; ++x) row[x] /= in_column[static_cast<std::size_t>(y)];
    }
  });
}

// Estimates without bias, each by itself as noisy as a pixel: squared error of the denoised picture and of the raw one,
// and the product of their errors, means over the channels.
struct Errors {
  Plane denoised, raw, both;
};

// With truth u, raw halves A and B (weights a + b = 1 by their samples), denoised halves f(A) and f(B), and d = A - B,
// independence gives, in expectation:
//   var A = b d^2, var B = a d^2
//   (f(A) - u)^2 = (f(A) - B)^2 - var B
//   (f(A) - u) (A - u) = (f(A) - B) d - var B
//   (f(A) - u) (f(B) - u) = ((f(A) - u)^2 + (f(B) - u)^2 - (f(A) - f(B))^2) / 2
// and from these the errors of a f(A) + b f(B) and of a A + b B.
Errors errors_of(const Halves& h) {
  const std::size_t pixels = std::size_t{h.width} * h.height;
  Errors errors{Plane(pixels), Plane(pixels), Plane(pixels)};
  for (std::size_t i = 0; i < pixels; ++i) {
    const double a = h.share[i], b = 1 - a;
    double denoised = 0, raw = 0, both = 0;
    for (std::size_t k = 3 * i; k < 3 * i + 3; ++k) {
      const double first = h.first[k], second = h.second[k], d = first - second;
      const double f_first = h.denoised_first[k], f_second = h.denoised_second[k], f_d = f_first - f_second;
      const double of_first = (f_first - second) * (f_first - second) - a * d * d;
      const double of_second = (f_second - first) * (f_second - first) - b * d * d;
      denoised += a * of_first + b * of_second - a * b * f_d * f_d;
      raw += a * b * d * d;
      both += a * a * ((f_first - second) * d - a * d * d) - b * b * ((f_second - first) * d + b * d * d);
    }
    errors.denoised[i] = static_cast<float>(denoised / 3);
    errors.raw[i] = static_cast<float>(raw / 3);
    errors.both[i] = static_cast<float>(both / 3);
  }
  return errors;
}

// A few pixels with a rare bright sample may decide the mean of such estimates. Values are cut to a bound, such that
// none has more than one part in kOutliers of what they all scatter: the mean is then almost as sure as one of values
// without rare large ones (Catoni 2012, "Challenging the empirical mean and empirical variance").
constexpr std::size_t kOutliers = 10;

void cut_outliers(Plane& values) {
  std::vector<double> squares(values.begin(), values.end());
  for (double& value : squares) value *= value;
  const std::size_t most = std::min(kOutliers, squares.size());
  std::ranges::partial_sort(squares, squares.begin() + static_cast<std::ptrdiff_t>(most), std::greater());
  double sum = std::accumulate(squares.begin(), squares.end(), 0.0);
  // The bound b for which the sum of min(value^2, b^2) is kOutliers b^2, where some values are beyond it.
  for (std::size_t beyond = 0; beyond < most; sum -= squares[beyond++]) {
    const double bound = sum / static_cast<double>(kOutliers - beyond);
    if (squares[beyond] > bound) continue;
    const auto limit = static_cast<float>(std::sqrt(bound));
    for (float& value : values) value = std::clamp(value, -limit, limit);
    return;
  }
}

double smooth_step(double t) {
  t = std::clamp(t, 0.0, 1.0);
  return t * t * (3 - 2 * t);
}

// The share of the denoised picture: all or nothing, since the estimates say which of the two is better with more
// certainty than how much of each were best, and with a way between, so that no border is seen. Among pixels as noisy
// as they are bright the samples must be far better (four times): there they are specks, which people see before they
// see what a denoiser is off by. `noise`: raw deviation over brightness.
double denoised_share(double denoised, double raw, double noise) {
  if (!(raw > 0)) return 0;  // no noise was seen
  const double patience = 1 + 3 * smooth_step((noise - 0.1) / 0.2);
  return smooth_step(2 - denoised / (0.75 * patience * raw));
}

// Mean over the channels of the denoised picture, which is less noisy.
Plane brightness_of(const Halves& h) {
  Plane brightness(h.share.size());
  for (std::size_t i = 0; i < brightness.size(); ++i)
    for (std::size_t k = 3 * i; k < 3 * i + 3; ++k)
      brightness[i] += (h.share[i] * h.denoised_first[k] + (1 - h.share[i]) * h.denoised_second[k]) / 3;
  return brightness;
}

// Which pixels speak for each other: those of like brightness. A window and the bars in it, or a lamp and the ceiling
// beside it, are off by amounts of other sizes, and what is best for one is not for the other.
constexpr std::array kBrightness = {0.125, 0.5, 2.0, 8.0};  // of the picture's mean

std::vector<std::uint8_t> classes_of(const Plane& brightness) {
  const double mean =
      std::accumulate(brightness.begin(), brightness.end(), 0.0) / static_cast<double>(brightness.size());
  std::vector<std::uint8_t> classes(brightness.size());
  for (std::size_t i = 0; i < brightness.size(); ++i)
    classes[i] = static_cast<std::uint8_t>(
        std::ranges::count_if(kBrightness, [&](double bound) { return brightness[i] >= bound * mean; }));
  return classes;
}

// Pixels that a smoothed plane sums, and as how many of a class its ratio all over the picture counts: where few
// neighbours are of a pixel's class, they say little.
constexpr double kNeighbours = 4 * std::numbers::pi * kChoiceRadius * kChoiceRadius, kPrior = 32;

// A pixel's share, by what its neighbours of its class say.
Plane denoised_shares(const Halves& h, const Errors& errors) {
  const Plane brightness = brightness_of(h);
  const std::vector<std::uint8_t> classes = classes_of(brightness);
  Plane shares(classes.size());
  for (std::size_t number = 0; number <= kBrightness.size(); ++number) {
    Plane denoised(classes.size()), raw(classes.size()), light(classes.size()), members(classes.size());
    double all_denoised = 0, all_raw = 0, all = 0;
    for (std::size_t i = 0; i < classes.size(); ++i) {
      if (classes[i] != number) continue;
      all_denoised += denoised[i] = errors.denoised[i];
      all_raw += raw[i] = errors.raw[i];
      light[i] = brightness[i];
      all += members[i] = 1;
    }
    if (!(all > 0)) continue;
    for (Plane* plane : {&denoised, &raw, &light, &members}) smooth(*plane, h.width, h.height, kChoiceRadius);
    const double prior = all_raw > 0 ? std::clamp(all_denoised / all_raw, 0.0, 1.0) : 1;
    for (std::size_t i = 0; i < classes.size(); ++i)
      if (classes[i] == number) {
        const double others = kPrior / (kNeighbours * members[i]) * raw[i];
        const double noise = light[i] > 0 ? std::sqrt(raw[i] * members[i]) / light[i] : 0;
        shares[i] = static_cast<float>(denoised_share(denoised[i] + prior * others, raw[i] + others, noise));
      }
  }
  return shares;
}

// The deviation of the mean of `values`, from how blocks differ from the next one: what changes slowly over the picture
// is no noise.
double deviation_of_mean(const Plane& values, std::uint32_t width, std::uint32_t height) {
  const std::uint32_t block = block_of(width, height);
  const std::uint32_t columns = (width + block - 1) / block, rows = (height + block - 1) / block;
  std::vector<double> sums(std::size_t{columns} * rows);
  for (std::uint32_t y = 0; y < height; ++y)
    for (std::uint32_t x = 0; x < width; ++x)
      sums[std::size_t{y / block} * columns + x / block] += values[std::size_t{y} * width + x];
  double squares = 0;
  std::size_t pairs = 0;
  for (std::uint32_t y = 0; y < rows; ++y)
    for (std::uint32_t x = 0; x + 1 < columns; ++x, ++pairs) {
      const double step = sums[std::size_t{y} * columns + x + 1] - sums[std::size_t{y} * columns + x];
      squares += step * step / 2;
    }
  const auto pixels = static_cast<double>(values.size());
  // A single column of blocks has no neighbours: the estimate may be off by itself.
  if (pairs == 0) return std::abs(std::accumulate(sums.begin(), sums.end(), 0.0)) / pixels;
  return std::sqrt(squares / static_cast<double>(pairs) * static_cast<double>(sums.size())) / pixels;
}

}  // namespace

// The squared error that the layer shows, from what pixels tell of it without bias, each as noisy as it is large, and
// from how far the two halves' pictures are apart: the picture's variance, which is never below 0, shows edges and
// specks sharply, and knows nothing of what both halves are off by. So it is scaled to the estimate's total, and
// locally by as much of the estimate over some hundred neighbours as is no noise (James & Stein 1961).
Plane error_layer(const Halves& h, const Plane& estimates, const Plane& variance) {
  const auto sum = [](const Plane& plane) { return std::accumulate(plane.begin(), plane.end(), 0.0); };
  const auto smoothed = [&](Plane plane, double radius) {
    smooth(plane, h.width, h.height, radius);
    return plane;
  };
  const double told = sum(estimates), varied = sum(variance);
  const Plane estimate = smoothed(estimates, kErrorRadius), near = smoothed(variance, kErrorRadius);
  Plane layer = smoothed(variance, kVarianceRadius), squares = estimates;
  for (float& value : squares) value *= value;
  smooth(squares, h.width, h.height, kErrorRadius);
  // Both halves are off by as much as their mean at least.
  const double scale = varied > 0 ? std::max(1.0, told / varied) : 1;
  // The estimate over what is expected, and the square of its own deviation over that.
  const auto ratio = [&](std::size_t i) { return estimate[i] / (scale * near[i]); };
  const auto noise = [&](std::size_t i) { return squares[i] / (kErrorNeighbours * std::pow(scale * near[i], 2)); };
  double differences = 0, weights = 0;
  for (std::size_t i = 0; i < layer.size(); ++i) {
    if (!(near[i] > 0)) continue;
    const double n = noise(i), weight = 1 / std::pow(1 + n, 2);
    differences += weight * (std::pow(ratio(i) - 1, 2) - n);
    weights += weight;
  }
  const double signal = weights > 0 ? std::max(0.0, differences / weights) : 0;
  for (std::size_t i = 0; i < layer.size(); ++i) {
    if (!(near[i] > 0)) {
      layer[i] = std::max(estimate[i], 0.0f);
      continue;
    }
    const double share = signal / std::max(signal + noise(i), 1e-30);
    layer[i] *= static_cast<float>(scale * std::max(kLeastFactor, 1 + share * (ratio(i) - 1)));
  }
  const double wanted = std::max(told, varied), shown = sum(layer);
  if (shown > 0)
    for (float& value : layer) value *= static_cast<float>(wanted / shown);
  return layer;
}

BlendedPicture blend(const Halves& h) {
  const std::size_t pixels = std::size_t{h.width} * h.height;
  const Errors errors = errors_of(h);
  const Plane shares = denoised_shares(h, errors);
  BlendedPicture picture{std::vector<float>(3 * pixels), Plane(pixels)};
  Plane variance(pixels);
  for (std::size_t i = 0; i < pixels; ++i) {
    const double w = shares[i], a = h.share[i], b = 1 - a;
    picture.denoised += w;
    for (std::size_t k = 3 * i; k < 3 * i + 3; ++k) {
      const double first = w * h.denoised_first[k] + (1 - w) * h.first[k],
                   second = w * h.denoised_second[k] + (1 - w) * h.second[k];
      picture.color[k] = static_cast<float>(a * first + b * second);
      variance[i] += static_cast<float>(a * b * (first - second) * (first - second) / 3);
    }
    picture.squared_error[i] = static_cast<float>(w * w * errors.denoised[i] + (1 - w) * (1 - w) * errors.raw[i] +
                                                  2 * w * (1 - w) * errors.both[i]);
  }
  picture.denoised /= static_cast<double>(pixels);
  cut_outliers(picture.squared_error);
  picture.error =
      std::accumulate(picture.squared_error.begin(), picture.squared_error.end(), 0.0) / static_cast<double>(pixels);
  picture.deviation = deviation_of_mean(picture.squared_error, h.width, h.height);
  picture.squared_error = error_layer(h, picture.squared_error, variance);
  return picture;
}

}  // namespace gleaner::worker

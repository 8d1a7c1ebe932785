#include "coordinator/film/metrics.h"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <set>

#include "scene/model/error.h"

namespace gleaner::coordinator {
namespace {

constexpr std::size_t block_pixels = 16;
constexpr double block_sigmas = 5, block_deviation = 0.01;
constexpr std::size_t robust_part = 1000;  // one pixel in so many is left out of error_robust

const std::vector<std::string> kPictureChannels{"R", "G", "B"};

using Plane = const std::vector<float>*;
using Planes = std::vector<Plane>;

std::string layer_of(const std::string& channel) {
  const auto dot = channel.rfind('.');
  return dot == std::string::npos ? "" : channel.substr(0, dot);
}

void require_finite(const Picture& picture, const Channel& channel) {
  std::size_t first = 0, count = 0;
  for (std::size_t i = channel.values.size(); i-- > 0;) {
    if (std::isfinite(channel.values[i])) continue;
    first = i;
    ++count;
  }
  if (count == 0) return;
  const auto x = first % picture.film.width, y = first / picture.film.width;
  throw Error::bad_input(
      picture.name, "channel " + channel.name + ": pixel " + std::to_string(x) + "," + std::to_string(y),
      "a finite value", std::to_string(channel.values[first]) + " (" + std::to_string(count) + " such pixels in all)");
}

Planes planes_of(const Picture& picture, const std::vector<std::string>& names) {
  Planes planes;
  for (const auto& name : names) {
    const Channel* channel = picture.film.find(name);
    if (!channel) throw Error::bad_input(picture.name, "channels", "one named " + name, "none");
    require_finite(picture, *channel);
    planes.push_back(&channel->values);
  }
  return planes;
}

bool is_denoised(const Picture& picture) { return picture.film.find("error.Y") != nullptr; }

// Of a denoised picture, its estimated squared error, which all channels share: its variance layer is the noisy one's.
std::optional<Planes> variance_planes(const Picture& picture) {
  if (is_denoised(picture)) return planes_of(picture, {"error.Y", "error.Y", "error.Y"});
  const std::vector<std::string> names{"variance.R", "variance.G", "variance.B"};
  for (const auto& name : names)
    if (!picture.film.find(name)) return std::nullopt;
  return planes_of(picture, names);
}

double square(double x) { return x * x; }

double mean_of(const Planes& planes) {
  double sum = 0;
  for (const auto* plane : planes) sum = std::accumulate(plane->begin(), plane->end(), sum);
  return sum / double(planes.size() * planes[0]->size());
}

double over(double value, double mean) { return mean > 0 ? value / mean : value; }

// The variance of each value's difference, as far as it is known: the reference's and the picture's own.
struct Noise {
  Planes reference_error;  // standard errors; empty where not known
  Planes test_variance;    // empty where not known
  bool known() const { return !reference_error.empty() || !test_variance.empty(); }
  double variance(std::size_t channel, std::size_t pixel) const {
    double sum = 0;
    if (!reference_error.empty()) sum += square((*reference_error[channel])[pixel]);
    if (!test_variance.empty()) sum += (*test_variance[channel])[pixel];
    return sum;
  }
};

// Mean over channels of the squared difference of each pixel.
std::vector<double> squared_differences(const Planes& test, const Planes& reference) {
  std::vector<double> result(test[0]->size(), 0.0);
  for (std::size_t c = 0; c < test.size(); ++c)
    for (std::size_t i = 0; i < result.size(); ++i) result[i] += square(double{(*test[c])[i]} - (*reference[c])[i]);
  for (double& value : result) value /= double(test.size());
  return result;
}

// All pixels but the 0.1 % that differ most; equal ones go by their place, so that the choice is the same everywhere.
std::vector<std::size_t> calm_pixels(const std::vector<double>& squared) {
  std::vector<std::size_t> order(squared.size());
  std::iota(order.begin(), order.end(), std::size_t{0});
  const auto kept = order.end() - std::ptrdiff_t(squared.size() / robust_part);
  if (kept != order.end())
    std::nth_element(order.begin(), kept, order.end(), [&](std::size_t a, std::size_t b) {
      return squared[a] != squared[b] ? squared[a] < squared[b] : a < b;
    });
  order.erase(kept, order.end());
  std::ranges::sort(order);
  return order;
}

template <class Value>
double mean_over(const std::vector<std::size_t>& pixels, Value&& value) {
  double sum = 0;
  for (const auto pixel : pixels) sum += value(pixel);
  return sum / double(pixels.size());
}

LayerComparison compare_layer(const std::string& name, const std::vector<std::string>& channels, const Planes& test,
                              const Planes& reference, const Noise& noise) {
  LayerComparison result;
  result.name = name;
  result.mean = mean_of(reference);
  result.test_mean = mean_of(test);
  result.bias = over(result.test_mean - result.mean, result.mean);

  const auto squared = squared_differences(test, reference);
  const auto reference_noise = [&](std::size_t pixel) {
    double sum = 0;
    for (const auto* plane : noise.reference_error) sum += square((*plane)[pixel]);
    return sum / double(test.size());
  };
  std::vector<std::size_t> all(squared.size());
  std::iota(all.begin(), all.end(), std::size_t{0});
  result.mse_measured = mean_over(all, [&](std::size_t i) { return squared[i]; });
  result.mse = result.mse_measured - mean_over(all, reference_noise);
  result.rmse = std::sqrt(std::max(result.mse, 0.0));
  result.error = over(result.rmse, result.mean);
  const double calm = mean_over(calm_pixels(squared), [&](std::size_t i) { return squared[i] - reference_noise(i); });
  result.error_robust = over(std::sqrt(std::max(calm, 0.0)), result.mean);

  double peak = 0, relative = 0;
  for (std::size_t c = 0; c < test.size(); ++c)
    for (std::size_t i = 0; i < squared.size(); ++i) {
      const double value = (*reference[c])[i], difference = (*test[c])[i] - value;
      peak = std::max(peak, std::abs(value));
      if (difference != 0) relative += square(difference) / (square(value) + 0.01 * square(result.mean));
    }
  result.relmse = relative / double(squared.size() * test.size());
  if (result.mse > 0 && peak > 0) result.psnr = 10 * std::log10(square(peak) / result.mse);

  for (std::size_t c = 0; c < test.size(); ++c) {
    ChannelMeans means{channels[c], mean_of({test[c]}), mean_of({reference[c]}), 0, std::nullopt};
    means.deviation = over(means.test - means.reference, means.reference);
    const double variance =
        noise.known() ? mean_over(all, [&](std::size_t i) { return noise.variance(c, i); }) / double(squared.size())
                      : 0;
    if (variance > 0) means.sigmas = (means.test - means.reference) / std::sqrt(variance);
    result.channels.push_back(means);
  }
  return result;
}

BlockComparison compare_blocks(const Film& size, const Planes& test, const Planes& reference, const Noise& noise) {
  BlockComparison result;
  for (std::size_t top = 0; top < size.height; top += block_pixels)
    for (std::size_t left = 0; left < size.width; left += block_pixels) {
      const std::size_t bottom = std::min<std::size_t>(top + block_pixels, size.height);
      const std::size_t right = std::min<std::size_t>(left + block_pixels, size.width);
      double worst = 0;
      bool off = false;
      for (std::size_t c = 0; c < test.size(); ++c) {
        double difference = 0, expected = 0, variance = 0;
        for (std::size_t y = top; y < bottom; ++y)
          for (std::size_t x = left; x < right; ++x) {
            const std::size_t i = y * size.width + x;
            difference += double{(*test[c])[i]} - (*reference[c])[i];
            expected += (*reference[c])[i];
            variance += noise.variance(c, i);
          }
        // Sums, not means: the block's pixel count stands on both sides.
        const double sigmas =
            variance > 0 ? std::abs(difference) / std::sqrt(variance) : std::abs(difference) * HUGE_VAL;
        if (!(std::abs(difference) > block_deviation * std::abs(expected) && sigmas > block_sigmas)) continue;
        off = true;
        worst = std::max(worst, sigmas);
      }
      ++result.count;
      if (!off) continue;
      ++result.off;
      if (worst > result.worst_sigmas) {
        result.worst_sigmas = worst;
        result.worst_x = left;
        result.worst_y = top;
      }
    }
  return result;
}

std::optional<double> variance_ratio(const std::vector<std::size_t>& pixels, const std::vector<double>& squared,
                                     const Noise& noise) {
  const auto channel_mean = [&](const Planes& planes, std::size_t pixel, auto&& value) {
    double sum = 0;
    for (const auto* plane : planes) sum += value((*plane)[pixel]);
    return sum / 3;
  };
  const double seen = mean_over(pixels, [&](std::size_t i) {
    return squared[i] - channel_mean(noise.reference_error, i, [](double error) { return square(error); });
  });
  const double told = mean_over(pixels, [&](std::size_t i) {
    return channel_mean(noise.test_variance, i, [](double variance) { return variance; });
  });
  if (!(seen > 0)) return std::nullopt;
  return told / seen;
}

void require_size(const Picture& picture, const Picture& reference) {
  const auto text = [](const Film& film) { return std::to_string(film.width) + "x" + std::to_string(film.height); };
  if (picture.film.width != reference.film.width || picture.film.height != reference.film.height)
    throw Error::bad_input(picture.name, "size", text(reference.film) + " as in " + reference.name, text(picture.film));
}

}  // namespace

OwnNoise own_noise(const Picture& picture) {
  OwnNoise result{mean_of(planes_of(picture, kPictureChannels)), std::nullopt};
  if (const auto variance = variance_planes(picture))
    result.standard_error = over(std::sqrt(mean_of(*variance)), result.mean);
  result.denoised = is_denoised(picture);
  return result;
}

Comparison compare(const Picture& test, const Picture& reference, const Picture* reference_error) {
  require_size(test, reference);
  const Planes seen = planes_of(test, kPictureChannels), expected = planes_of(reference, kPictureChannels);

  Noise noise;
  if (reference_error) {
    require_size(*reference_error, reference);
    noise.reference_error = planes_of(*reference_error, kPictureChannels);
  }
  if (auto variance = variance_planes(test)) noise.test_variance = *variance;

  Comparison result;
  result.picture = compare_layer("", kPictureChannels, seen, expected, noise);
  result.reference_noise = result.picture.mse_measured - result.picture.mse;

  std::set<std::string> layers;
  for (const auto& channel : test.film.channels)
    if (reference.film.find(channel.name)) layers.insert(layer_of(channel.name));
  layers.erase("");
  for (const auto& layer : layers) {
    std::vector<std::string> names;
    for (const auto& channel : test.film.channels)
      if (layer_of(channel.name) == layer && reference.film.find(channel.name)) names.push_back(channel.name);
    result.layers.push_back(compare_layer(layer, names, planes_of(test, names), planes_of(reference, names), Noise{}));
  }

  // What a denoiser is off by, neighbours share: a block's mean is not as sure as its pixels would make it.
  if (noise.known() && !is_denoised(test)) result.blocks = compare_blocks(test.film, seen, expected, noise);
  if (!noise.test_variance.empty()) {
    const auto squared = squared_differences(seen, expected);
    std::vector<std::size_t> all(squared.size());
    std::iota(all.begin(), all.end(), std::size_t{0});
    result.variance_ratio = variance_ratio(all, squared, noise);
    result.variance_ratio_robust = variance_ratio(calm_pixels(squared), squared, noise);
  }
  return result;
}

}  // namespace gleaner::coordinator

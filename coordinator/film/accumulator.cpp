#include "coordinator/film/accumulator.h"

#include <algorithm>
#include <cmath>
#include <string>

namespace gleaner::coordinator {
namespace {

constexpr const char* kColor[] = {"R", "G", "B"};
constexpr const char* kAxis[] = {"X", "Y", "Z"};

// Radiance whose square, and sums of such, are far inside a float's range.
constexpr double kBrightest = 1e12;

template <typename Value>
void fill_layer(Film& film, const std::string& name, Value value) {
  std::vector<float>& values = film.channel(name).values;
  for (std::size_t i = 0; i < values.size(); ++i) values[i] = value(i);
}

}  // namespace

Accumulator::Accumulator(std::uint32_t width, std::uint32_t height) : width_(width), height_(height) {}

// Were each sequence of n samples off by variance v / n, the difference of their means would have v (1/a + 1/b), and
// the mean of all samples v / (a + b).
double Accumulator::Pixel::variance(int k) const {
  const double a = sequence_samples[0], b = sequence_samples[1];
  if (a == 0 || b == 0) return 0;
  const double difference = sequence[0][k] / a - sequence[1][k] / b;
  return difference * difference * a * b / ((a + b) * (a + b));
}

void Accumulator::add(std::uint32_t pixel, std::uint32_t chunk, const float direct[3], const float indirect[3],
                      std::uint32_t samples, bool whole) {
  if (pixels_.empty()) pixels_.resize(pixel_count());
  Pixel& p = pixels_[pixel];
  p.samples += samples;
  p.sequence_samples[chunk % 2] += samples;
  if (whole) ++p.chunks;
  for (int k = 0; k < 3; ++k) {
    p.direct[k] += direct[k];
    p.indirect[k] += indirect[k];
    p.sequence[chunk % 2][k] += static_cast<double>(direct[k]) + indirect[k];
    if (!whole) continue;
    const double value = (static_cast<double>(direct[k]) + indirect[k]) / samples;
    const double before = value - p.mean[k];
    p.mean[k] += before / p.chunks;
    p.square[k] += before * (value - p.mean[k]);
  }
}

void Accumulator::add_features(std::uint32_t pixel, const FeatureSums& sums, std::uint32_t samples) {
  if (features_.empty()) features_.resize(pixel_count());
  Features& f = features_[pixel];
  for (int k = 0; k < 3; ++k) {
    f.albedo[k] += sums.albedo[k];
    f.normal[k] += sums.normal[k];
  }
  f.depth += sums.depth;
  f.hits += sums.hits;
  f.samples += samples;
}

void Accumulator::add_clamped(std::uint32_t pixel, const float clamped[3]) {
  if (clamped_.empty()) clamped_.resize(pixel_count() * 3);
  for (std::size_t k = 0; k < 3; ++k) clamped_[std::size_t{pixel} * 3 + k] += clamped[k];
}

double Accumulator::Pixel::radiance() const {
  return samples ? (direct[0] + direct[1] + direct[2] + indirect[0] + indirect[1] + indirect[2]) / (3.0 * samples) : 0;
}

double Accumulator::Pixel::chunk_variance() const {
  return chunks > 1 ? (square[0] + square[1] + square[2]) / (3.0 * (chunks - 1)) : 0;
}

PixelNoise Accumulator::noise() const {
  PixelNoise noise{std::vector<float>(pixel_count()), std::vector<std::uint32_t>(pixel_count()), width_, height_};
  noise.mean.resize(pixel_count());
  double brightest = 0;
  for (const Pixel& p : pixels_)
    brightest = std::max({brightest, std::abs(p.radiance()), std::sqrt(p.chunk_variance())});
  // The square of 1e19 is beyond a float. A power of two changes no pixel's share.
  const double scale = brightest > kBrightest ? std::exp2(-std::ceil(std::log2(brightest / kBrightest))) : 1;
  for (std::size_t i = 0; i < pixels_.size(); ++i) {
    const Pixel& p = pixels_[i];
    noise.chunks[i] = p.chunks;
    noise.mean[i] = static_cast<float>(scale * p.radiance());
    noise.chunk_variance[i] = static_cast<float>(scale * scale * p.chunk_variance());
  }
  return noise;
}

// Of a pixel whose mean has variance s^2, the squared error and its estimate (one degree of freedom) are independent,
// with a variance of 2 s^4 each; the estimate's square is 3 s^4 on average. Channels are taken to err together.
double Accumulator::squared_error_bound() const {
  double sum = 0, squares = 0;
  for (const Pixel& p : pixels_) {
    const double own = p.variance(0) + p.variance(1) + p.variance(2);
    sum += own;
    squares += own * own;
  }
  return pixels_.empty() ? 0 : (sum + 2 * std::sqrt(squares * 4 / 3)) / (3.0 * static_cast<double>(pixels_.size()));
}

double Accumulator::mean_radiance() const {
  double sum = 0;
  for (const Pixel& p : pixels_)
    if (p.samples)
      for (int k = 0; k < 3; ++k) sum += (p.direct[k] + p.indirect[k]) / p.samples;
  return pixels_.empty() ? 0 : sum / (3.0 * static_cast<double>(pixels_.size()));
}

void Accumulator::add_pass(std::span<const float> rgb) {
  pass_sum_.resize(pixel_count() * 3);
  pass_square_.resize(pixel_count() * 3);
  for (std::size_t i = 0; i < rgb.size(); ++i) {
    pass_sum_[i] += rgb[i];
    pass_square_[i] += rgb[i] * rgb[i];
  }
  ++passes_;
}

void Accumulator::draw_samples(std::uint32_t pixel, const float direct[3], const float indirect[3],
                               std::uint32_t samples) {
  preview_.resize(pixel_count());
  for (int k = 0; k < 3; ++k) preview_[pixel].sum[k] += direct[k] + indirect[k];
  preview_[pixel].samples += static_cast<float>(samples);
}

void Accumulator::draw_pass(std::uint64_t first_pixel, std::span<const float> rgb) {
  preview_pass_.resize(pixel_count() * 3);
  std::ranges::copy(rgb, preview_pass_.begin() + static_cast<std::ptrdiff_t>(3 * first_pixel));
}

Film Accumulator::preview() const {
  Film film{width_, height_, {}};
  for (std::size_t k = 0; k < 3; ++k)
    fill_layer(film, kColor[k], [&](std::size_t i) {
      float value = preview_pass_.empty() ? 0.0f : preview_pass_[3 * i + k];
      if (!preview_.empty() && preview_[i].samples > 0) value += preview_[i].sum[k] / preview_[i].samples;
      return value;
    });
  return film;
}

Film Accumulator::film() const {
  Film film{width_, height_, {}};
  const std::vector<Pixel> none(pixels_.empty() ? pixel_count() : 0);
  const std::vector<Pixel>& pixels = pixels_.empty() ? none : pixels_;
  const auto mean = [](double sum, std::uint32_t samples) {
    return samples ? static_cast<float>(sum / samples) : 0.0f;
  };
  for (int k = 0; k < 3; ++k)
    // The sum of the two layers as floats, so that it holds to the bit in the file.
    fill_layer(film, kColor[k], [&](std::size_t i) {
      return mean(pixels[i].direct[k], pixels[i].samples) + mean(pixels[i].indirect[k], pixels[i].samples);
    });
  for (int k = 0; k < 3; ++k)
    fill_layer(film, std::string("direct.") + kColor[k],
               [&](std::size_t i) { return mean(pixels[i].direct[k], pixels[i].samples); });
  for (int k = 0; k < 3; ++k)
    fill_layer(film, std::string("indirect.") + kColor[k],
               [&](std::size_t i) { return mean(pixels[i].indirect[k], pixels[i].samples); });
  for (int k = 0; k < 3; ++k)
    fill_layer(film, std::string("variance.") + kColor[k],
               [&](std::size_t i) { return static_cast<float>(pixels[i].variance(k)); });
  fill_layer(film, "samples.Y", [&](std::size_t i) { return static_cast<float>(pixels[i].samples); });
  if (!clamped_.empty())
    for (std::size_t k = 0; k < 3; ++k)
      fill_layer(film, std::string("clamped.") + kColor[k],
                 [&](std::size_t i) { return mean(clamped_[3 * i + k], pixels[i].samples); });
  if (!features_.empty()) add_feature_layers(film);
  if (passes_ > 0) add_passes(film);
  return film;
}

void Accumulator::add_feature_layers(Film& film) const {
  const auto mean = [](double sum, std::uint32_t samples) {
    return samples ? static_cast<float>(sum / samples) : 0.0f;
  };
  for (int k = 0; k < 3; ++k)
    fill_layer(film, std::string("albedo.") + kColor[k],
               [&](std::size_t i) { return mean(features_[i].albedo[k], features_[i].samples); });
  for (int k = 0; k < 3; ++k)
    fill_layer(film, std::string("normal.") + kAxis[k], [&](std::size_t i) {
      const Features& f = features_[i];
      const float length = std::sqrt(f.normal[0] * f.normal[0] + f.normal[1] * f.normal[1] + f.normal[2] * f.normal[2]);
      return length > 0 ? f.normal[k] / length : 0.0f;
    });
  // Over the samples that hit: half a pixel of sky does not halve a distance.
  fill_layer(film, "depth.Z",
             [&](std::size_t i) { return features_[i].hits > 0 ? features_[i].depth / features_[i].hits : 0.0f; });
}

void Accumulator::add_passes(Film& film) const {
  const auto n = static_cast<float>(passes_);
  for (std::size_t k = 0; k < 3; ++k) {
    std::vector<float>& indirect = film.channel(std::string("indirect.") + kColor[k]).values;
    const std::vector<float>& direct = film.channel(std::string("direct.") + kColor[k]).values;
    std::vector<float>& all = film.channel(kColor[k]).values;
    std::vector<float>& variance = film.channel(std::string("variance.") + kColor[k]).values;
    for (std::size_t i = 0; i < all.size(); ++i) {
      const float sum = pass_sum_[3 * i + k];
      indirect[i] += sum / n;
      all[i] = direct[i] + indirect[i];
      // Between the passes; a single one tells nothing of itself.
      if (passes_ > 1) variance[i] += std::max(0.0f, pass_square_[3 * i + k] - sum * sum / n) / (n * (n - 1));
    }
  }
}

}  // namespace gleaner::coordinator

#include "coordinator/plan/path_film.h"

#include <cmath>

namespace gleaner::coordinator {

PathFilm::PathFilm(std::uint32_t width, std::uint32_t height)
    : width_(width), height_(height), pixels_(std::size_t{width} * height) {}

// Were each sequence of n samples off by variance v / n, the difference of their means would have v (1/a + 1/b), and
// the mean of all samples v / (a + b).
double PathFilm::Pixel::variance(int k) const {
  const double a = sequence_samples[0], b = sequence_samples[1];
  if (a == 0 || b == 0) return 0;
  const double difference = sequence[0][k] / a - sequence[1][k] / b;
  return difference * difference * a * b / ((a + b) * (a + b));
}

void PathFilm::add(std::uint32_t pixel, std::uint32_t chunk, const float direct[3], const float indirect[3],
                   std::uint32_t samples, bool whole) {
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

void PathFilm::add_features(std::uint32_t pixel, const kernels::PathFeatureRecord& record, std::uint32_t samples) {
  if (features_.empty()) features_.resize(pixels_.size());
  Features& f = features_[pixel];
  for (int k = 0; k < 3; ++k) {
    f.albedo[k] += record.albedo[k];
    f.normal[k] += record.normal[k];
  }
  f.depth += record.depth;
  f.hits += record.hits;
  f.samples += samples;
}

void PathFilm::add_clamped(std::uint32_t pixel, const float clamped[3]) {
  if (clamped_.empty()) clamped_.resize(pixels_.size() * 3);
  for (std::size_t k = 0; k < 3; ++k) clamped_[std::size_t{pixel} * 3 + k] += clamped[k];
}

PixelNoise PathFilm::noise() const {
  PixelNoise noise{std::vector<float>(pixels_.size()), std::vector<std::uint32_t>(pixels_.size()), width_, height_};
  noise.mean.resize(pixels_.size());
  for (std::size_t i = 0; i < pixels_.size(); ++i) {
    const Pixel& p = pixels_[i];
    noise.chunks[i] = p.chunks;
    if (p.samples)
      noise.mean[i] =
          static_cast<float>((p.direct[0] + p.direct[1] + p.direct[2] + p.indirect[0] + p.indirect[1] + p.indirect[2]) /
                             (3.0 * p.samples));
    if (p.chunks > 1)
      noise.chunk_variance[i] = static_cast<float>((p.square[0] + p.square[1] + p.square[2]) / (3.0 * (p.chunks - 1)));
  }
  return noise;
}

// Of a pixel whose mean has variance s^2, the squared error and its estimate (one degree of freedom) are independent,
// with a variance of 2 s^4 each; the estimate's square is 3 s^4 on average. Channels are taken to err together.
double PathFilm::squared_error_bound() const {
  double sum = 0, squares = 0;
  for (const Pixel& p : pixels_) {
    const double own = p.variance(0) + p.variance(1) + p.variance(2);
    sum += own;
    squares += own * own;
  }
  return pixels_.empty() ? 0 : (sum + 2 * std::sqrt(squares * 4 / 3)) / (3.0 * static_cast<double>(pixels_.size()));
}

double PathFilm::mean_radiance() const {
  double sum = 0;
  for (const Pixel& p : pixels_)
    if (p.samples)
      for (int k = 0; k < 3; ++k) sum += (p.direct[k] + p.indirect[k]) / p.samples;
  return pixels_.empty() ? 0 : sum / (3.0 * static_cast<double>(pixels_.size()));
}

Film PathFilm::film() const {
  static const char* const kColor[] = {"R", "G", "B"};
  static const char* const kAxis[] = {"X", "Y", "Z"};
  Film film{width_, height_, {}};
  const std::size_t n = pixels_.size();
  const auto layer = [&](const std::string& name, auto&& value) {
    std::vector<float>& values = film.channel(name).values;
    for (std::size_t i = 0; i < n; ++i) values[i] = value(i);
  };
  const auto mean = [](double sum, std::uint32_t samples) {
    return samples ? static_cast<float>(sum / samples) : 0.0f;
  };
  for (int k = 0; k < 3; ++k)
    // The sum of the two layers as floats, so that it holds to the bit in the file.
    layer(kColor[k], [&](std::size_t i) {
      return mean(pixels_[i].direct[k], pixels_[i].samples) + mean(pixels_[i].indirect[k], pixels_[i].samples);
    });
  for (int k = 0; k < 3; ++k)
    layer(std::string("direct.") + kColor[k],
          [&](std::size_t i) { return mean(pixels_[i].direct[k], pixels_[i].samples); });
  for (int k = 0; k < 3; ++k)
    layer(std::string("indirect.") + kColor[k],
          [&](std::size_t i) { return mean(pixels_[i].indirect[k], pixels_[i].samples); });
  for (int k = 0; k < 3; ++k)
    layer(std::string("variance.") + kColor[k],
          [&](std::size_t i) { return static_cast<float>(pixels_[i].variance(k)); });
  layer("samples.Y", [&](std::size_t i) { return static_cast<float>(pixels_[i].samples); });
  if (!clamped_.empty())
    for (std::size_t k = 0; k < 3; ++k)
      layer(std::string("clamped.") + kColor[k],
            [&](std::size_t i) { return mean(clamped_[3 * i + k], pixels_[i].samples); });
  if (features_.empty()) return film;
  for (int k = 0; k < 3; ++k)
    layer(std::string("albedo.") + kColor[k],
          [&](std::size_t i) { return mean(features_[i].albedo[k], features_[i].samples); });
  for (int k = 0; k < 3; ++k)
    layer(std::string("normal.") + kAxis[k], [&](std::size_t i) {
      const Features& f = features_[i];
      const float length = std::sqrt(f.normal[0] * f.normal[0] + f.normal[1] * f.normal[1] + f.normal[2] * f.normal[2]);
      return length > 0 ? f.normal[k] / length : 0.0f;
    });
  // Over the samples that hit: half a pixel of sky does not halve a distance.
  layer("depth.Z",
        [&](std::size_t i) { return features_[i].hits > 0 ? features_[i].depth / features_[i].hits : 0.0f; });
  return film;
}

}  // namespace gleaner::coordinator

#include "coordinator/film/accumulator.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numeric>
#include <string>
#include <utility>

#include "scene/model/error.h"

namespace gleaner::coordinator {
namespace {

constexpr const char* kColor[] = {"R", "G", "B"};
constexpr const char* kAxis[] = {"X", "Y", "Z"};

// Radiance whose square, and sums of such, are far inside a float's range.
constexpr double kBrightest = 1e12;

std::array<float, 3> unit_or_none(std::array<float, 3> v) {
  const float length = std::sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]);
  for (float& x : v) x = length > 0 ? x / length : 0.0f;
  return v;
}

float mean(double sum, std::uint32_t samples) { return samples ? static_cast<float>(sum / samples) : 0.0f; }

// A variance beyond a float's range is the largest there is: layers hold finite numbers.
float bounded(double variance) {
  return static_cast<float>(std::min(variance, double{std::numeric_limits<float>::max()}));
}

template <typename Value>
void free_memory(std::vector<Value>& values) {
  std::vector<Value>().swap(values);
}

template <typename Channels>
void resize(Channels& channels, std::size_t size) {
  for (auto& channel : channels) channel.resize(size);
}

}  // namespace

Accumulator::Accumulator(std::uint32_t width, std::uint32_t height) : width_(width), height_(height) {}

Accumulator::Samples Accumulator::sequence_samples(std::size_t pixel) const {
  if (!sampled() && whole_.empty()) return {};
  Samples samples = {whole_[pixel][0] * chunk_samples_, whole_[pixel][1] * chunk_samples_};
  if (short_.empty()) return samples;
  if (const auto more = short_.find(static_cast<std::uint32_t>(pixel)); more != short_.end())
    for (std::size_t s = 0; s < 2; ++s) samples[s] += more->second.samples[s];
  return samples;
}

std::uint32_t Accumulator::samples(std::size_t pixel) const {
  const Samples samples = sequence_samples(pixel);
  return samples[0] + samples[1];
}

double Accumulator::radiance(std::size_t pixel) const {
  const std::uint32_t count = samples(pixel);
  return count ? (direct_[0][pixel] + direct_[1][pixel] + direct_[2][pixel] + indirect_[0][pixel] +
                  indirect_[1][pixel] + indirect_[2][pixel]) /
                     (3.0 * count)
               : 0;
}

double Accumulator::chunk_variance(std::size_t pixel) const {
  const std::uint32_t chunks = whole_[pixel][0] + whole_[pixel][1];
  return chunks > 1 ? square_[pixel] / (3.0 * (chunks - 1)) : 0;
}

// Were each sequence of n samples off by variance v / n, the difference of their means would have v (1/a + 1/b), and
// the mean of all samples v / (a + b).
double Accumulator::variance(std::size_t pixel, int k) const {
  const Samples samples = sequence_samples(pixel);
  const double a = samples[0], b = samples[1];
  if (a == 0 || b == 0) return 0;
  const double first = first_[k][pixel], second = direct_[k][pixel] + indirect_[k][pixel] - first;
  const double difference = first / a + seen_by(0, pixel, k, samples) - second / b - seen_by(1, pixel, k, samples);
  return difference * difference * a * b / ((a + b) * (a + b));
}

void Accumulator::add(std::uint32_t pixel, std::uint32_t chunk, const float direct[3], const float indirect[3],
                      std::uint32_t samples_of_chunk, bool whole) {
  if (!sampled()) {
    for (auto* sums : {&direct_, &indirect_, &first_}) resize(*sums, pixel_count());
    square_.resize(pixel_count());
    whole_.resize(pixel_count());
  }
  if (whole && chunk_samples_ == 0) chunk_samples_ = samples_of_chunk;
  if (whole && chunk_samples_ != samples_of_chunk)
    throw Error::failed("film: a chunk of " + std::to_string(samples_of_chunk) + " samples among such of " +
                        std::to_string(chunk_samples_));
  const double before = samples(pixel);
  for (int k = 0; k < 3; ++k) {
    const double value = static_cast<double>(direct[k]) + indirect[k];
    if (whole && before > 0) {
      // Welford (1962), with the means of the sums so far.
      const double sum = direct_[k][pixel] + indirect_[k][pixel], of_chunk = value / samples_of_chunk;
      square_[pixel] += (of_chunk - sum / before) * (of_chunk - (sum + value) / (before + samples_of_chunk));
    }
    direct_[k][pixel] += direct[k];
    indirect_[k][pixel] += indirect[k];
    if (chunk % 2 == 0) first_[k][pixel] += value;
  }
  if (whole) {
    ++whole_[pixel][chunk % 2];
    return;
  }
  ShortChunks& more = short_[pixel];
  more.samples[chunk % 2] += samples_of_chunk;
  ++more.chunks;
}

void Accumulator::add_features(std::uint32_t pixel, const FeatureSums& sums, std::uint32_t samples_of_chunk) {
  if (depth_.empty()) {
    for (auto* channels : {&albedo_, &normal_}) resize(*channels, pixel_count());
    depth_.resize(pixel_count());
    hits_.resize(pixel_count());
  }
  for (int k = 0; k < 3; ++k) {
    albedo_[k][pixel] += sums.albedo[k];
    normal_[k][pixel] += sums.normal[k];
  }
  depth_[pixel] += sums.depth;
  hits_[pixel] += sums.hits;
  feature_samples_ += samples_of_chunk;
}

void Accumulator::add_clamped(std::uint32_t pixel, const float clamped[3]) {
  if (clamped_[0].empty()) resize(clamped_, pixel_count());
  for (int k = 0; k < 3; ++k) clamped_[k][pixel] += clamped[k];
}

void Accumulator::add_seen(std::uint32_t pixel, std::uint32_t chunk, const float emission[3]) {
  if (!(emission[0] > 0 || emission[1] > 0 || emission[2] > 0)) return;
  if (!sees_emission())
    for (auto& sequence : seen_) resize(sequence, pixel_count());
  for (int k = 0; k < 3; ++k) seen_[chunk % 2][k][pixel] += emission[k];
}

void Accumulator::add_seen_alone(std::uint32_t pixel, std::uint32_t chunk, const float emission[3],
                                 std::uint32_t rays) {
  SeenAlone& alone = seen_alone_[chunk % 2][pixel];
  for (int k = 0; k < 3; ++k) alone.sums[k] += emission[k];
  alone.samples += rays;
}

double Accumulator::seen_by(std::size_t sequence, std::size_t pixel, int k, const Samples& by_sequence) const {
  if (!sees_emission()) return 0;
  const auto& few = seen_alone_[sequence];
  if (const auto alone = few.find(static_cast<std::uint32_t>(pixel));
      alone != few.end() && alone->second.samples > by_sequence[sequence])
    return alone->second.sums[k] / alone->second.samples;
  return by_sequence[sequence] ? double{seen_[sequence][k][pixel]} / by_sequence[sequence] : 0;
}

double Accumulator::seen_by_all(std::size_t pixel, int k) const {
  if (!sees_emission()) return 0;
  // Nearly all pixels.
  const bool none = seen_[0][k][pixel] == 0 && seen_[1][k][pixel] == 0;
  if (none && seen_alone_[0].empty() && seen_alone_[1].empty()) return 0;
  const Samples by_sequence = sequence_samples(pixel);
  const double a = by_sequence[0], b = by_sequence[1];
  if (a + b == 0) return 0;
  return (a * seen_by(0, pixel, k, by_sequence) + b * seen_by(1, pixel, k, by_sequence)) / (a + b);
}

std::vector<float> Accumulator::seen(std::size_t sequence) const {
  return layer([&](std::size_t i) {
    const Samples by_sequence = sequence_samples(i);
    double sum = 0;
    for (int k = 0; k < 3; ++k) sum += seen_by(sequence, i, k, by_sequence);
    return static_cast<float>(sum / 3);
  });
}

PixelNoise Accumulator::noise() const {
  PixelNoise noise{std::vector<float>(pixel_count()), std::vector<std::uint32_t>(pixel_count()), width_, height_};
  noise.mean.resize(pixel_count());
  if (!sampled()) return noise;
  double brightest = 0;
  for (std::size_t i = 0; i < pixel_count(); ++i)
    brightest = std::max({brightest, std::abs(radiance(i)), std::sqrt(chunk_variance(i))});
  // The square of 1e19 is beyond a float. A power of two changes no pixel's share.
  const double scale = brightest > kBrightest ? std::exp2(-std::ceil(std::log2(brightest / kBrightest))) : 1;
  for (std::size_t i = 0; i < pixel_count(); ++i) {
    noise.chunks[i] = whole_[i][0] + whole_[i][1];
    noise.mean[i] = static_cast<float>(scale * radiance(i));
    noise.chunk_variance[i] = static_cast<float>(scale * scale * chunk_variance(i));
  }
  for (const auto& [pixel, more] : short_) noise.chunks[pixel] += more.chunks;
  return noise;
}

// Of a pixel whose mean has variance s^2, the squared error and its estimate (one degree of freedom) are independent,
// with a variance of 2 s^4 each; the estimate's square is 3 s^4 on average. Channels are taken to err together.
double Accumulator::squared_error_bound() const {
  if (!sampled()) return 0;
  double sum = 0, squares = 0;
  for (std::size_t i = 0; i < pixel_count(); ++i) {
    const double own = variance(i, 0) + variance(i, 1) + variance(i, 2);
    sum += own;
    squares += own * own;
  }
  return (sum + 2 * std::sqrt(squares * 4 / 3)) / (3.0 * static_cast<double>(pixel_count()));
}

double Accumulator::mean_radiance() const {
  if (!sampled()) return 0;
  double sum = 0;
  for (std::size_t i = 0; i < pixel_count(); ++i)
    if (const std::uint32_t count = samples(i))
      for (int k = 0; k < 3; ++k) sum += (direct_[k][i] + indirect_[k][i]) / count + seen_by_all(i, k);
  return sum / (3.0 * static_cast<double>(pixel_count()));
}

double Accumulator::mean_albedo() const {
  if (!feature_samples_) return 0;
  double sum = 0;
  for (const std::vector<float>& channel : albedo_) sum = std::accumulate(channel.begin(), channel.end(), sum);
  return sum / (3.0 * static_cast<double>(feature_samples_));
}

void Accumulator::add_pass(std::span<const float> rgb) {
  pass_sum_.resize(pixel_count() * 3);
  pass_square_.resize(pixel_count() * 3);
  for (std::size_t i = 0; i < rgb.size(); ++i) {
    pass_sum_[i] += rgb[i];
    pass_square_[i] = bounded(pass_square_[i] + rgb[i] * rgb[i]);
  }
  if (halves_ && passes_ % 2 == 0) {
    pass_half_.resize(pixel_count() * 3);
    for (std::size_t i = 0; i < rgb.size(); ++i) pass_half_[i] += rgb[i];
  }
  ++passes_;
}

void Accumulator::draw_pass(std::uint64_t first_pixel, std::span<const float> rgb) {
  preview_pass_.resize(pixel_count() * 3);
  std::ranges::copy(rgb, preview_pass_.begin() + static_cast<std::ptrdiff_t>(3 * first_pixel));
}

template <typename Value>
std::vector<float> Accumulator::layer(const Value& value) const {
  std::vector<float> values(pixel_count());
  for (std::size_t i = 0; i < values.size(); ++i) values[i] = value(i);
  return values;
}

Film Accumulator::preview(bool guides) const {
  Film film{width_, height_, {}};
  for (std::size_t k = 0; k < 3; ++k)
    film.channels.push_back({kColor[k], layer([&](std::size_t i) {
                               const float pass = preview_pass_.empty() ? 0.0f : preview_pass_[3 * i + k];
                               if (!sampled()) return pass;
                               return pass + mean(direct_[k][i] + indirect_[k][i], samples(i)) +
                                      static_cast<float>(seen_by_all(i, static_cast<int>(k)));
                             })});
  if (!guides || depth_.empty() || feature_samples_ % pixel_count() != 0) return film;
  const auto count = static_cast<std::uint32_t>(feature_samples_ / pixel_count());
  for (std::size_t k = 0; k < 3; ++k)
    film.channels.push_back(
        {std::string("albedo.") + kColor[k], layer([&](std::size_t i) { return mean(albedo_[k][i], count); })});
  std::vector<std::array<float, 3>> normals(pixel_count());
  for (std::size_t i = 0; i < normals.size(); ++i)
    normals[i] = unit_or_none({normal_[0][i], normal_[1][i], normal_[2][i]});
  for (std::size_t k = 0; k < 3; ++k)
    film.channels.push_back({std::string("normal.") + kAxis[k], layer([&](std::size_t i) { return normals[i][k]; })});
  return film;
}

Film Accumulator::film() const { return Accumulator(*this).take_film(); }

Film Accumulator::film_of_samples() const {
  Accumulator samples(*this);
  samples.passes_ = 0;
  return samples.take_film();
}

Film Accumulator::take_picture() {
  if (halves_ || !sampled()) return take_film();
  Film film{width_, height_, {}};
  const auto n = static_cast<float>(passes_);
  for (std::size_t k = 0; k < 3; ++k)
    film.channels.push_back({kColor[k], layer([&](std::size_t i) {
                               // As take_film() adds them up, to the bit.
                               const std::uint32_t count = samples(i);
                               float indirect = mean(indirect_[k][i], count);
                               if (passes_ > 0) indirect += pass_sum_[3 * i + k] / n;
                               const auto seen = static_cast<float>(seen_by_all(i, static_cast<int>(k)));
                               return mean(direct_[k][i], count) + seen + indirect;
                             })});
  *this = Accumulator(width_, height_);
  return film;
}

Film Accumulator::take_film() {
  if (!sampled()) {
    for (auto* sums : {&direct_, &indirect_, &first_}) resize(*sums, pixel_count());
    whole_.resize(pixel_count());
  }
  free_memory(square_);
  free_memory(preview_pass_);
  Channels<float> all, direct, indirect, spread, half;
  const auto half_mean = [&](std::size_t i, int k) {
    const Samples by_sequence = sequence_samples(i);
    // A pixel of one sequence has no halves.
    return by_sequence[0] && by_sequence[1]
               ? static_cast<float>(first_[k][i] / by_sequence[0] + seen_by(0, i, k, by_sequence))
               : mean(direct_[k][i] + indirect_[k][i], samples(i)) + static_cast<float>(seen_by_all(i, k));
  };
  for (int k = 0; k < 3; ++k) {
    spread[k] = layer([&](std::size_t i) { return bounded(variance(i, k)); });
    if (halves_) half[k] = layer([&](std::size_t i) { return half_mean(i, k); });
    free_memory(first_[k]);
    direct[k] =
        layer([&](std::size_t i) { return mean(direct_[k][i], samples(i)) + static_cast<float>(seen_by_all(i, k)); });
    free_memory(direct_[k]);
    indirect[k] = layer([&](std::size_t i) { return mean(indirect_[k][i], samples(i)); });
    free_memory(indirect_[k]);
    // The sum of the two layers as floats, so that it holds to the bit in the file.
    all[k] = layer([&](std::size_t i) { return direct[k][i] + indirect[k][i]; });
  }
  Film film{width_, height_, {}};
  const auto put = [&](const std::string& name, std::vector<float>& values) {
    film.channels.push_back({name, std::move(values)});
  };
  for (int k = 0; k < 3; ++k) put(kColor[k], all[k]);
  for (int k = 0; k < 3; ++k) put(std::string("direct.") + kColor[k], direct[k]);
  for (int k = 0; k < 3; ++k) put(std::string("indirect.") + kColor[k], indirect[k]);
  for (int k = 0; k < 3; ++k) put(std::string("variance.") + kColor[k], spread[k]);
  for (int k = 0; k < 3 && halves_; ++k) put(std::string("half.") + kColor[k], half[k]);
  std::vector<float> share = halves_ ? layer([&](std::size_t i) {
    const Samples by_sequence = sequence_samples(i);
    return by_sequence[0] && by_sequence[1] ? mean(by_sequence[0], by_sequence[0] + by_sequence[1]) : 1.0f;
  })
                                     : std::vector<float>();
  if (halves_) put("half.A", share);
  if (sees_emission()) take_emission(film);
  std::vector<float> count = layer([&](std::size_t i) { return static_cast<float>(samples(i)); });
  put("samples.Y", count);
  for (int k = 0; k < 3 && !clamped_[0].empty(); ++k) {
    for (std::size_t i = 0; i < pixel_count(); ++i) clamped_[k][i] = mean(clamped_[k][i], samples(i));
    put(std::string("clamped.") + kColor[k], clamped_[k]);
  }
  if (!depth_.empty()) take_features(film);
  if (passes_ > 0) add_passes(film);
  *this = Accumulator(width_, height_);
  return film;
}

void Accumulator::take_emission(Film& film) {
  for (int k = 0; k < 3; ++k)
    film.channels.push_back({std::string("emission.") + kColor[k],
                             layer([&](std::size_t i) { return static_cast<float>(seen_by_all(i, k)); })});
  if (!halves_) return;
  for (int k = 0; k < 3; ++k)
    film.channels.push_back({std::string("half.emission.") + kColor[k], layer([&](std::size_t i) {
                               const Samples by_sequence = sequence_samples(i);
                               return static_cast<float>(by_sequence[0] && by_sequence[1]
                                                             ? seen_by(0, i, k, by_sequence)
                                                             : seen_by_all(i, k));
                             })});
}

void Accumulator::take_features(Film& film) {
  if (feature_samples_ % pixel_count() != 0) throw Error::failed("film: not every pixel has its features");
  const auto count = static_cast<std::uint32_t>(feature_samples_ / pixel_count());
  const auto put = [&](const std::string& name, std::vector<float>& values) {
    film.channels.push_back({name, std::move(values)});
  };
  for (int k = 0; k < 3; ++k) {
    for (float& value : albedo_[k]) value = mean(value, count);
    put(std::string("albedo.") + kColor[k], albedo_[k]);
  }
  for (std::size_t i = 0; i < pixel_count(); ++i) {
    const std::array<float, 3> normal = unit_or_none({normal_[0][i], normal_[1][i], normal_[2][i]});
    for (std::size_t k = 0; k < 3; ++k) normal_[k][i] = normal[k];
    // Over the samples that hit: half a pixel of sky does not halve a distance.
    depth_[i] = hits_[i] > 0 ? depth_[i] / hits_[i] : 0.0f;
  }
  for (int k = 0; k < 3; ++k) put(std::string("normal.") + kAxis[k], normal_[k]);
  put("depth.Z", depth_);
}

void Accumulator::add_passes(Film& film) {
  const auto n = static_cast<float>(passes_);
  for (std::size_t k = 0; k < 3; ++k) {
    std::vector<float>* half = halves_ ? &film.channel(std::string("half.") + kColor[k]).values : nullptr;
    const std::vector<float>* share = halves_ ? &film.channel("half.A").values : nullptr;
    std::vector<float>& indirect = film.channel(std::string("indirect.") + kColor[k]).values;
    const std::vector<float>& direct = film.channel(std::string("direct.") + kColor[k]).values;
    std::vector<float>& all = film.channel(kColor[k]).values;
    std::vector<float>& variance = film.channel(std::string("variance.") + kColor[k]).values;
    for (std::size_t i = 0; i < all.size(); ++i) {
      const float sum = pass_sum_[3 * i + k];
      if (half && passes_ > 1) {
        // Halves of the passes have the shares that the samples' have, so that nothing of one is in the other.
        const auto even = static_cast<float>((passes_ + 1) / 2), odd = static_cast<float>(passes_ / 2);
        const float first = pass_half_[3 * i + k] / even, second = (sum - pass_half_[3 * i + k]) / odd;
        (*half)[i] += first;
        indirect[i] += (*share)[i] * first + (1 - (*share)[i]) * second;
      } else {
        // A single pass is in both halves: what it is off by, they do not tell.
        if (half) (*half)[i] += sum;
        indirect[i] += sum / n;
      }
      all[i] = direct[i] + indirect[i];
      // Between the passes; a single one tells nothing of itself.
      if (passes_ > 1) {
        const float square = sum * sum / n;
        const float deviations = std::isfinite(square) ? std::max(0.0f, pass_square_[3 * i + k] - square) : square;
        variance[i] = bounded(variance[i] + deviations / (n * (n - 1)));
      }
    }
  }
}

}  // namespace gleaner::coordinator

#pragma once
// What all methods' records add up to, pixel by pixel: means, the variance of the mean, the live preview, the film's
// layers. Samples come in independently scrambled chunks; what a method adds in passes (independent pictures of a part
// of the light) is averaged over the passes.

#include <cstdint>
#include <span>
#include <vector>

#include "coordinator/film/film.h"

namespace gleaner::coordinator {

// What is known of a pixel: the variance of one chunk of samples (mean over the channels), and how many chunks it has.
// Radiance is in any one unit, such that squares are finite.
struct PixelNoise {
  std::vector<float> chunk_variance;  // width * height, finite, not negative
  std::vector<std::uint32_t> chunks;  // width * height
  std::uint32_t width = 0, height = 0;
  std::vector<float> mean{};  // radiance (mean over the channels), width * height; empty: not known
  float chunk_samples = 1;
};

// Sums over a chunk's samples that hit anything, as layers show them.
struct FeatureSums {
  float albedo[3], normal[3];
  float depth;  // metres along the camera ray
  float hits;   // samples that hit anything
};

class Accumulator {
 public:
  Accumulator(std::uint32_t width, std::uint32_t height);

  // One record: sums over `samples` samples of a pixel's chunk; `whole`: a chunk of full size, which noise() may count.
  void add(std::uint32_t pixel, std::uint32_t chunk, const float direct[3], const float indirect[3],
           std::uint32_t samples, bool whole);
  void add_features(std::uint32_t pixel, const FeatureSums& features, std::uint32_t samples);
  // Of the sums that add() got, the part that compensates the bounded geometry term of virtual point lights.
  void add_clamped(std::uint32_t pixel, const float clamped[3]);
  // A pass: indirect radiance, RGB of every pixel.
  void add_pass(std::span<const float> rgb);
  std::uint32_t passes() const { return passes_; }

  // The sample variance of whole chunks' means, mean over the channels; 0 for pixels of fewer than two. Chunks of one
  // sequence repel each other, so that it overstates what more of them would leave: a guide to where the noise is.
  PixelNoise noise() const;
  // What the picture's squared error, the mean over pixels and channels, stays below in 97.7 % of pictures: the
  // estimate from the pixels' variances and two standard deviations more. Of the samples, without the passes.
  double squared_error_bound() const;
  double mean_radiance() const;

  // For the preview alone: sums over samples of a pixel; a pixel's radiance in the pass that is being rendered.
  void draw_samples(std::uint32_t pixel, const float direct[3], const float indirect[3], std::uint32_t samples);
  void draw_pass(std::uint64_t first_pixel, std::span<const float> rgb);
  Film preview() const;

  // Layers R G B, direct.*, indirect.*, variance.*, samples.Y and, where features were added, albedo.*, normal.*,
  // depth.Z; where add_clamped() was called, clamped.* (a part of indirect.*).
  Film film() const;

 private:
  struct Pixel {
    double direct[3] = {}, indirect[3] = {};  // sums over samples
    double sequence[2][3] = {};               // the same sums by sequence
    double mean[3] = {}, square[3] = {};      // Welford over chunk means
    std::uint32_t samples = 0, chunks = 0, sequence_samples[2] = {};

    double variance(int k) const;   // of the mean; 0 where a sequence is empty
    double radiance() const;        // mean over samples and channels
    double chunk_variance() const;  // of a chunk's mean, mean over the channels
  };
  struct Features {
    float albedo[3] = {}, normal[3] = {}, depth = 0, hits = 0;
    std::uint32_t samples = 0;
  };
  struct PreviewPixel {
    float sum[3] = {};
    float samples = 0;
  };
  void add_passes(Film& film) const;
  void add_feature_layers(Film& film) const;

  std::size_t pixel_count() const { return std::size_t{width_} * height_; }

  std::uint32_t width_, height_;
  std::vector<Pixel> pixels_;  // from the first samples on
  std::vector<Features> features_;
  std::vector<float> clamped_;                 // RGB sums
  std::vector<float> pass_sum_, pass_square_;  // RGB over the passes
  std::uint32_t passes_ = 0;
  std::vector<PreviewPixel> preview_;
  std::vector<float> preview_pass_;

 public:
  // Of memory, at most: what is held, the film's layers, and twice the file that is made of them.
  static constexpr std::uint64_t bytes_a_pixel =
      sizeof(Pixel) + sizeof(Features) + sizeof(PreviewPixel) + 3 * 23 * sizeof(float);
};

}  // namespace gleaner::coordinator

#pragma once
// What all methods' records add up to, pixel by pixel: means, the variance of the mean, the live preview, the film's
// layers. Samples come in independently scrambled chunks; what a method adds in passes (independent pictures of a part
// of the light) is averaged over the passes.
//
// A film may have many millions of pixels. What is held of each is listed below, array by array, and take_film() turns
// it into the layers in place.

#include <array>
#include <cstdint>
#include <map>
#include <span>
#include <vector>

#include "coordinator/film/film.h"

namespace gleaner::coordinator {

// What is known of a pixel: the variance of one chunk of samples (mean over the channels), and how many chunks it has.
struct PixelNoise {
  std::vector<float> chunk_variance;  // width * height, not negative
  std::vector<std::uint32_t> chunks;  // width * height; short ones included
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
  // The film shall tell apart two independent halves of what it is made of. Before anything is added.
  void keep_halves() { halves_ = true; }

  // One record: sums over `samples` samples of a pixel's chunk; `whole`: a chunk of full size, which noise() may count.
  // All whole chunks of a film have one size, else Error::failed is thrown.
  void add(std::uint32_t pixel, std::uint32_t chunk, const float direct[3], const float indirect[3],
           std::uint32_t samples, bool whole);
  // When the film is taken, all pixels must have had as many samples here.
  void add_features(std::uint32_t pixel, const FeatureSums& features, std::uint32_t samples);
  // Of the sums that add() got, the part that compensates the bounded geometry term of virtual point lights.
  void add_clamped(std::uint32_t pixel, const float clamped[3]);
  // Emission seen directly, a sum over the samples of a chunk. add() gets the rest of their light alone.
  void add_seen(std::uint32_t pixel, std::uint32_t chunk, const float emission[3]);
  // The same by `samples` rays of the pixel's sequence chunk % 2 that look for nothing else: where there are more of
  // them than samples of that sequence, they say what is seen.
  void add_seen_alone(std::uint32_t pixel, std::uint32_t chunk, const float emission[3], std::uint32_t samples);
  // What the samples of one sequence, 0 or 1, have seen: radiance, mean over the channels.
  std::vector<float> seen(std::size_t sequence) const;
  // A pass: indirect radiance, RGB of every pixel.
  void add_pass(std::span<const float> rgb);
  std::uint32_t passes() const { return passes_; }

  // The sample variance of whole chunks' means, mean over the channels; 0 for pixels of fewer than two. Chunks of one
  // sequence repel each other, so that it overstates what more of them would leave: a guide to where the noise is.
  // Without what is seen directly.
  PixelNoise noise() const;
  // What the picture's squared error, the mean over pixels and channels, stays below in 97.7 % of pictures: the
  // estimate from the pixels' variances and two standard deviations more. Of the samples, without the passes.
  double squared_error_bound() const;
  double mean_radiance() const;
  double mean_albedo() const;  // of what the samples with features saw so far; 0: there are none

  // For the preview alone: a pixel's radiance in the pass that is being rendered.
  void draw_pass(std::uint64_t first_pixel, std::span<const float> rgb);
  // R G B of the samples so far, and of that pass. With guides: the albedo and normals of those samples too, where all
  // pixels have some.
  Film preview(bool guides = false) const;

  // Layers R G B, direct.*, indirect.*, variance.*, samples.Y and, where features were added, albedo.*, normal.*,
  // depth.Z; where add_clamped() was called, clamped.* (a part of indirect.*); where halves are kept, half.* (radiance
  // by the first half alone) and half.A (its share of the samples, in [0, 1]). Where something was seen directly,
  // emission.* (a part of direct.*) and half.emission.* (by the first half alone).
  Film film() const;
  // The same without the passes.
  Film film_of_samples() const;
  // film(). The layers take the place of what they are made of: afterwards nothing is left here.
  Film take_film();
  // The layers R G B of that alone; where halves are kept, all layers.
  Film take_picture();

 private:
  using Samples = std::array<std::uint32_t, 2>;  // by sequence
  struct ShortChunks {
    Samples samples{};
    std::uint32_t chunks = 0;
  };
  template <typename Value>
  using Channels = std::array<std::vector<Value>, 3>;

  std::size_t pixel_count() const { return std::size_t{width_} * height_; }
  bool sampled() const { return !square_.empty(); }
  Samples sequence_samples(std::size_t pixel) const;
  std::uint32_t samples(std::size_t pixel) const;
  double radiance(std::size_t pixel) const;         // mean over the channels
  double chunk_variance(std::size_t pixel) const;   // of whole chunks' means, mean over the channels
  double variance(std::size_t pixel, int k) const;  // of the mean; 0 where a sequence is empty
  template <typename Value>
  std::vector<float> layer(const Value& value) const;
  bool sees_emission() const { return !seen_[0][0].empty(); }
  double seen_by(std::size_t sequence, std::size_t pixel, int k, const Samples& samples) const;  // mean radiance
  // Of both sequences, in the shares that their samples have.
  double seen_by_all(std::size_t pixel, int k) const;
  void take_emission(Film& film);
  void take_features(Film& film);
  void add_passes(Film& film);

  std::uint32_t width_, height_;
  std::uint32_t chunk_samples_ = 0;  // of a whole chunk; 0: none has come
  // From the first samples on:
  Channels<double> direct_, indirect_;  // sums over samples
  Channels<double> first_;              // of those of the first of two sequences, direct and indirect light together
  std::vector<double> square_;          // squared deviations of whole chunks' means, summed over chunks and channels
  std::vector<Samples> whole_;          // whole chunks, by sequence
  std::map<std::uint32_t, ShortChunks> short_;  // by pixel; a stage has one at most
  // From the first emission that is seen on: sums over samples, by sequence.
  std::array<Channels<float>, 2> seen_;
  struct SeenAlone {
    double sums[3] = {};
    std::uint32_t samples = 0;
  };
  std::array<std::map<std::uint32_t, SeenAlone>, 2> seen_alone_;  // by sequence and pixel; of few pixels
  // From the first features on: sums.
  Channels<float> albedo_, normal_;
  std::vector<float> depth_, hits_;
  std::uint64_t feature_samples_ = 0;          // of all pixels
  Channels<float> clamped_;                    // sums
  std::vector<float> pass_sum_, pass_square_;  // RGB over the passes
  std::vector<float> pass_half_;               // of passes 0, 2, 4 and so on, where halves are kept
  std::uint32_t passes_ = 0;
  bool halves_ = false;
  std::vector<float> preview_pass_;

 public:
  // Memory that a pixel takes at most while samples and features are added. A film has as much or less.
  static constexpr std::uint64_t bytes_a_pixel = 10 * sizeof(double) + sizeof(Samples) + 8 * sizeof(float);
};

}  // namespace gleaner::coordinator

#pragma once
// What the path tracer's records add up to, pixel by pixel: means, the variance of the mean from independently
// scrambled chunks of samples, features.

#include <cstdint>
#include <vector>

#include "coordinator/film/film.h"
#include "coordinator/plan/allocation.h"
#include "kernels/path_records.h"

namespace gleaner::coordinator {

class PathFilm {
 public:
  PathFilm(std::uint32_t width, std::uint32_t height);

  // One record: sums over `samples` samples of a pixel's chunk; `whole`: a chunk of full size, which noise() may count.
  void add(std::uint32_t pixel, std::uint32_t chunk, const float direct[3], const float indirect[3],
           std::uint32_t samples, bool whole);
  void add_features(std::uint32_t pixel, const kernels::PathFeatureRecord& record, std::uint32_t samples);
  // Of the sums that add() got, what the paths gave back of virtual point lights' clamped light.
  void add_clamped(std::uint32_t pixel, const float clamped[3]);

  // The sample variance of whole chunks' means, mean over the channels; 0 for pixels of fewer than two. Chunks of one
  // sequence repel each other, so that it overstates what more of them would leave: a guide to where the noise is.
  PixelNoise noise() const;
  // What the picture's squared error, the mean over pixels and channels, stays below in 97.7 % of pictures: the
  // estimate from the pixels' variances and two standard deviations more.
  double squared_error_bound() const;
  double mean_radiance() const;

  // Layers R G B, direct.*, indirect.*, variance.*, samples.Y and, where features were added, albedo.*, normal.*,
  // depth.Z; where add_clamped() was called, clamped.* (a part of indirect.*).
  Film film() const;

 private:
  struct Pixel {
    double direct[3] = {}, indirect[3] = {};  // sums over samples
    double sequence[2][3] = {};               // the same sums by sequence
    double mean[3] = {}, square[3] = {};      // Welford over chunk means
    std::uint32_t samples = 0, chunks = 0, sequence_samples[2] = {};

    double variance(int k) const;  // of the mean; 0 where a sequence is empty
  };
  struct Features {
    float albedo[3] = {}, normal[3] = {}, depth = 0, hits = 0;
    std::uint32_t samples = 0;
  };
  std::uint32_t width_, height_;
  std::vector<Pixel> pixels_;
  std::vector<Features> features_;
  std::vector<float> clamped_;  // RGB sums

 public:
  // Of memory, at most: what is held, the film's layers, and twice the file that is made of them.
  static constexpr std::uint64_t bytes_a_pixel = sizeof(Pixel) + sizeof(Features) + 3 * 23 * sizeof(float);
};

}  // namespace gleaner::coordinator

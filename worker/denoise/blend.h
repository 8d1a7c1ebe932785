#pragma once
// How good is a denoised picture? Two independent halves of the samples, denoised apart, tell it by cross-validation:
// what one half became is compared with the other half, which knows nothing of it (Rousselle, Knaus & Zwicker 2012;
// Bitterli et al. 2016). Where the raw picture is better it is taken (after Firmino, Frisvad & Jensen 2022).

#include <cstdint>
#include <span>
#include <vector>

namespace gleaner::worker {

// Radiance, 3 floats a pixel, row by row.
struct Halves {
  std::uint32_t width = 0, height = 0;
  std::span<const float> first, second;                    // as sampled
  std::span<const float> denoised_first, denoised_second;  // each from its own half alone
  std::span<const float> share;                            // of the first half in the samples, one a pixel, in [0, 1]
};

struct BlendedPicture {
  std::vector<float> color;          // 3 a pixel
  std::vector<float> squared_error;  // that it is expected to have, mean over the channels, smoothed; one a pixel
  double error = 0, deviation = 0;   // mean of the squared error before it is smoothed, and that estimate's deviation
  double denoised = 0;               // share of the picture that is denoised
};

BlendedPicture blend(const Halves& halves);

}  // namespace gleaner::worker

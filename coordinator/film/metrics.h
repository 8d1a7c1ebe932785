#pragma once
// How far a picture is from a reference. Errors are over all pixels and channels of a layer, in linear radiance.
//
// A reference has noise of its own. Where its standard error is known for each value, the mean of its squares is taken
// off the squared differences (picture and reference are independent, so the squares add). What is left may be
// negative: the picture is then nearer than the reference can tell.

#include <array>
#include <cstddef>
#include <optional>
#include <string>
#include <vector>

#include "coordinator/film/film.h"

namespace gleaner::coordinator {

struct Picture {
  const Film& film;
  std::string name;  // what error messages call it: the file
};

struct ChannelMeans {
  std::string name;
  double test = 0, reference = 0;
  double deviation = 0;          // (test - reference) / reference; the plain difference where the reference is black
  std::optional<double> sigmas;  // the difference over its standard error, where one is known
};

struct LayerComparison {
  std::string name;  // "" is the picture itself: R, G, B
  double mean = 0;   // of the reference: what `error` and `bias` are divided by, unless it is not above 0
  double test_mean = 0;
  double mse = 0;           // the reference's noise taken off: may be negative
  double mse_measured = 0;  // as seen
  double rmse = 0;          // root of mse; 0 where mse is negative
  double error = 0;         // rmse / mean
  double error_robust = 0;  // the same without the 0.1 % of the pixels that differ most, both terms; mean of all pixels
  double relmse = 0;        // mean of d^2 / (reference^2 + 0.01 mean^2), as seen
  double bias = 0;          // (test_mean - mean) / mean
  std::optional<double> psnr;  // dB: 10 log10(peak^2 / mse), peak = the reference's largest value; none where mse <= 0
  std::vector<ChannelMeans> channels;
};

// Blocks of 16 x 16 pixels (fewer at the right and lower edge). A block is off where in some channel its mean differs
// by more than 5 standard errors and by more than 1 % of the reference's mean there.
struct BlockComparison {
  std::size_t count = 0, off = 0;
  double share() const { return double(off) / double(count); }
  std::size_t worst_x = 0, worst_y = 0;  // the block's upper left pixel
  double worst_sigmas = 0;               // among the blocks that are off; 0 where none is
};

struct Comparison {
  LayerComparison picture;
  std::vector<LayerComparison> layers;    // what else both have: direct, indirect, variance, ...
  double reference_noise = 0;             // mean square of the reference's standard error
  std::optional<BlockComparison> blocks;  // where a standard error of either is known
  // Mean of the picture's variance layer (of a denoised one, its error layer) over its squared error as seen less the
  // reference's noise: 1 where the variance is told truly. Robust: without the 0.1 % of the pixels that differ most.
  // None where there is no such layer, or mse <= 0.
  std::optional<double> variance_ratio, variance_ratio_robust;
};

// What a picture says of itself: the mean of its radiance, and the standard error that its variance layer tells, as
// `error` counts (root of the mean variance, over the mean). Throws like compare().
struct OwnNoise {
  double mean = 0;
  std::optional<double> standard_error;  // none without a variance layer; of a denoised picture, its expected error
  bool denoised = false;                 // that was told by its error layer
};
OwnNoise own_noise(const Picture& picture);

// `reference_error` (may be null) holds the standard error of the reference's R, G, B. Throws Error::bad_input naming
// the file where sizes differ, R, G or B is missing, or a value is not finite (with the first such pixel, and how
// many).
Comparison compare(const Picture& test, const Picture& reference, const Picture* reference_error);

}  // namespace gleaner::coordinator

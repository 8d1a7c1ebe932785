#pragma once
// Where an adaptive method spends its next samples.

#include <cstdint>
#include <vector>

#include "coordinator/film/accumulator.h"

namespace gleaner::coordinator {

// For each pixel the mean of its neighbours' variances in a (2 radius + 1)^2 window, as far as they are of the other
// colour of a chessboard; 1 where it has none (a picture of one pixel).
std::vector<float> neighbours_variance(const PixelNoise& noise, int radius);

// What samples a pixel, given out by their noise, are off by, were there one of each: the mean of the roots of what
// neighbours_variance() tells, whose square over their number is the least mean variance. 0: not known, for a pixel has
// fewer than two chunks.
double sample_error(const PixelNoise& noise, int radius);

// For each pixel the variance that a chunk would have if an edge ran through it: that of its four neighbours' means,
// all of the other colour. A lamp's edge seen by a few samples looks quiet or, in one pixel of many, glares; its
// neighbours know better. Nothing where means are not known.
std::vector<float> edge_variance(const PixelNoise& noise);

// Further chunks a pixel, `extra` in all. The sum over the pixels of variance / chunks is least where chunks go as the
// square root of the variance (Lagrange); pixels that have more than their share already keep what they have. What
// rounding down leaves goes, one chunk each, to where it takes most off. Deterministic. Throws Error::failed for a
// variance that is negative or not finite.
std::vector<std::uint32_t> allocate_chunks(const std::vector<float>& variance, const std::vector<std::uint32_t>& chunks,
                                           std::uint64_t extra);

// For each pixel, chunks to come and chunks that it has.
struct Allocation {
  std::vector<std::uint32_t> more, chunks;
};

// The same by what the noise seen so far says. Where its own samples decided how many more a pixel gets, its mean would
// be biased: dark beginnings would stay dark, and a bright one, which draws samples to its neighbours, would go short
// itself. So each colour of a chessboard has its own half of `extra`, given out by what the other colour's samples say.
Allocation allocate_by_noise(PixelNoise noise, std::uint64_t extra, int radius);

}  // namespace gleaner::coordinator

#pragma once
// What a denoiser leaves of the noise of paths, for methods whose own errors it does not see.

#include <algorithm>
#include <cmath>

namespace gleaner::coordinator {

// Of the paths' squared error, the part that a denoiser leaves. Of 8 samples it was 0.02 to 0.03 (Cornell boxes,
// modern-hall, `fast`); it falls more slowly than noise does.
inline constexpr double kNoiseLeft = 0.02;

// Of pictures of so many samples a pixel.
inline double noise_left(double spp) { return std::min(1.0, kNoiseLeft * std::sqrt(spp)); }

}  // namespace gleaner::coordinator

#pragma once
// A few pixels, spread over a picture, whose points stand for all.

#include <algorithm>
#include <cstdint>

#include "kernels/vpl_records.h"

namespace gleaner::coordinator {

// Every how many-th pixel has points (VplPointParameters), and how many that makes: of about `wanted` pixels, or some
// more.
inline void spread_points(kernels::VplPointParameters& p, std::uint64_t wanted) {
  const std::uint64_t pixels = std::uint64_t{p.width} * p.height;
  p.stride = static_cast<std::uint32_t>(std::max<std::uint64_t>(1, pixels / wanted));
  // Neither even nor a divisor of the width: points in columns would leave the rest of the picture unseen.
  if (p.stride > 1) {
    p.stride |= 1;
    while (p.width % p.stride == 0) p.stride += 2;
  }
  p.items_low = static_cast<std::uint32_t>((pixels + p.stride - 1) / p.stride * std::max(1u, p.points));
}

}  // namespace gleaner::coordinator

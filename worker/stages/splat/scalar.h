#pragma once
// kernels/splat/weight.h for one point at a time.

#include <cmath>

namespace gleaner::worker::splat {

using vf = float;
using vi = bool;
using std::sqrt;
inline float max_f(float a, float b) { return a > b ? a : b; }

#define FN inline
#include "kernels/splat/weight.h"
#undef FN

}  // namespace gleaner::worker::splat

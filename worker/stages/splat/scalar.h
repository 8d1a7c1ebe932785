#pragma once
// kernels/splat/weight.h for one point at a time.

#include <cmath>

#include "kernels/splat_records.h"  // which weight.h includes: not within the namespace

namespace gleaner::worker::splat {

using vf = float;
using vi = bool;
using std::fabs;
using std::sqrt;
inline float max_f(float a, float b) { return a > b ? a : b; }
inline float pick(float otherwise, float where, bool m) { return m ? where : otherwise; }

#define FN inline
#include "kernels/splat/weight.h"
#undef FN

}  // namespace gleaner::worker::splat

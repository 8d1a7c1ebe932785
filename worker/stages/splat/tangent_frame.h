#pragma once
// The frame about a normal that records' directions, gradients and shapes are in.

#include <array>

namespace gleaner::worker {

// basis3() of kernels/vec3.h, after Duff et al. 2017.
struct TangentFrame {
  using Vec = std::array<double, 3>;
  explicit TangentFrame(const std::array<float, 3>& normal)
      : n{double{normal[0]}, double{normal[1]}, double{normal[2]}} {
    const double sign = n[2] >= 0 ? 1 : -1, a = -1 / (sign + n[2]), b = n[0] * n[1] * a;
    s = {1 + sign * n[0] * n[0] * a, sign * b, -sign * n[0]};
    t = {b, sign + n[1] * n[1] * a, -n[1]};
  }
  Vec world(double x, double y) const { return {x * s[0] + y * t[0], x * s[1] + y * t[1], x * s[2] + y * t[2]}; }

  Vec n, s{}, t{};
};

}  // namespace gleaner::worker

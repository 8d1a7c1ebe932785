#pragma once
// Arithmetic of three components on the host.

#include <array>

namespace gleaner::worker {

template <typename T>
T dot(const std::array<T, 3>& a, const std::array<T, 3>& b) {
  return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

}  // namespace gleaner::worker

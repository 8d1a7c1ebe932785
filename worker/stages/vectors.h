#pragma once
// Arithmetic of three components on the host.

#include <array>
#include <cmath>
#include <type_traits>

namespace gleaner::worker {

template <typename T>
std::array<T, 3> operator+(const std::array<T, 3>& a, const std::array<T, 3>& b) {
  return {a[0] + b[0], a[1] + b[1], a[2] + b[2]};
}

template <typename T>
std::array<T, 3> operator-(const std::array<T, 3>& a, const std::array<T, 3>& b) {
  return {a[0] - b[0], a[1] - b[1], a[2] - b[2]};
}

template <typename T>
std::array<T, 3> operator*(const std::array<T, 3>& a, std::type_identity_t<T> s) {
  return {a[0] * s, a[1] * s, a[2] * s};
}

template <typename T>
T dot(const std::array<T, 3>& a, const std::array<T, 3>& b) {
  return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

template <typename T>
std::array<T, 3> cross(const std::array<T, 3>& a, const std::array<T, 3>& b) {
  return {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
}

// No direction stays none.
template <typename T>
std::array<T, 3> unit(const std::array<T, 3>& a) {
  const T length = std::sqrt(dot(a, a));
  return length > 0 ? a * (1 / length) : a;
}

}  // namespace gleaner::worker

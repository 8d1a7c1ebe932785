#pragma once
// Affine maps in double precision.

#include <array>
#include <cmath>

namespace gleaner::scene {

using Vector = std::array<double, 3>;
using Matrix = std::array<double, 16>;  // column by column, the last row 0 0 0 1

inline constexpr Matrix kIdentity = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1};

inline Matrix product(const Matrix& a, const Matrix& b) {
  Matrix m{};
  for (int c = 0; c < 4; ++c)
    for (int r = 0; r < 4; ++r)
      for (int k = 0; k < 4; ++k) m[c * 4 + r] += a[k * 4 + r] * b[c * 4 + k];
  return m;
}

inline Vector column(const Matrix& m, int c) { return {m[c * 4], m[c * 4 + 1], m[c * 4 + 2]}; }

inline Vector cross(const Vector& a, const Vector& b) {
  return {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
}

inline double dot(const Vector& a, const Vector& b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

// Unit length, or zero where there is none to give.
inline Vector unit(const Vector& a) {
  const double length = std::hypot(a[0], a[1], a[2]);
  return length > 0 && std::isfinite(length) ? Vector{a[0] / length, a[1] / length, a[2] / length} : Vector{};
}

inline Vector transformed(const Matrix& m, const Vector& p) {
  Vector q;
  for (int c = 0; c < 3; ++c) q[c] = m[c] * p[0] + m[4 + c] * p[1] + m[8 + c] * p[2] + m[12 + c];
  return q;
}

inline bool is_mirror(const Matrix& m) { return dot(column(m, 0), cross(column(m, 1), column(m, 2))) < 0; }

inline bool is_finite(const Matrix& m) {
  for (const double x : m)
    if (!std::isfinite(x)) return false;
  return true;
}

// How normals turn: with the inverse transpose; up to a positive factor, that is the cofactors with the determinant's
// sign.
class NormalTransform {
 public:
  explicit NormalTransform(const Matrix& m) {
    const Vector x = column(m, 0), y = column(m, 1), z = column(m, 2);
    cofactors_[0] = cross(y, z), cofactors_[1] = cross(z, x), cofactors_[2] = cross(x, y);
    sign_ = dot(x, cofactors_[0]) < 0 ? -1 : 1;
  }
  // Unit length, or zero.
  Vector operator()(const Vector& n) const { return unit(turned(n)); }
  // Of any length.
  Vector turned(const Vector& n) const {
    Vector world;
    for (int c = 0; c < 3; ++c)
      world[c] = sign_ * (cofactors_[0][c] * n[0] + cofactors_[1][c] * n[1] + cofactors_[2][c] * n[2]);
    return world;
  }

 private:
  Vector cofactors_[3];
  double sign_ = 1;
};

}  // namespace gleaner::scene

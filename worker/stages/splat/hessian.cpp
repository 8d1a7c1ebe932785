#include "worker/stages/splat/hessian.h"
#include "worker/stages/vectors.h"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace gleaner::worker {
namespace {

using Vec = std::array<double, 3>;
// What rays do not meet is so many times as far as the nearest thing that they do.
constexpr double kFarthest = 1e4;

// Adds `factor` times the second derivatives of what the edge from a to b adds to the irradiance of normal z at the
// origin, as that moves by x and y. A polygon of unit radiance, whose edges turn about z as the azimuth does, brings
// the sum over its edges of theta / |a x b| (a x b).z / 2, theta the angle between a and b (Lambert). Both a x b and
// a.b are polynomials of the place: s = |a x b|^2, d = a.b, g(s, d) = theta / |a x b|.
void add_edge(const Vec& a, const Vec& b, double factor, TangentMatrix& hessian) {
  const Vec e = {b[0] - a[0], b[1] - a[1], b[2] - a[2]};
  const Vec c = {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
  const double s = dot(c, c), d = dot(a, b), q = s + d * d;
  if (!(s > 0)) return;
  const double root = std::sqrt(s), theta = std::atan2(root, d);
  const double gs = d / (2 * s * q) - theta / (2 * s * root), gd = -1 / q, gdd = 2 * d / (q * q), gsd = 1 / (q * q);
  const double gss = -d * (q + s) / (2 * s * s * q * q) - d / (4 * s * s * q) + 3 * theta / (4 * s * s * root);
  // By x and by y: of c.z, of s and of d.
  const double cz[2] = {-e[1], e[0]};
  const double si[2] = {2 * (c[1] * e[2] - c[2] * e[1]), 2 * (c[2] * e[0] - c[0] * e[2])};
  const double di[2] = {-(a[0] + b[0]), -(a[1] + b[1])};
  const double squared = dot(e, e);
  for (std::size_t k = 0; k < 3; ++k) {
    const std::size_t i = k == 2, j = k != 0;
    const double same = i == j, sij = 2 * (same * squared - e[i] * e[j]), dij = 2 * same;
    const double gij =
        gs * sij + gd * dij + gss * si[i] * si[j] + gsd * (si[i] * di[j] + si[j] * di[i]) + gdd * di[i] * di[j];
    hessian[k] += factor / 2 * (c[2] * gij + cz[i] * (gs * si[j] + gd * di[j]) + cz[j] * (gs * si[i] + gd * di[i]));
  }
}

}  // namespace

IrradianceHessian::IrradianceHessian(const HemisphereGrid& grid) : grid_(grid) {
  for (std::uint32_t j = 0; j <= grid.polar; ++j)
    for (std::uint32_t k = 0; k < grid.azimuthal; ++k) {
      const double squared = j / static_cast<double>(grid.polar), sine = std::sqrt(squared);
      const double phi = 2 * std::numbers::pi * k / grid.azimuthal;
      directions_.push_back({sine * std::cos(phi), sine * std::sin(phi), std::sqrt(1 - squared)});
    }
}

std::vector<Vec> IrradianceHessian::corners_of(std::span<const HemisphereSample> samples) const {
  const std::uint32_t around = grid_.azimuthal;
  double nearest = 0;
  for (const HemisphereSample& sample : samples) nearest = std::max(nearest, double{sample.nearness});
  if (!(nearest > 0)) return {};
  std::vector<double> nearness(directions_.size(), nearest / kFarthest);
  for (std::uint32_t j = 0; j < grid_.polar; ++j)
    for (std::uint32_t k = 0; k < around; ++k)
      for (const std::size_t corner : {index(j, k), index(j, k + 1), index(j + 1, k), index(j + 1, k + 1)})
        nearness[corner] = std::max(nearness[corner], double{samples[index(j, k)].nearness});
  // All corners of the first ring are one.
  std::fill_n(nearness.begin(), around, *std::max_element(nearness.begin(), nearness.begin() + around));
  std::vector<Vec> corners = directions_;
  for (std::size_t i = 0; i < corners.size(); ++i)
    for (double& value : corners[i]) value /= nearness[i];
  return corners;
}

TangentMatrix IrradianceHessian::relative(std::span<const HemisphereSample> samples) const {
  const std::vector<Vec> corners = corners_of(samples);
  if (corners.empty()) return {};
  std::vector<double> light;
  light.reserve(samples.size());
  double sum = 0;
  for (const HemisphereSample& sample : samples) {
    light.push_back(double{sample.radiance[0]} + sample.radiance[1] + sample.radiance[2]);
    sum += light.back();
  }
  const double irradiance = std::numbers::pi * sum / static_cast<double>(samples.size());
  if (!(irradiance > 0)) return {};
  TangentMatrix hessian{};
  for (std::uint32_t j = 0; j < grid_.polar; ++j)
    for (std::uint32_t k = 0; k < grid_.azimuthal; ++k) {
      const double here = light[index(j, k)];
      if (j > 0)
        if (const double change = here - light[index(j - 1, k)]; change != 0)
          add_edge(corners[index(j, k)], corners[index(j, k + 1)], -change, hessian);
      if (const double change = here - light[index(j, k + grid_.azimuthal - 1)]; change != 0)
        add_edge(corners[index(j, k)], corners[index(j + 1, k)], change, hessian);
    }
  for (double& value : hessian) value /= irradiance;
  return hessian;
}

}  // namespace gleaner::worker

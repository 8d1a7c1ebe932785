#include "worker/stages/splat/lobe_table.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>

#include "worker/stages/splat/harmonics.h"

namespace gleaner::worker {
namespace {

constexpr std::uint32_t kPolar = 48, kAzimuthal = 48;

// GGX with separable Smith masking (kernels/bsdf/lobe.h), times the light's cosine, over Schlick's two colours.
std::array<double, 2> lobe(double alpha, double nv, double nl, double phi) {
  const double sv = std::sqrt(1 - nv * nv), sl = std::sqrt(1 - nl * nl), vl = nv * nl + sv * sl * std::cos(phi);
  const double a2 = alpha * alpha, length2 = 2 + 2 * vl;  // of v + l
  const double nh2 = (nv + nl) * (nv + nl) / length2, vh = std::sqrt(length2) / 2;
  const double t = (1 - nh2) / a2 + nh2, d = 1 / (std::numbers::pi * a2 * t * t);
  const double gv = nv + std::sqrt((1 - a2) * nv * nv + a2), gl = nl + std::sqrt((1 - a2) * nl * nl + a2);
  const double value = d / (gv * gl) * nl, grazing = std::pow(std::max(0.0, 1 - vh), 5);
  return {value * (1 - grazing), value * grazing};
}

// A lobe's row, by the midpoint rule in the azimuth and equal steps of theta.
void project(std::uint32_t order, double alpha, double nv, float* row) {
  const std::uint32_t pairs = harmonic_pairs(order);
  std::vector<double> sums(2 * std::size_t{pairs}), polar(pairs);
  for (std::uint32_t j = 0; j < kPolar; ++j) {
    const double theta = std::numbers::pi / 2 * (j + 0.5) / kPolar, nl = std::cos(theta);
    hemispherical_harmonics(order, nl, polar);
    // Both halves of the azimuth are alike.
    const double weight = 2 * std::sin(theta) * std::numbers::pi / 2 / kPolar * std::numbers::pi / kAzimuthal;
    std::vector<double> turns(2 * std::size_t{order});
    for (std::uint32_t k = 0; k < kAzimuthal; ++k) {
      const double phi = std::numbers::pi * (k + 0.5) / kAzimuthal;
      const auto [a, b] = lobe(alpha, nv, nl, phi);
      for (std::uint32_t m = 0; m < order; ++m) {
        const double c = std::cos(m * phi) * weight;
        turns[2 * m] += a * c;
        turns[2 * m + 1] += b * c;
      }
    }
    for (std::uint32_t l = 0; l < order; ++l)
      for (std::uint32_t m = 0; m <= l; ++m) {
        const std::uint32_t pair = l * (l + 1) / 2 + m;
        sums[pair] += polar[pair] * turns[2 * m];
        sums[pairs + pair] += polar[pair] * turns[2 * m + 1];
      }
  }
  for (std::size_t i = 0; i < sums.size(); ++i) row[i] = static_cast<float>(sums[i]);
}

}  // namespace

std::vector<float> make_lobe_table(std::uint32_t order) {
  std::vector<float> table(std::size_t{LOBE_TABLE_ALPHAS} * LOBE_TABLE_VIEWS * LOBE_TABLE_WORDS(order));
  for (std::uint32_t a = 0; a < LOBE_TABLE_ALPHAS; ++a)
    for (std::uint32_t v = 0; v < LOBE_TABLE_VIEWS; ++v) {
      const double alpha = std::pow(double{LOBE_TABLE_LEAST}, 1 - a / (LOBE_TABLE_ALPHAS - 1.0));
      const double nv = std::cos(std::numbers::pi / 2 * v / (LOBE_TABLE_VIEWS - 1.0));
      project(order, alpha, std::max(nv, 1e-3),
              &table[(std::size_t{a} * LOBE_TABLE_VIEWS + v) * LOBE_TABLE_WORDS(order)]);
    }
  return table;
}

}  // namespace gleaner::worker

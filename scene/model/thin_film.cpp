#include "scene/model/thin_film.h"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace gleaner::scene {
namespace {

constexpr double kPi = std::numbers::pi;

double schlick(double f0, double cosine) { return f0 + (1 - f0) * std::pow(1 - cosine, 5); }

double interface_f0(double a, double b) { return (a - b) * (a - b) / ((a + b) * (a + b)); }

// The colour of a cosine of wavelength: Gaussian fits of the CIE 1931 functions in Fourier space (the paper's section
// 4). `path`: optical path difference in metres.
std::array<double, 3> sensitivity(double path, const std::array<double, 3>& shift) {
  const double phase = 2 * kPi * path;
  const auto peak = [phase](double value, double position, double variance, double turn) {
    return value * std::sqrt(2 * kPi * variance) * std::cos(position * phase + turn) *
           std::exp(-phase * phase * variance) / 1.0685e-7;
  };
  const double x = peak(5.4856e-13, 1.6810e6, 4.3278e9, shift[0]) + peak(9.7470e-14, 2.2399e6, 4.5282e9, shift[0]);
  const double y = peak(4.4201e-13, 1.7953e6, 9.3046e9, shift[1]);
  const double z = peak(5.2481e-13, 2.2084e6, 6.6121e9, shift[2]);
  return {3.2404542 * x - 1.5371385 * y - 0.4985314 * z, -0.9692660 * x + 1.8760108 * y + 0.0415560 * z,
          0.0556434 * x - 0.2040259 * y + 1.0572252 * z};
}

}  // namespace

std::array<double, 3> thin_film(double cosine, double film_ior, double thickness, const std::array<double, 3>& f0) {
  const double t = std::clamp(thickness / 0.03, 0.0, 1.0);
  film_ior = std::lerp(1.0, film_ior, t * t * (3 - 2 * t));
  const double cosine2_squared = 1 - (1 - cosine * cosine) / (film_ior * film_ior);
  if (cosine2_squared < 0) return {1, 1, 1};
  const double cosine2 = std::sqrt(cosine2_squared);
  const double r12 = schlick(interface_f0(film_ior, 1), cosine), t121 = 1 - r12;
  std::array<double, 3> reflected, order, ratio, shift;
  for (int c = 0; c < 3; ++c) {
    const double root = std::sqrt(std::clamp(f0[c], 0.0, 0.9999)), base_ior = (1 + root) / (1 - root);
    const double r23 = schlick(interface_f0(base_ior, film_ior), cosine2);
    const double r123 = std::clamp(r12 * r23, 1e-5, 0.9999), rs = t121 * t121 * r23 / (1 - r123);
    shift[c] = base_ior < film_ior ? 2 * kPi : kPi;
    reflected[c] = r12 + rs;
    order[c] = rs - t121;
    ratio[c] = std::sqrt(r123);
  }
  for (int m = 1; m <= 2; ++m) {
    const std::array<double, 3> color =
        sensitivity(m * 2 * film_ior * thickness * 1e-9 * cosine2, {m * shift[0], m * shift[1], m * shift[2]});
    for (int c = 0; c < 3; ++c) {
      order[c] *= ratio[c];
      reflected[c] += 2 * order[c] * color[c];
    }
  }
  for (double& r : reflected) r = std::clamp(r, 0.0, 1.0);
  return reflected;
}

}  // namespace gleaner::scene

#include "scene/model/albedo.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstdint>
#include <numbers>
#include <vector>

namespace gleaner::scene {
namespace {

constexpr std::uint32_t kSamples = 4096;  // a power of two: the second coordinate is its index, bits reversed
constexpr int kLanes = 8;                 // independent sums, so that the compiler may vectorize without reordering

double node(int i) { return (i + 0.5) / GLEANER_ALBEDO_NODES; }

struct Points {
  std::vector<double> cosine, sine, height;  // of phi = 2 pi u1; u2
};

template <std::uint32_t Samples>
const Points& hammersley() {
  static const Points points = [] {
    Points p;
    for (std::uint32_t i = 0; i < Samples; ++i) {
      std::uint32_t reversed = 0;
      for (int bit = 0; bit < std::countr_zero(Samples); ++bit) reversed = reversed << 1 | (i >> bit & 1);
      const double phi = 2 * std::numbers::pi * (i + 0.5) / Samples;
      p.cosine.push_back(std::cos(phi));
      p.sine.push_back(std::sin(phi));
      p.height.push_back((reversed + 0.5) / Samples);
    }
    return p;
  }();
  return points;
}

}  // namespace

DirectionalAlbedo directional_albedo(double alpha) {
  DirectionalAlbedo albedo;
  if (alpha == 0) {
    for (int i = 0; i < GLEANER_ALBEDO_NODES; ++i) {
      albedo.scale[i] = 1;
      albedo.bias[i] = std::pow(1 - node(i), 5);
    }
    return albedo;
  }
  const Points& points = hammersley<kSamples>();
  for (int i = 0; i < GLEANER_ALBEDO_NODES; ++i) {
    // Visible normals by the spherical cap of Dupuy and Benyoub 2023; the weight of a sample is F G1(l).
    const double mu = node(i), sine = std::sqrt(1 - mu * mu);
    const double length = std::sqrt(alpha * alpha * sine * sine + mu * mu);
    const double vx = alpha * sine / length, vz = mu / length;
    double scale[kLanes] = {}, bias[kLanes] = {};
    for (std::uint32_t first = 0; first < kSamples; first += kLanes) {
      for (int lane = 0; lane < kLanes; ++lane) {
        const std::uint32_t k = first + lane;
        const double z = (1 - points.height[k]) * (1 + vz) - vz;
        const double r = std::sqrt(std::max(1 - z * z, 0.0));
        double hx = alpha * (r * points.cosine[k] + vx);
        const double hy = alpha * r * points.sine[k];
        double hz = std::max(z + vz, 0.0);
        const double norm = 1 / std::sqrt(hx * hx + hy * hy + hz * hz);
        hx *= norm;
        hz *= norm;
        const double vh = hx * sine + hz * mu;
        const double nl = 2 * vh * hz - mu;
        const double above = nl > 0 ? nl : 1;
        const double masking = 2 * above / (above + std::sqrt(alpha * alpha + (1 - alpha * alpha) * above * above));
        const double weight = nl > 0 ? masking : 0;
        const double away = 1 - std::min(std::max(vh, 0.0), 1.0);
        const double away2 = away * away;
        scale[lane] += weight;
        bias[lane] += weight * away2 * away2 * away;
      }
    }
    double scale_sum = 0, bias_sum = 0;
    for (int lane = 0; lane < kLanes; ++lane) {
      scale_sum += scale[lane];
      bias_sum += bias[lane];
    }
    // F = f0 + (1 - f0) away^5, so the part that f0 scales is all of it and the rest is what (1 - f0) scales.
    albedo.scale[i] = scale_sum / kSamples;
    albedo.bias[i] = bias_sum / kSamples;
  }
  return albedo;
}

AlbedoNodes lobe_albedo(double alpha_x, double alpha_y, double azimuth, const FresnelTable& fresnel) {
  constexpr std::uint32_t kFewer = 1024;
  const Points& points = hammersley<kFewer>();
  AlbedoNodes albedo;
  for (int i = 0; i < GLEANER_ALBEDO_NODES; ++i) {
    const double mu = node(i), sine = std::sqrt(1 - mu * mu);
    const double x = sine * std::cos(azimuth), y = sine * std::sin(azimuth);
    const double length = std::sqrt(alpha_x * alpha_x * x * x + alpha_y * alpha_y * y * y + mu * mu);
    const double vx = alpha_x * x / length, vy = alpha_y * y / length, vz = mu / length;
    std::array<double, 3> sum{};
    for (std::uint32_t k = 0; k < kFewer; ++k) {
      const double z = (1 - points.height[k]) * (1 + vz) - vz;
      const double r = std::sqrt(std::max(1 - z * z, 0.0));
      double hx = alpha_x * (r * points.cosine[k] + vx), hy = alpha_y * (r * points.sine[k] + vy);
      double hz = std::max(z + vz, 0.0);
      const double norm = std::sqrt(hx * hx + hy * hy + hz * hz);
      if (!(norm > 0)) continue;
      hx /= norm;
      hy /= norm;
      hz /= norm;
      const double vh = hx * x + hy * y + hz * mu;
      const double lx = alpha_x * (2 * vh * hx - x), ly = alpha_y * (2 * vh * hy - y), lz = 2 * vh * hz - mu;
      if (!(lz > 0)) continue;
      const double masking = 2 * lz / (lz + std::sqrt(lz * lz + lx * lx + ly * ly));
      const double at = std::clamp(vh, 0.0, 1.0) * (kFresnelNodes - 1);
      const int cell = std::min(static_cast<int>(at), kFresnelNodes - 2);
      for (std::size_t c = 0; c < 3; ++c)
        sum[c] += masking * std::lerp(fresnel[cell][c], fresnel[cell + 1][c], at - cell);
    }
    albedo[i] = *std::max_element(sum.begin(), sum.end()) / kFewer;
  }
  return albedo;
}

namespace {

// Conty and Kulla's fit of the shadowing of fibres, as in kernels/bsdf/layers.h.
double sheen_lambda(double cosine, double alpha) {
  const double k = (1 - alpha) * (1 - alpha);
  const auto fit = [k](double x) {
    const double a = std::lerp(21.5473, 25.3245, k), b = std::lerp(3.82987, 3.32435, k);
    const double c = std::lerp(0.19823, 0.16801, k), d = std::lerp(-1.97760, -1.27393, k);
    return a / (1 + b * std::pow(x, c)) + d * x + std::lerp(-4.32054, -4.85967, k);
  };
  return std::exp(cosine < 0.5 ? fit(cosine) : 2 * fit(0.5) - fit(1 - cosine));
}

}  // namespace

AlbedoNodes sheen_albedo(double alpha) {
  constexpr int kHeights = 96, kTurns = 64;
  AlbedoNodes albedo;
  std::array<double, kHeights> height, weight, lambda;
  for (int j = 0; j < kHeights; ++j) {
    // Squeezed towards both ends.
    const double t = (j + 0.5) / kHeights;
    height[j] = t * t * (3 - 2 * t);
    weight[j] = 6 * t * (1 - t) / kHeights;
    lambda[j] = sheen_lambda(height[j], alpha);
  }
  for (int i = 0; i < GLEANER_ALBEDO_NODES; ++i) {
    const double mu = node(i), sine = std::sqrt(1 - mu * mu), own = sheen_lambda(mu, alpha);
    double sum = 0;
    for (int j = 0; j < kHeights; ++j) {
      const double z = height[j], s = std::sqrt(1 - z * z);
      double ring = 0;
      for (int k = 0; k < kTurns; ++k) {
        const double phi = std::numbers::pi * (k + 0.5) / kTurns;
        const double hx = s * std::cos(phi) + sine, hy = s * std::sin(phi), hz = z + mu;
        const double flat = hx * hx + hy * hy;
        ring += std::pow(flat / (flat + hz * hz), 0.5 / alpha);
      }
      sum += ring / kTurns * weight[j] / (1 + own + lambda[j]);
    }
    // 2 pi directions about, D's 1 / (2 pi), V n.l = 1 / (4 n.v (1 + lambdas)).
    albedo[i] = sum * (2 + 1 / alpha) / (4 * mu);
  }
  return albedo;
}

void albedo_row(const DirectionalAlbedo& albedo, double f0, double specular,
                std::span<float, GLEANER_ALBEDO_NODES + 1> row) {
  double mean = 0;
  for (int i = 0; i < GLEANER_ALBEDO_NODES; ++i) {
    const double e = specular * (f0 * albedo.scale[i] + (1 - f0) * albedo.bias[i]);
    row[i] = static_cast<float>(1 - e);
    mean += 2 * node(i) * e;
  }
  row[GLEANER_ALBEDO_NODES] = static_cast<float>(1 - mean / GLEANER_ALBEDO_NODES);
}

}  // namespace gleaner::scene

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

const Points& hammersley() {
  static const Points points = [] {
    Points p;
    for (std::uint32_t i = 0; i < kSamples; ++i) {
      std::uint32_t reversed = 0;
      for (int bit = 0; bit < std::countr_zero(kSamples); ++bit) reversed = reversed << 1 | (i >> bit & 1);
      const double phi = 2 * std::numbers::pi * (i + 0.5) / kSamples;
      p.cosine.push_back(std::cos(phi));
      p.sine.push_back(std::sin(phi));
      p.height.push_back((reversed + 0.5) / kSamples);
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
  const Points& points = hammersley();
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

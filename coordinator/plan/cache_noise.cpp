#include "coordinator/plan/cache_noise.h"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace gleaner::coordinator {
namespace {

// Where paths turn out noisier, no fewer rays than such a part.
constexpr double kFewestOfRays = 0.25;

}  // namespace

double ray_noise(std::span<const float> cache, std::uint32_t rays, double albedo, std::uint32_t word) {
  double off = 0;
  for (std::size_t at = 0; at + CACHE_WORDS <= cache.size(); at += CACHE_WORDS) {
    double irradiance = 0;
    for (std::size_t c = 0; c < 3; ++c) irradiance += double{cache[at + CACHE_IRRADIANCE + c]} / 3;
    off += irradiance * std::abs(double{cache[at + word]});  // it has a sign
  }
  const auto records = static_cast<double>(cache.size() / CACHE_WORDS);
  return records > 0 ? albedo / std::numbers::pi * off / records * std::sqrt(static_cast<double>(rays)) : 0;
}

// The least squared error times time: s samples leave A / s and take s, r rays leave B / r and take c r, so that r goes
// as s sqrt(B / (A c)).
double worthwhile_part_of_rays(const CacheNoise& noise, double usual) {
  if (!(noise.sample > 0) || !(noise.ray > 0)) return 1;
  return std::clamp(noise.ray / noise.sample / usual, kFewestOfRays, 1.0);
}

}  // namespace gleaner::coordinator

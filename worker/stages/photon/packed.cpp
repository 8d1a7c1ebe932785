#include "worker/stages/photon/packed.h"

#include <algorithm>
#include <bit>
#include <cmath>

namespace gleaner::worker {
namespace {

float component(std::uint32_t bits, unsigned width) {
  const float most = static_cast<float>((1u << width) - 1u);
  return static_cast<float>(bits & ((1u << width) - 1u)) / most * 2 - 1;
}

}  // namespace

std::array<float, 3> unpack_unit(std::uint32_t packed, unsigned width) {
  float x = component(packed, width), y = component(packed >> width, width);
  const float z = 1 - std::abs(x) - std::abs(y), fold = std::max(-z, 0.0f);
  x += x >= 0 ? -fold : fold;
  y += y >= 0 ? -fold : fold;
  const float length = std::sqrt(x * x + y * y + z * z);
  return {x / length, y / length, z / length};
}

float unpack_length(std::uint32_t code) {
  return std::bit_cast<float>(((code + ((127u - 16u) << 3)) << 20) | 1u << 19);
}

}  // namespace gleaner::worker

#include "scene/import/vertex_colors.h"

#include <algorithm>
#include <cmath>

namespace gleaner::scene {

std::vector<std::uint16_t> linear_colors(const std::vector<float>& srgb) {
  const float most = srgb.empty() ? 0 : *std::max_element(srgb.begin(), srgb.end());
  // A little above 1 is rounding, or light that was baked in, and no count of 255.
  const float scale = most > 2 ? 1 / 255.0f : 1;
  std::vector<std::uint16_t> colors;
  colors.reserve(srgb.size() / 3 * 4);
  bool all_white = true;
  for (std::size_t i = 0; i + 2 < srgb.size(); i += 3) {
    for (std::size_t c = 0; c < 3; ++c) {
      const double s = srgb[i] < 0 ? 1 : std::clamp(srgb[i + c] * scale, 0.0f, 1.0f);
      const double linear = s <= 0.04045 ? s / 12.92 : std::pow((s + 0.055) / 1.055, 2.4);
      colors.push_back(static_cast<std::uint16_t>(std::lround(linear * 65535)));
      all_white = all_white && colors.back() == 65535;
    }
    colors.push_back(65535);
  }
  return all_white ? std::vector<std::uint16_t>() : colors;
}

}  // namespace gleaner::scene

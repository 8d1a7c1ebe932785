#pragma once

#include <cstdint>
#include <vector>

namespace gleaner::scene {

// Scene::colors from sRGB values, three a vertex, as meshes of scans have them: from 0 to 1, or to 255 where any is
// above 2. Negative ones stand for white. Empty where all are white.
std::vector<std::uint16_t> linear_colors(const std::vector<float>& srgb);

}  // namespace gleaner::scene

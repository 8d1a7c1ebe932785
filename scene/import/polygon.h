#pragma once

#include <array>
#include <cstdint>
#include <vector>

namespace gleaner::scene {

using Triangles = std::vector<std::array<std::uint32_t, 3>>;

// Triangles of a polygon, as numbers of its corners, wound as it is. Corners need not lie in one plane; it may be
// concave, and have holes that a doubled edge joins to its outline. `is_simple` is false where no triangulation covers
// exactly its area, because it crosses itself: then something near it is returned.
Triangles triangulated(const std::vector<std::array<double, 3>>& points, bool& is_simple);

}  // namespace gleaner::scene

#pragma once

#include <array>
#include <cstdint>
#include <vector>

namespace gleaner::scene {

// Triangles of a polygon, as numbers of its corners, wound as it is; always points.size() - 2 of them. A convex polygon
// becomes a fan around its first corner, a concave one is clipped ear by ear. Corners need not lie in one plane.
std::vector<std::array<std::uint32_t, 3>> triangulated(const std::vector<std::array<double, 3>>& points);

}  // namespace gleaner::scene

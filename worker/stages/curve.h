#pragma once
// Points on surfaces in an order in which neighbours are near each other.

#include <cstdint>
#include <span>
#include <vector>

namespace gleaner::worker {

// Which of the six axis directions (+x, -x, +y, ...) a normal is nearest to.
std::uint32_t side_of(const float* normal);

// The order of `stride` words each, which begin with a position and a normal, along a Morton curve through their
// bounding box, whose longest edge has `cells` cells (1024 at most count). by_side: one side after the other.
std::vector<std::uint32_t> curve_order(std::span<const float> rows, std::size_t stride, double cells, bool by_side);

}  // namespace gleaner::worker

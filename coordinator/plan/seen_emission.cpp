#include "coordinator/plan/seen_emission.h"

#include <algorithm>

namespace gleaner::coordinator {
namespace {

// The largest of 3 x 3 pixels less the smallest.
float spread(std::span<const float> emission, std::uint32_t width, std::uint32_t height, std::uint32_t x,
             std::uint32_t y) {
  float least = emission[std::size_t{y} * width + x], most = least;
  for (std::uint32_t row = y > 0 ? y - 1 : 0; row <= std::min(y + 1, height - 1); ++row)
    for (std::uint32_t column = x > 0 ? x - 1 : 0; column <= std::min(x + 1, width - 1); ++column) {
      const float value = emission[std::size_t{row} * width + column];
      least = std::min(least, value);
      most = std::max(most, value);
    }
  return most - least;
}

}  // namespace

std::vector<std::uint32_t> emission_edges(std::span<const float> emission, std::uint32_t width, std::uint32_t height,
                                          double least, std::size_t most) {
  struct Edge {
    float spread;
    std::uint32_t pixel;
  };
  std::vector<Edge> edges;
  for (std::uint32_t y = 0; y < height; ++y)
    for (std::uint32_t x = 0; x < width; ++x)
      if (const float found = spread(emission, width, height, x, y); found > least)
        edges.push_back({found, y * width + x});
  if (edges.size() > most) {
    const auto above = [](const Edge& a, const Edge& b) {
      return a.spread != b.spread ? a.spread > b.spread : a.pixel < b.pixel;
    };
    std::ranges::nth_element(edges, edges.begin() + static_cast<std::ptrdiff_t>(most), above);
    edges.resize(most);
    std::ranges::sort(edges, {}, &Edge::pixel);
  }
  std::vector<std::uint32_t> pixels(edges.size());
  std::ranges::transform(edges, pixels.begin(), &Edge::pixel);
  return pixels;
}

}  // namespace gleaner::coordinator

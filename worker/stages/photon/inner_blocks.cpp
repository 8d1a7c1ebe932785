#include "worker/stages/photon/inner_blocks.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <vector>

#include "worker/stages/photon/nearness.h"
#include "worker/stages/vectors.h"

namespace gleaner::worker {
namespace {

using Vector = std::array<float, 3>;

// Rays of a block meet a ring about its middle. An edge that is nearer than 0.92 of the ring's radius is met by one of
// them, and where it is farther from the middle than kBeyond of the reach, the block's photons hardly shine beyond it.
constexpr unsigned kProbes = 8;
constexpr float kBeyond = 1.3f;
// They begin so far above the surface, of the ring's radius: what stands on the surface ends them, what hangs above it
// mostly does not.
constexpr float kRise = 0.25f;
// What they meet is the surface where it is not farther off the plane, of the ring's radius: photons below it still
// count (MAP_FLATNESS), and what is above it may as well stand on it.
constexpr float kMostAbove = 0.04f, kMostBelow = 0.2f;

struct Ring {
  std::size_t block;
  BlockMiddle about;
  float radius;  // m
};

// From above the middle to the ring's points, evenly, the first turned by the block's number.
void add_probes(const Ring& ring, std::vector<HostRay>& rays) {
  const Vector& n = ring.about.normal;
  const Vector axis = std::abs(n[0]) < 0.6f ? Vector{1, 0, 0} : Vector{0, 1, 0};
  const Vector x = unit(axis - n * dot(axis, n)), y = cross(n, x);
  const Vector from = ring.about.position + n * (kRise * ring.radius);
  const double first = std::fmod(static_cast<double>(ring.block) * std::numbers::phi, 1.0);
  const float length = std::sqrt(1 + kRise * kRise);
  for (unsigned probe = 0; probe < kProbes; ++probe) {
    const double turn = 2 * std::numbers::pi * (probe + first) / kProbes;
    const float c = static_cast<float>(std::cos(turn)), s = static_cast<float>(std::sin(turn));
    rays.push_back({from, (x * c + y * s - n * kRise) * (1 / length)});
  }
}

// Whether a probe has met the ring's surface at about the ring.
bool meets(const Ring& ring, float distance) {
  const float whole = ring.radius * std::sqrt(1 + kRise * kRise);
  const float height = kRise * ring.radius * (1 - distance / whole);
  return height <= kMostAbove * ring.radius && height >= -kMostBelow * ring.radius;
}

}  // namespace

void mark_inner_blocks(const StageRun& run, std::span<std::uint32_t> map, std::span<const MapLeaf> leaves,
                       BatchResult& result) {
  std::vector<Ring> rings;
  std::vector<HostRay> rays;
  rings.reserve(leaves.size());
  rays.reserve(leaves.size() * kProbes);
  for (const MapLeaf& leaf : leaves) {
    rings.push_back({leaf.block, leaf.middle, kBeyond * std::sqrt(node_reach2(map, leaf.node))});
    add_probes(rings.back(), rays);
  }
  MapBlocks blocks(map);
  const std::vector<float> distances = distances_along(run, rays, result);
  for (std::size_t i = 0; i < rings.size(); ++i) {
    const auto met = std::span(distances).subspan(i * kProbes, kProbes);
    if (std::ranges::all_of(met, [&](float distance) { return meets(rings[i], distance); }))
      blocks.mark(rings[i].block);
  }
}

}  // namespace gleaner::worker

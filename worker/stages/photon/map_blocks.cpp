#include "worker/stages/photon/map_blocks.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <vector>

#include "worker/stages/photon/packed.h"
#include "worker/stages/vectors.h"
#include "worker/wavefront/run_threads.h"

namespace gleaner::worker {
namespace {

using Vector = std::array<float, 3>;

// Photons of a block that tell its density, those nearest to its middle: more of them reach beyond the block, whose
// other photons may lie in another patch of light.
constexpr std::size_t kTelling = 8;
// Where fewer lie on the middle's surface, those of others tell as well.
constexpr std::size_t kLeastTelling = 4;
constexpr float kLeastReach2 = 1e-8f;        // of the largest, where photons lie at one place
constexpr std::uint32_t kOne = 0x3f800000u;  // 1.0f

std::uint32_t* node_words(std::span<std::uint32_t> map, std::size_t node) { return &map[(1 + node) * PHOTON_WORDS]; }

// The nearest.
std::uint32_t reach_code(float reach2, float unit) {
  const std::uint32_t bits = std::bit_cast<std::uint32_t>(std::clamp(reach2 / unit, 0.0f, 1.0f));
  return std::min((kOne - bits + (1u << (NODE_REACH_STEP - 1))) >> NODE_REACH_STEP, 255u);
}

}  // namespace

Vector MapBlocks::position(std::size_t block, unsigned lane) const {
  Vector p;
  for (unsigned k = 0; k < 3; ++k) p[k] = std::bit_cast<float>(words_[at(block, PHOTON_POSITION + k, lane)]);
  return p;
}

Vector MapBlocks::normal(std::size_t block, unsigned lane) const {
  return unpack_unit(words_[at(block, PHOTON_SURFACE, lane)], 12);
}

unsigned MapBlocks::count(std::size_t block) const {
  unsigned photons = 0;
  while (photons < RAY_BLOCK && position(block, photons)[0] < kFarthestPhoton) ++photons;
  return photons;
}

std::optional<BlockMiddle> MapBlocks::middle(std::size_t block) const {
  const unsigned photons = count(block);
  if (photons == 0) return std::nullopt;
  Vector lower = position(block, 0), upper = lower, middle;
  for (unsigned lane = 1; lane < photons; ++lane)
    for (unsigned k = 0; k < 3; ++k) {
      lower[k] = std::min(lower[k], position(block, lane)[k]);
      upper[k] = std::max(upper[k], position(block, lane)[k]);
    }
  for (unsigned k = 0; k < 3; ++k) middle[k] = 0.5f * (lower[k] + upper[k]);
  const auto off = [&](unsigned lane) {
    const Vector d = position(block, lane) - middle;
    return dot(d, d);
  };
  unsigned nearest = 0;
  for (unsigned lane = 1; lane < photons; ++lane)
    if (off(lane) < off(nearest)) nearest = lane;
  return BlockMiddle{position(block, nearest), normal(block, nearest)};
}

float MapBlocks::reach2(std::size_t block, const BlockMiddle& middle, std::uint32_t neighbours, float most2) const {
  std::array<float, RAY_BLOCK> distances, of_all;
  const unsigned photons = count(block);
  unsigned alike = 0;
  for (unsigned lane = 0; lane < photons; ++lane) {
    const Vector off = position(block, lane) - middle.position;
    const float height = dot(off, middle.normal);
    of_all[lane] = dot(off, off);
    if (dot(normal(block, lane), middle.normal) >= MAP_LEAST_COSINE)
      distances[alike++] = of_all[lane] + MAP_FLATNESS * height * height;
  }
  if (alike <= kLeastTelling) {
    distances = of_all;
    alike = photons;
  }
  std::sort(distances.begin(), distances.begin() + alike);
  // The first is the middle itself.
  const std::size_t telling = std::min<std::size_t>(kTelling, alike - 1);
  if (telling == 0) return most2;
  const float reach2 = distances[telling] * static_cast<float>(neighbours) / static_cast<float>(telling);
  return std::clamp(reach2, kLeastReach2 * most2, most2);
}

void MapBlocks::mark(std::size_t block) {
  for (unsigned lane = 0; lane < RAY_BLOCK; ++lane) words_[at(block, PHOTON_SURFACE, lane)] |= PHOTON_INNER;
}

void set_most_reach(std::span<std::uint32_t> map, float most_radius) {
  float extent2 = 0;
  for (unsigned k = 0; k < 3; ++k) {
    const float side = std::bit_cast<float>(node_words(map, 0)[NODE_UPPER + k]) -
                       std::bit_cast<float>(node_words(map, 0)[NODE_LOWER + k]);
    extent2 += side * side;
  }
  const float most2 = most_radius > 0 ? most_radius * most_radius : std::max(extent2, 1e-30f);
  map[MAP_REACH] = std::bit_cast<std::uint32_t>(most2);
}

std::vector<MapLeaf> set_reaches(std::span<std::uint32_t> map, std::uint32_t neighbours, unsigned threads) {
  const std::uint32_t nodes = map[MAP_NODES];
  const float most2 = std::bit_cast<float>(map[MAP_REACH]);
  const MapBlocks blocks(map);
  std::vector<std::vector<MapLeaf>> parts(threads);
  run_threads(threads, [&](unsigned k) {
    for (std::uint64_t node = std::uint64_t{nodes} * k / threads; node < std::uint64_t{nodes} * (k + 1) / threads;
         ++node) {
      std::uint32_t& word = node_words(map, node)[NODE_BLOCK];
      const std::uint32_t block = word & NODE_BLOCK_MASK;
      if (block == NODE_NO_BLOCK) continue;
      const std::optional<BlockMiddle> middle = blocks.middle(block);
      const std::uint32_t code = middle ? reach_code(blocks.reach2(block, *middle, neighbours, most2), most2) : 255;
      word = block | code << NODE_REACH_SHIFT;
      if (middle) parts[k].push_back({static_cast<std::uint32_t>(node), block, *middle});
    }
  });
  // Children stand behind their node, which reaches as far as either.
  for (std::size_t node = nodes; node-- > 0;) {
    std::uint32_t& word = node_words(map, node)[NODE_BLOCK];
    if ((word & NODE_BLOCK_MASK) != NODE_NO_BLOCK) continue;
    const std::uint32_t* left = node_words(map, node + 1);
    const std::uint32_t* right = node_words(map, left[NODE_SKIP]);
    const std::uint32_t code = std::min(left[NODE_BLOCK] >> NODE_REACH_SHIFT, right[NODE_BLOCK] >> NODE_REACH_SHIFT);
    word = NODE_NO_BLOCK | code << NODE_REACH_SHIFT;
  }
  std::vector<MapLeaf> leaves;
  for (const std::vector<MapLeaf>& part : parts) leaves.insert(leaves.end(), part.begin(), part.end());
  return leaves;
}

float node_reach2(std::span<const std::uint32_t> map, std::size_t node) {
  const std::uint32_t code = map[(1 + node) * PHOTON_WORDS + NODE_BLOCK] >> NODE_REACH_SHIFT;
  return std::bit_cast<float>(map[MAP_REACH]) * std::bit_cast<float>(kOne - (code << NODE_REACH_STEP));
}

}  // namespace gleaner::worker

#pragma once
// The blocks of a photon map (kernels/photon_records.h) on the host: what surface they lie on, and how far their
// photons shine.

#include <array>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "kernels/photon_records.h"
#include "kernels/rays.h"

namespace gleaner::worker {

// The photon that is nearest to the middle of a block.
struct BlockMiddle {
  std::array<float, 3> position, normal;
};

class MapBlocks {
 public:
  // `map`: the words of a map's rows.
  explicit MapBlocks(std::span<std::uint32_t> map)
      : words_(map.subspan((std::size_t{1} + map[MAP_NODES]) * PHOTON_WORDS)) {}

  // None: the block has no photons.
  std::optional<BlockMiddle> middle(std::size_t block) const;
  // Photons to the surface of the middle, within the density at which the block's lie about it: the squared radius of a
  // disc that holds `neighbours` of them, m^2, at most `most2`.
  float reach2(std::size_t block, const BlockMiddle& middle, std::uint32_t neighbours, float most2) const;
  // Sets PHOTON_INNER.
  void mark(std::size_t block);

 private:
  static std::size_t at(std::size_t block, unsigned word, unsigned lane) {
    return (block * PHOTON_WORDS + word) * RAY_BLOCK + lane;
  }
  std::array<float, 3> position(std::size_t block, unsigned lane) const;
  std::array<float, 3> normal(std::size_t block, unsigned lane) const;
  unsigned count(std::size_t block) const;  // the last block's lanes may be none

  std::span<std::uint32_t> words_;
};

// A leaf with photons.
struct MapLeaf {
  std::uint32_t node, block;
  BlockMiddle middle;
};

// Sets MAP_REACH. `most_radius`: m; 0: the map's own extent.
void set_most_reach(std::span<std::uint32_t> map, float most_radius);

// Sets the reaches of all nodes, no farther than MAP_REACH. Returns the leaves, in the tree's order.
std::vector<MapLeaf> set_reaches(std::span<std::uint32_t> map, std::uint32_t neighbours, unsigned threads);

// m^2; `node` counts from 0.
float node_reach2(std::span<const std::uint32_t> map, std::size_t node);

}  // namespace gleaner::worker

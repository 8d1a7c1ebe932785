#pragma once
// Which of a photon map's blocks lie inside a surface, and which at its edge: photons' places do not tell the end of
// the light from the end of the surface.

#include <cstdint>
#include <span>

#include "worker/stages/photon/map_blocks.h"
#include "worker/stages/stage.h"

namespace gleaner::worker {

// Sets PHOTON_INNER of all photons of blocks about which the surface goes on, as far as their photons shine. `map`: the
// words of a map's rows, whose reaches are set; its `leaves`: set_reaches() has returned them. Eight rays a block,
// which `result` counts.
void mark_inner_blocks(const StageRun& run, std::span<std::uint32_t> map, std::span<const MapLeaf> leaves,
                       BatchResult& result);

}  // namespace gleaner::worker

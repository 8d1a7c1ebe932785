#pragma once
// How much moves in step in the stages of radiance links: rays of whole elements. A kernel always runs on one grid of
// this size on CPU devices (Kernel::launch says why).

#include <algorithm>
#include <cstdint>

#include "kernels/links_records.h"
#include "worker/stages/stage.h"

namespace gleaner::worker {

// Elements whose `rays` rays each make up a wave.
inline std::uint32_t elements_of_wave(const Device& device, std::uint32_t rays) {
  return std::max(1u, (device.info().cpu ? 1u << 12 : 1u << 19) / rays);
}

// Parameters of an element stage. Throws Error::bad_input for those that are out of range.
kernels::LinksParameters read_links_parameters(const StageRun& run);
// The same, with elements that are not those of the mesh.
void check_elements(const StageRun& run, std::uint64_t elements, std::uint64_t expected);

}  // namespace gleaner::worker

#pragma once
// How much moves in step in the stages of virtual point lights. A kernel always runs on one grid of this size on CPU
// devices (Kernel::launch says why).

#include <cstdint>

#include "worker/device/device.h"

namespace gleaner::worker {

inline std::uint32_t path_capacity(const Device& device) { return device.info().cpu ? 1u << 12 : 1u << 17; }
// Rays between points and lights.
inline std::uint32_t ray_capacity(const Device& device) { return device.info().cpu ? 1u << 14 : 1u << 21; }

}  // namespace gleaner::worker

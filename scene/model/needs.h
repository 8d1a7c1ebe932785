#pragma once
// Needs as a number.

#include "scene/model/scene.h"

namespace gleaner::scene {

SceneNeeds needs_from_bits(std::uint32_t bits);  // the inverse of SceneNeeds::bits()

}  // namespace gleaner::scene

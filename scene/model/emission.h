#pragma once
// What surfaces emit in the mean over their textures: the power by which lights are chosen and told.

#include <array>
#include <vector>

#include "scene/model/scene.h"

namespace gleaner::scene {

// Is a surface of this material less than opaque anywhere? BLEND or MASK alone says little: exporters set them on
// surfaces whose alpha is 1 everywhere. `vertex_alpha` is the least alpha of its vertices' colours.
bool is_see_through(const Scene& scene, const Material& material, float vertex_alpha = 1);

// Radiance of each material's emitting faces, RGB: emission times the means of its texture and of its opacity. The
// opacity is alpha (BLEND), or the share of texels at or above the cutoff (MASK). One entry a material.
std::vector<std::array<float, 3>> mean_emission(const Scene& scene);

}  // namespace gleaner::scene

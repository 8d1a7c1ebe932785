#pragma once
// Faults that exporters make and that do no harm are mended in the JSON before anything reads it.

#include <nlohmann/json.hpp>

#include "scene/files/warnings.h"

namespace gleaner::scene::gltf {

// Mends, each with a warning that names the first such element:
// - members that are null, and `extensions` that are an empty array: as if they were not there;
// - factors of materials that rounding left beside 0 or 1, by up to 1e-5;
// - an aspect ratio of a camera or a range of a light that is 0: none;
// - roots that a scene lists twice: once.
// What has another type than it should have is left as it is: its reader refuses it by name.
void mend(nlohmann::json& document, Warnings& warnings);

}  // namespace gleaner::scene::gltf

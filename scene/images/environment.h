#pragma once
// Lat-long environments from .exr and .hdr files.

#include <string>
#include <vector>

#include "scene/model/scene.h"

namespace gleaner::scene {

struct EnvironmentOptions {
  double rotation_degrees = 0;  // about +y, counter-clockwise seen from above
  double strength = 1;          // factor of the radiance
};

// Reads a lat-long .exr or .hdr. Radiance that is negative or not a number becomes 0, what is infinite the largest
// finite half float; one warning counts them. Throws Error::bad_input.
Environment import_environment(const std::string& path, const EnvironmentOptions& options = {},
                               std::vector<std::string>* warnings = nullptr);

}  // namespace gleaner::scene

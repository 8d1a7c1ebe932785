#pragma once
// One reader a format. Each returns geometry, materials as they were read, textures, lights and cameras;
// import_scene() adds what every format needs and checks the whole.

#include <string>

#include "scene/model/scene.h"

namespace gleaner::scene {

Scene read_gltf(const std::string& path);
Scene read_obj(const std::string& path);

// A material that is a white Lambert surface without textures; alpha 1, cutoff 0.5, ior 1.5.
Material lambert_material();

}  // namespace gleaner::scene

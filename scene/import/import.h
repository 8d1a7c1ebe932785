#pragma once
// Files that people have, turned into scenes.

#include <string>

#include "scene/model/scene.h"

namespace gleaner::scene {

// Reads .gltf, .glb or .obj by its extension. The result is validated and finished. A file without a camera gets one
// that frames it, and a warning. Throws Error::bad_input naming the file, the element and what was expected.
Scene import_scene(const std::string& path);

// Reads a lat-long .exr or .hdr. Throws Error::bad_input; every value must be finite and not negative.
Environment import_environment(const std::string& path);

}  // namespace gleaner::scene

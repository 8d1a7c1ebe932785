#pragma once
// One reader a format. Each returns geometry, materials as they were read, textures, lights and cameras;
// import_scene() adds what every format needs and checks the whole.

#include <string>

#include "scene/files/warnings.h"
#include "scene/import/import.h"
#include "scene/model/scene.h"

namespace gleaner::scene {

Scene read_obj(const std::string& path, const ImportOptions& options, Warnings& warnings);
Scene read_ply(const std::string& path, Warnings& warnings);
Scene read_stl(const std::string& path, Warnings& warnings);

// What faces get that name no material: a grey Lambert surface.
Material grey_material();

}  // namespace gleaner::scene

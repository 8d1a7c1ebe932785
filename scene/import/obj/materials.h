#pragma once
// MTL's materials in glTF's model.

#include <string>

#include "scene/import/obj/mtl.h"
#include "scene/import/texture_table.h"
#include "scene/model/scene.h"

namespace gleaner::scene::obj {

// `file`: the scene's; `name`: the material's. Textures go into `textures`.
Material converted(const MtlMaterial& mtl, const std::string& file, const std::string& name, TextureTable& textures,
                   Warnings& warnings);

}  // namespace gleaner::scene::obj

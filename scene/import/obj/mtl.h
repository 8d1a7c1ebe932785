#pragma once
// MTL: what a material library says of each material.

#include <array>
#include <filesystem>
#include <map>
#include <optional>
#include <string>

#include "scene/files/warnings.h"
#include "scene/import/obj/lines.h"
#include "scene/model/records.h"

namespace gleaner::scene::obj {

inline constexpr float kDefaultReflectance = 0.8f;  // of faces that name no material

using Color = std::array<float, 3>;

struct TextureMap {
  std::string path;     // relative to the scene's folder, or absolute
  std::string element;  // for errors
  gl_uint wrap = GLEANER_WRAP_REPEAT;
  float offset[2] = {0, 0}, scale[2] = {1, 1};  // -o and -s
  float strength = 1;                           // -bm, of bump maps
  auto key() const { return std::tuple(path, wrap, offset[0], offset[1], scale[0], scale[1], strength); }
};

struct MtlMaterial {
  std::optional<Color> kd, tf;
  Color ks{}, ke{};
  std::optional<float> d, tr, ni, roughness, metallic;  // Pr, Pm
  long illum = 2;
  std::optional<TextureMap> map_kd, map_ke, map_d, map_roughness, map_metallic, map_bump, map_normal;
};

using MtlLibrary = std::map<std::string, MtlMaterial>;

// Adds the materials of the file at `path` to `library`. `relative`: the same path as seen from the scene's folder;
// `shown` and `element` say who named it.
void read_mtl(const std::filesystem::path& path, const std::filesystem::path& relative, const std::string& shown,
              const std::string& element, MtlLibrary& library, Warnings& warnings);

// Paths from systems that separate folders by backslashes.
std::string slashed(std::string path);

}  // namespace gleaner::scene::obj

#include "scene/import/import.h"

#include <algorithm>
#include <cctype>
#include <filesystem>
#include <set>

#include "scene/import/formats.h"
#include "scene/model/error.h"

namespace gleaner::scene {
namespace {

std::string lower_case_extension(const std::filesystem::path& path) {
  std::string extension = path.extension().string();
  std::transform(extension.begin(), extension.end(), extension.begin(),
                 [](unsigned char c) { return std::tolower(c); });
  return extension;
}

// `--camera NAME` must mean one camera.
void make_camera_names_unique(Scene& scene) {
  std::set<std::string> taken;
  for (NamedCamera& camera : scene.cameras) {
    std::string name = camera.name;
    for (int n = 2; !taken.insert(name).second; ++n) name = camera.name + " " + std::to_string(n);
    camera.name = name;
  }
}

}  // namespace

Material lambert_material() {
  Material m{};
  for (int c = 0; c < 3; ++c) m.base_color[c] = m.specular_color[c] = 1;
  m.alpha = 1;
  m.alpha_cutoff = 0.5f;
  m.ior = 1.5f;
  m.roughness = 1;
  m.normal_scale = 1;
  m.base_color_texture = m.metallic_roughness_texture = m.normal_texture = m.emission_texture = GLEANER_NONE;
  m.transmission_texture = m.specular_texture = m.specular_color_texture = GLEANER_NONE;
  m.albedo_table = GLEANER_NONE;
  return m;
}

Scene import_scene(const std::string& path) {
  const std::string extension = lower_case_extension(path);
  Scene scene;
  if (extension == ".gltf" || extension == ".glb")
    scene = read_gltf(path);
  else if (extension == ".obj")
    scene = read_obj(path);
  else
    throw Error::bad_input(path, "", "a file whose name ends in .gltf, .glb or .obj");
  scene.name = std::filesystem::path(path).stem().string();
  finish_materials(scene);
  if (scene.triangle_count() == 0) scene.warnings.push_back("the scene has no triangles");
  if (scene.cameras.empty()) {
    scene.cameras.push_back(framing_camera(scene));
    scene.warnings.push_back(
        "the scene has no camera: one was added that frames it from the front (+z); --look-at sets another");
  }
  make_camera_names_unique(scene);
  validate(scene, path);
  return scene;
}

}  // namespace gleaner::scene

#include "scene/import/import.h"

#include <algorithm>
#include <cctype>
#include <filesystem>
#include <set>

#include "scene/import/formats.h"
#include "scene/import/placement.h"
#include "scene/model/error.h"
#include "scene/model/names.h"

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

Scene read(const std::string& path, const ImportOptions& options, Warnings& warnings) {
  const std::string extension = lower_case_extension(path);
  if (extension == ".gltf" || extension == ".glb") return read_gltf(path, options, warnings);
  if (extension == ".obj") return read_obj(path, options, warnings);
  if (extension == ".ply") return read_ply(path, warnings);
  if (extension == ".stl") return read_stl(path, warnings);
  throw Error::bad_input(path, "", "a file whose name ends in .gltf, .glb, .obj, .ply or .stl");
}

}  // namespace

LightUnits parse_light_units(const std::string& word) {
  if (word == "auto") return LightUnits::automatic;
  if (word == "radiometric") return LightUnits::radiometric;
  if (word == "photometric") return LightUnits::photometric;
  throw Error::usage("--light-units: expected auto, radiometric or photometric, found \"" + word + "\"");
}

Material grey_material() {
  constexpr float reflectance = 0.8f;
  Material m = blank_material();
  std::fill(m.base_color, m.base_color + 3, reflectance);
  return m;
}

Scene import_scene(const std::string& path, const ImportOptions& options) {
  Warnings warnings;
  Scene scene = read(path, options, warnings);
  scene.name = std::filesystem::path(path).stem().string();
  finish_materials(scene);
  if (scene.triangle_count() == 0) warnings.add("the scene has no triangles");
  if (scene.cameras.empty() && options.needs_camera)
    warnings.add("the scene has no camera: one was added that frames it from the front (+z); --look-at sets another");
  if (scene.cameras.empty()) scene.cameras.push_back(framing_camera(scene));
  make_camera_names_unique(scene);
  validate(scene, path);
  warn_of_coarse_meshes(scene, warnings);
  scene.warnings = warnings.list();
  if (options.strict && !scene.warnings.empty()) {
    std::string all;
    for (const std::string& warning : scene.warnings) all += (all.empty() ? "" : "; ") + warning;
    throw Error::bad_input(path, "--strict", "a file without warnings", all);
  }
  return scene;
}

}  // namespace gleaner::scene

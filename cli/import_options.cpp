#include "cli/import_options.h"

#include <CLI/CLI.hpp>

#include "scene/model/error.h"

namespace gleaner::cli {

void add_import_options(CLI::App& command, ImportWords& words) {
  command
      .add_option("SCENE", words.scene,
                  "scene: .gltf, .glb, .obj, .ply or .stl; or 'NAME_####.obj', a file a frame of --frames")
      ->required();
  command.add_option("--environment", words.environment, "lat-long .exr or .hdr that lights the scene from all around");
  command.add_option("--environment-rotation", words.environment_rotation,
                     "DEGREES about +y, counter-clockwise seen from above");
  command.add_option("--environment-strength", words.environment_strength, "factor of the environment's radiance")
      ->capture_default_str();
  command
      .add_option("--light-units", words.light_units,
                  "auto, radiometric (W/sr, W/m^2) or photometric (candela, lux; divided by 683)")
      ->capture_default_str();
  command.add_option("--variant", words.variant, "material variant of a glTF file");
  command.add_option("--animation", words.animation, "NAME or number of a glTF file's animation, or all of them")
      ->capture_default_str();
  command.add_option("--texture-limit", words.texture_limit, "most texels of all images together")
      ->capture_default_str()
      ->check(CLI::Range(std::uint64_t{1}, std::uint64_t{0xffffffff}));
  command.add_flag("--strict", words.strict, "what would be a warning about the files is an error");
}

std::unique_ptr<scene::MovingScene> open_scene(const ImportWords& words, bool needs_camera) {
  scene::ImportOptions options;
  options.light_units = scene::parse_light_units(words.light_units);
  options.variant = words.variant;
  options.animation = words.animation;
  options.most_texels = words.texture_limit;
  options.strict = words.strict;
  options.needs_camera = needs_camera;
  options.instances = words.instances;
  options.frames = words.frames;
  if (words.environment.empty() && (words.environment_rotation != 0 || words.environment_strength != 1))
    throw Error::usage("--environment-rotation and --environment-strength need --environment FILE");
  auto file = std::make_unique<scene::MovingScene>(words.scene, options);
  if (words.environment.empty()) return file;
  std::vector<std::string> warnings;
  scene::Scene& scene = file->base();
  scene.environment =
      scene::import_environment(words.environment, {words.environment_rotation, words.environment_strength}, &warnings);
  if (words.strict && !warnings.empty())
    throw Error::bad_input("", "--strict", "an environment without warnings", warnings.front());
  scene.warnings.insert(scene.warnings.end(), warnings.begin(), warnings.end());
  return file;
}

scene::Scene read_scene(const ImportWords& words, bool needs_camera) {
  const auto file = open_scene(words, needs_camera);
  return file->moves() ? file->scene_at(words.seconds) : std::move(file->base());
}

}  // namespace gleaner::cli

#pragma once
// The words that say how a scene's files are read: the same for every command that reads one.

#include <cstdint>
#include <optional>
#include <string>

#include "scene/import/import.h"

namespace CLI {
class App;
}

namespace gleaner::cli {

struct ImportWords {
  std::string scene, environment;  // paths
  double environment_rotation = 0, environment_strength = 1;
  std::string light_units = "auto", variant, animation = "all";
  double seconds = 0;                           // at which animations are seen
  std::optional<scene::FrameNumbers> frames{};  // of a sequence of files; no word of these, but --frames
  std::uint64_t texture_limit = scene::ImportOptions().most_texels;
  bool strict = false;
  bool instances = true;  // see scene::ImportOptions; no word of people's, but the method's
};

void add_import_options(CLI::App& command, ImportWords& words);

// Opens the scene and reads its environment. `needs_camera`, and what is thrown: as below.
std::unique_ptr<scene::MovingScene> open_scene(const ImportWords& words, bool needs_camera);

// Reads the scene as it is at that time, and its environment. `needs_camera`: whether one that is missing deserves a
// warning. Throws Error::usage for malformed words, Error::bad_input for what the files say.
scene::Scene read_scene(const ImportWords& words, bool needs_camera);

}  // namespace gleaner::cli

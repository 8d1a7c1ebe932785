#pragma once
// Scenes made by code: for tests, for benchmarks and for people who have no scene at hand.

#include <map>
#include <string>
#include <vector>

#include "scene/model/scene.h"

namespace gleaner::scene {

struct LibraryEntry {
  std::string name;         // as `gleaner scene NAME` takes it
  std::string description;  // one line
  std::map<std::string, std::string> parameters;  // name -> default value
};
const std::vector<LibraryEntry>& library();

// A scene by its name; `parameters` override the defaults. Throws Error::usage for unknown names or values out of range.
Scene make_scene(const std::string& name, const std::map<std::string, std::string>& parameters = {});

// Writes a binary glTF that import_scene() reads back to the same scene. Temporary name, then rename.
void write_glb(const Scene& scene, const std::string& path);

}  // namespace gleaner::scene

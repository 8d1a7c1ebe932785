#pragma once
// Scenes made by code: for tests, for benchmarks and for people who have no scene at hand.
//
// Metres, y up; every scene has cameras with names, named materials and meshes, and light of some kind. "Pure Lambert"
// is metallic 0 with specular 0. The same name and parameters give the same bytes, everywhere and at any time.

#include <map>
#include <string>
#include <vector>

#include "scene/library/motion.h"
#include "scene/model/scene.h"

namespace gleaner::scene {

struct LibraryEntry {
  std::string name;                               // as `gleaner scene NAME` takes it
  std::string description;                        // one line
  std::map<std::string, std::string> parameters;  // name -> default value
  std::map<std::string, std::string> ranges;      // name -> what it may be, for people: "a whole number from 1 to 20"
};
const std::vector<LibraryEntry>& library();

// A scene by its name; `parameters` override the defaults. Throws Error::usage for unknown names or values out of
// range.
Scene make_scene(const std::string& name, const std::map<std::string, std::string>& parameters = {});

// The same with the way it moves; an empty one where it stands still.
AnimatedScene make_animated_scene(const std::string& name, const std::map<std::string, std::string>& parameters = {});

// Writes a binary glTF that import_scene() reads back to the same scene: the same arrays, bit for bit, where no vertex
// is unused or shared between materials and textures stand in the order in which materials name them; positions,
// triangles and texels always. What is derived (f0, albedo tables) is not written.
//
// glTF has no environments: one is written beside the scene, to environment_path(path), as a 32-bit RGB EXR.
// Files get a temporary name, are synced and renamed. Throws Error::failed naming the file that could not be written.
void write_glb(const Scene& scene, const std::string& path);
// With an animation, which import_scene() reads back: at time 0 to the same scene.
void write_glb(const AnimatedScene& scene, const std::string& path);

// "folder/scene.glb" -> "folder/scene.env.exr".
std::string environment_path(const std::string& glb_path);

}  // namespace gleaner::scene

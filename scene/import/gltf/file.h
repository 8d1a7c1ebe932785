#pragma once
// A glTF file that is being read: as a scene that stands still, or as a base and the states of its frames.

#include <memory>
#include <optional>
#include <string>

#include "scene/import/gltf/animation.h"
#include "scene/import/gltf/document.h"
#include "scene/import/gltf/materials.h"
#include "scene/import/gltf/rigging.h"
#include "scene/import/import.h"

namespace gleaner::scene::gltf {

class File {
 public:
  File(const std::string& path, const ImportOptions& options, Warnings& warnings);

  // Whether the animations that were asked for move anything.
  bool moves() const { return animations_.moves(); }

  // The scene as it is at that time, without a rig.
  Scene read_at(double seconds);
  // The base: the scene as the file has it, with a rig of what moves.
  Scene read_base();
  // Of the base that read_base() made, finished: how it looks at that time. Nothing where it cannot look so.
  std::optional<ShownFrame> at(double seconds, const Scene& base);

 private:
  Scene read(bool moving);
  // What the animations change of lights, cameras and materials. False: there are others than the base's.
  bool read_changes(Nodes& nodes, const Scene& base, Scene& shown);

  ImportOptions options_;
  Warnings& warnings_;
  Document document_;
  Animations animations_;
  std::unique_ptr<Materials> materials_;
  std::unique_ptr<Rigging> rigging_;
  LightUnits light_units_;  // as they were taken for the base
};

}  // namespace gleaner::scene::gltf

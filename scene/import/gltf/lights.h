#pragma once
// KHR_lights_punctual, in the units that the file is taken to mean.

#include <string>

#include "scene/import/gltf/document.h"
#include "scene/import/gltf/nodes.h"
#include "scene/import/import.h"

namespace gleaner::scene::gltf {

class Lights {
 public:
  // Decides what candela and lux mean here, and says so where lights are divided.
  Lights(const Document& document, LightUnits units, Scene& scene, Warnings& warnings);

  // What they were taken for: radiometric or photometric.
  LightUnits units() const { return watts_per_unit_ == 1 ? LightUnits::radiometric : LightUnits::photometric; }

  // Those of all nodes, relative to the scene's origin.
  void add(Nodes& nodes);

 private:
  void add(const Element& node, const Element& reference, const Matrix& to_world);
  Element light(const Element& reference) const;
  bool is_photometric(LightUnits units) const;
  void add_cone(const Element& cone, Light& light);

  const Document& document_;
  Scene& scene_;
  Warnings& warnings_;
  double watts_per_unit_ = 1;
};

}  // namespace gleaner::scene::gltf

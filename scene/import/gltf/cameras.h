#pragma once

#include "scene/import/gltf/document.h"
#include "scene/import/gltf/nodes.h"
#include "scene/model/scene.h"

namespace gleaner::scene::gltf {

// Those of all nodes, relative to the scene's origin.
void add_cameras(const Document& document, Nodes& nodes, Scene& scene, Warnings& warnings);

inline Vector relative(const Vector& p, const Point3& origin) {
  return {p[0] - origin[0], p[1] - origin[1], p[2] - origin[2]};
}

template <typename To>
void store(const Vector& from, To& to) {
  for (int c = 0; c < 3; ++c) to[c] = static_cast<float>(from[c]);
}

}  // namespace gleaner::scene::gltf

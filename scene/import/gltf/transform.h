#pragma once
// What glTF adds to affine maps.

#include "scene/import/placement.h"
#include "scene/model/transform.h"

namespace gleaner::scene::gltf {

// From translation, rotation (a quaternion of any length but 0) and scale.
Matrix composed(const double t[3], const double r[4], const double s[3]);

}  // namespace gleaner::scene::gltf

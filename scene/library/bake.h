#pragma once
#include "scene/model/scene.h"

namespace gleaner::scene {

// The same scene with a copy of its mesh in place of each instance, in world space: what importers make of meshes that
// are not instanced. In double precision, rounded once.
Scene baked(const Scene& scene);

}  // namespace gleaner::scene

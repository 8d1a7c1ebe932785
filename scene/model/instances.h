#pragma once
// Instances: meshes stored once, in object space, and placed in the world by transforms.

#include <array>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "scene/model/scene.h"

namespace gleaner::scene {

// Whether triangles of this material may be instanced. Not where they emit, since lights are chosen by their place in
// the world; nor where they bound a solid that light passes through, since what a point lies in is counted there
// (scene/model/media.h).
bool may_be_instanced(const Material& material);

// Whether a transform (Instance::transform) may place an instance: finite, of moderate size, and neither flat nor
// stretched one way kMaxInstanceStretch times more than another, so that its inverse is known to nearly all bits of a
// float. What it says otherwise, in words.
std::optional<std::string> refused_transform(const gl_float (&transform)[12]);

// Where a matrix, given by its three rows of four, places an instance: rounded to single precision.
void place_instance(const double* rows, gl_float (&transform)[12]);

// The meshes that are instanced or deform, in their order: those that have triangles.
std::vector<std::uint32_t> meshes_with_own_bvh(const Scene& scene);

// The triangles of all other meshes, in runs as long as can be.
struct TriangleRun {
  std::uint32_t first, count;
};
std::vector<TriangleRun> still_triangles(const Scene& scene);

// A box about the triangles of a mesh, in the mesh's own space.
Bounds bounds_of(const Scene& scene, const Mesh& mesh);

// Such a box of each mesh that is instanced, by mesh; the others' are empty.
std::vector<Bounds> boxes_of_instanced(const Scene& scene);

// What follows from a transform, by computation in double precision.
struct DerivedInstance {
  std::array<double, 9> inverse;       // of the linear part, row by row
  std::array<double, 3> lower, upper;  // box in the world, rounded outwards with room for what queries round
  std::array<double, 3> error;  // bound, a world axis, of all rounding between a point of the mesh and a query there
  bool mirrored;                // turns triangles inside out
};
DerivedInstance derived(const gl_float (&transform)[12], const Bounds& mesh);

}  // namespace gleaner::scene

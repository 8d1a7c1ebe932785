#pragma once
// Where posed vertices stand. Everything is computed in double precision by additions, multiplications, divisions and
// square roots alone, in a fixed order: all machines come to the same bits.

#include <cstddef>
#include <vector>

#include "scene/model/frame_state.h"
#include "scene/model/rig.h"
#include "scene/model/transform.h"

namespace gleaner::scene {

// Writes the positions and normals (unit, or zero) of the mesh's vertices [first, first + count), three floats each, to
// their places in the scene's arrays.
void pose_vertices(const Rig& rig, const PosedMesh& mesh, const FrameState& state, std::size_t first, std::size_t count,
                   std::vector<float>& positions, std::vector<float>& normals);

// What places one of the mesh's vertices.
Matrix placement_at(const Rig& rig, const PosedMesh& mesh, const FrameState& state, std::size_t vertex);

}  // namespace gleaner::scene

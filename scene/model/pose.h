#pragma once
// Where posed vertices stand. Everything is computed in double precision by additions, multiplications, divisions and
// square roots alone, in a fixed order: all machines come to the same bits.

#include <span>

#include "scene/model/frame_state.h"
#include "scene/model/rig.h"
#include "scene/model/transform.h"

namespace gleaner::scene {

// Writes the positions and normals (unit, or zero) of the mesh's vertices: three floats each.
void pose_mesh(const Rig& rig, const PosedMesh& mesh, const FrameState& state, std::span<float> positions,
               std::span<float> normals);

// What places one of the mesh's vertices.
Matrix placement_at(const Rig& rig, const PosedMesh& mesh, const FrameState& state, std::size_t vertex);

}  // namespace gleaner::scene

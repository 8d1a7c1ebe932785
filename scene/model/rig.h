#pragma once
// What of a scene moves: beside a scene's arrays, which show it at rest, the data from which a pose makes the positions
// and normals of the meshes that move. Rest data are in object space, as the file has them.

#include <cstdint>
#include <vector>

#include "scene/model/device_types.h"

namespace gleaner::scene {

// Differences that a morph target adds to rest data. First floats in Rig::deltas, three a vertex; GLEANER_NONE: none.
struct MorphTarget {
  gl_uint positions, normals;
};
GLEANER_SIZE(MorphTarget, 8);

// Vertices that are posed together: one primitive under one node. A pose gives one weight to each morph target, and
// then places the vertices by one matrix, or each by its joints' matrices (linear blend skinning).
struct PosedMesh {
  gl_uint first_vertex, vertex_count;      // of the scene's
  gl_uint first_triangle, triangle_count;  // of the scene's: all of whose corners are these vertices
  gl_uint first_rest;                      // vertex of Rig::positions and normals
  gl_uint first_target, target_count;      // of Rig::targets
  gl_uint first_weight;                    // of FrameState::morph_weights, one a target
  gl_uint first_matrix, matrix_count;      // of FrameState::matrices
  gl_uint influences;                      // joints a vertex; 0: the first matrix places all
  gl_uint first_influence;                 // of Rig::joints and Rig::joint_weights, `influences` a vertex
};
GLEANER_SIZE(PosedMesh, 48);

// An instance that moves as a whole: a pose gives its transform, rounded to single precision.
struct PosedInstance {
  gl_uint instance;  // of Scene::instances
  gl_uint matrix;    // of FrameState::matrices
};
GLEANER_SIZE(PosedInstance, 8);

struct Rig {
  std::vector<PosedMesh> meshes;         // by first_vertex; neither vertices nor triangles are shared
  std::vector<PosedInstance> instances;  // by instance, each once
  std::vector<float> positions;          // 3 per rest vertex
  std::vector<float> normals;            // the same; (0,0,0) = none
  std::vector<MorphTarget> targets;
  std::vector<float> deltas;
  std::vector<std::uint32_t> joints;  // below the mesh's matrix_count
  std::vector<float> joint_weights;   // where a vertex's sum is not positive, the mesh's first joint moves it alone
  std::uint32_t matrices = 0, morph_weights = 0;  // that a frame's state has

  bool empty() const { return meshes.empty() && instances.empty(); }
};

struct Scene;
// Marks the meshes that the scene's rig poses as such that deform (Mesh::deforming): who makes a rig calls it last.
void mark_deforming(Scene& scene);
// The scene's meshes that hold the posed mesh's triangles, rising. Of one without triangles: none.
std::vector<std::uint32_t> meshes_of(const Scene& scene, const PosedMesh& posed);

}  // namespace gleaner::scene

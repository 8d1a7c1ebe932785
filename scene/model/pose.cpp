#include "scene/model/pose.h"

#include <cmath>

#include "scene/model/records.h"

namespace gleaner::scene {
namespace {

Matrix matrix_of(const Placement& rows) {
  Matrix m{};
  for (int r = 0; r < 3; ++r)
    for (int c = 0; c < 4; ++c) m[c * 4 + r] = rows[r * 4 + c];
  m[15] = 1;
  return m;
}

// The sum of the joints' matrices by their weights.
Matrix blended(const Rig& rig, const PosedMesh& mesh, const FrameState& state, std::size_t vertex) {
  const std::size_t first = mesh.first_influence + std::size_t{mesh.influences} * vertex;
  Placement sum{};
  double weights = 0;
  for (std::size_t i = first; i < first + mesh.influences; ++i) {
    const double weight = rig.joint_weights[i];
    if (weight == 0) continue;
    const Placement& joint = state.matrices[mesh.first_matrix + rig.joints[i]];
    for (std::size_t k = 0; k < sum.size(); ++k) sum[k] += weight * joint[k];
    weights += weight;
  }
  if (!(weights > 0)) return matrix_of(state.matrices[mesh.first_matrix]);
  for (double& x : sum) x /= weights;
  return matrix_of(sum);
}

// A vertex's value at rest with what its morph targets add.
Vector morphed(const Rig& rig, const PosedMesh& mesh, const FrameState& state, const std::vector<float>& rest,
               gl_uint MorphTarget::*deltas, std::size_t vertex) {
  const float* at = &rest[3 * (mesh.first_rest + vertex)];
  Vector value = {at[0], at[1], at[2]};
  for (std::size_t t = 0; t < mesh.target_count; ++t) {
    const gl_uint first = rig.targets[mesh.first_target + t].*deltas;
    const double weight = state.morph_weights[mesh.first_weight + t];
    if (first == GLEANER_NONE || weight == 0) continue;
    for (std::size_t c = 0; c < 3; ++c) value[c] += weight * rig.deltas[first + 3 * vertex + c];
  }
  return value;
}

// As unit(), by operations that IEEE 754 rounds correctly.
Vector exact_unit(const Vector& a) {
  const double length = std::sqrt(dot(a, a));
  return length > 0 && std::isfinite(length) ? Vector{a[0] / length, a[1] / length, a[2] / length} : Vector{};
}

}  // namespace

Matrix placement_at(const Rig& rig, const PosedMesh& mesh, const FrameState& state, std::size_t vertex) {
  return mesh.influences > 0 ? blended(rig, mesh, state, vertex) : matrix_of(state.matrices[mesh.first_matrix]);
}

void pose_vertices(const Rig& rig, const PosedMesh& mesh, const FrameState& state, std::size_t first, std::size_t count,
                   std::vector<float>& positions, std::vector<float>& normals) {
  Matrix m = matrix_of(state.matrices[mesh.first_matrix]);
  NormalTransform turn(m);
  for (std::size_t v = first; v < first + count; ++v) {
    if (mesh.influences > 0) {
      m = blended(rig, mesh, state, v);
      turn = NormalTransform(m);
    }
    const Vector p = transformed(m, morphed(rig, mesh, state, rig.positions, &MorphTarget::positions, v));
    const Vector n = exact_unit(turn.turned(morphed(rig, mesh, state, rig.normals, &MorphTarget::normals, v)));
    const std::size_t at = 3 * (mesh.first_vertex + v);
    for (std::size_t c = 0; c < 3; ++c) {
      positions[at + c] = static_cast<float>(p[c]);
      normals[at + c] = static_cast<float>(n[c]);
    }
  }
}

}  // namespace gleaner::scene

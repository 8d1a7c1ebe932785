#pragma once
// Vertices that hang on an edge: the triangle on its other side has no vertex there, and interpolates between two of
// its own. Shown as they are, they would leave a crack.

#include <cstdint>
#include <vector>

#include "worker/stages/links/mesh.h"

namespace gleaner::worker {

struct DividedTriangles {
  const TriangleRows& triangles;
  const std::vector<std::uint32_t>&levels, &first_node, &nodes;  // of each triangle; a vertex a node
};

// Words of a mesh, HANGING_WORDS each, in the order in which they are put on their edges: what others hang on comes
// first.
std::vector<std::uint32_t> hanging_vertices(const DividedTriangles& divided);

}  // namespace gleaner::worker

#pragma once
// The mesh of vertices (kernels/links_records.h), as stages make and read it.

#include <cstdint>
#include <string>
#include <vector>

#include "kernels/links_records.h"
#include "worker/stages/stage.h"
#include "worker/wavefront/input_rows.h"

namespace gleaner::worker {

// Where the sections of a mesh begin, in words.
struct MeshLayout {
  std::uint64_t triangles = 0, nodes = 0, vertices = 0, corners = 0, hanging = 0;
  std::uint64_t nodes_at() const { return MESH_HEADER + MESH_TRIANGLE_WORDS * triangles; }
  std::uint64_t rings_at() const { return nodes_at() + nodes; }
  std::uint64_t corners_at() const { return rings_at() + vertices + 1; }
  std::uint64_t areas_at() const { return corners_at() + CORNER_WORDS * corners; }
  std::uint64_t places_at() const { return areas_at() + vertices; }
  std::uint64_t hanging_at() const { return places_at() + PLACE_WORDS * vertices; }
  std::uint64_t words() const { return hanging_at() + HANGING_WORDS * hanging; }
  std::uint64_t elements() const { return 2 * vertices; }
};

constexpr std::uint64_t nodes_of_level(std::uint32_t level) {
  const std::uint64_t n = std::uint64_t{1} << level;
  return (n + 1) * (n + 2) / 2;
}

// A task's input, a mesh. Throws Error::bad_input where its size is not what its header says.
MeshLayout read_mesh_layout(const StageTask& task, const char* input = "mesh");

// What stages on devices keep of a mesh, and of rows that they read with it.
struct MeshTables {
  MeshLayout layout;
  cl::Buffer mesh{}, rows{};
};
// The rows come from input `rows`, `words` words an element; none where it is null.
// Kept for all stages and frames that read the same.
MeshTables mesh_tables(const StageRun& run, const char* rows, unsigned words);

// The input "lobes", where a task has it.
struct LobeTables {
  cl::Buffer lobes{};          // none: the mesh's words, which nobody reads as such
  std::uint64_t elements = 0;  // of lobes, behind those of the mesh
  std::string options() const { return elements ? " -D LINKS_LOBES" : ""; }
};
LobeTables lobe_tables(const StageRun& run, const MeshTables& mesh);

// Rows of a scene's triangles (kernels/scene_layout.h).
struct TriangleRows {
  const float* rows = nullptr;
  unsigned words = 0;  // of a row
  std::uint64_t count = 0;
};

// A mesh, in memory.
struct HostMesh {
  MeshLayout layout;
  std::vector<std::uint32_t> words;
  std::uint32_t level(std::uint64_t triangle) const { return words[MESH_HEADER + MESH_TRIANGLE_WORDS * triangle + 1]; }
};
// Checked as mesh_to_device() does.
HostMesh read_mesh(const StageTask& task, const char* input);

// The level of each triangle for about so many vertices, all edges about as long; and where irradiance bends, by a
// probe of a coarser mesh.
std::vector<std::uint32_t> even_levels(const TriangleRows& triangles, const kernels::LinksMeshParameters& wanted);
std::vector<std::uint32_t> refined_levels(const TriangleRows& triangles, const kernels::LinksMeshParameters& wanted,
                                          const HostMesh& coarse, const std::vector<float>& probe);

// Rows of a probe: whether an element lies inside of something, and whether it is hidden (PROBE_LEAST_HITS).
inline bool is_inside(const std::vector<float>& probe, std::uint64_t element) {
  return !(probe[element * PROBE_WORDS + PROBE_BACKS] <= PROBE_MOST_BACKS);
}
inline bool is_hidden(const std::vector<float>& probe, std::uint64_t element) {
  return is_inside(probe, element) && !is_inside(probe, element ^ 1u) &&
         probe[(element ^ 1u) * PROBE_WORDS + PROBE_HITS] >= PROBE_LEAST_HITS;
}
// What kernels are told of the mesh's `elements` (SIDE_BITS), from the input "probe". None is hidden where few of those
// inside look so: then the scene is not seen from its fronts, and a room and what stands in it look like solids and
// hollows. Kept for all stages and frames that read the same.
cl::Buffer element_sides(const StageRun& run, std::uint64_t elements);

// The scene's triangles, read from the device into `rows`.
TriangleRows read_triangles(const StageRun& run, std::vector<float>& rows);

// The mesh of these levels: its words. Throws Error::failed where there are too many.
std::vector<std::uint32_t> make_links_mesh(const TriangleRows& triangles, const std::vector<std::uint32_t>& levels,
                                           kernels::LinksMeshFacts* facts);

inline std::uint32_t node_number(std::uint32_t i, std::uint32_t j, std::uint32_t n) {
  return j * (n + 1) - (j * (j - 1)) / 2 + i;
}

}  // namespace gleaner::worker

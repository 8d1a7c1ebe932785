// Stage kind "links_lobes": which elements send light on by a lobe (kernels/links/lobes.h).

#include <cstring>

#include "kernels/lobe_rows.h"
#include "kernels/scene_layout.h"
#include "scene/model/error.h"
#include "worker/stages/links/mesh.h"
#include "worker/stages/links/stages.h"
#include "worker/stages/vpl/rows.h"

namespace gleaner::worker {
namespace {

// Whether a surface of this material may be rough metal somewhere: is_rough_metal() of kernels/rough_metal.h, before
// textures take their part. `row`: of the materials' table.
bool may_be_rough_metal(const float* row) {
  std::uint32_t flags = 0;
  std::memcpy(&flags, row + MATERIAL_FLAGS, sizeof flags);
  if (flags & GLEANER_MATERIAL_UNLIT) return false;
  const float alpha = row[MATERIAL_ROUGHNESS] * row[MATERIAL_ROUGHNESS];
  return row[MATERIAL_METALLIC] >= 0.5f && alpha >= ROUGH_LOBE_ALPHA * 0.999f;
}

}  // namespace

BatchResult run_links_lobes_stage(const StageRun& run) {
  const auto p = run.parameters<kernels::LinksLobesParameters>();
  run.check_range(1);
  const HostMesh mesh = read_mesh(run.task, "mesh");
  const std::uint64_t elements = mesh.layout.elements();
  if (p.elements != elements || mesh.layout.triangles != run.scene.triangles())
    throw Error::bad_input(run.where(), "input mesh", std::to_string(p.elements) + " elements of the scene",
                           std::to_string(elements));
  std::vector<float> rows;
  const TriangleRows triangles = read_triangles(run, rows);
  const std::vector<float>& materials = run.scene.material_table();
  const std::uint32_t *rings = &mesh.words[mesh.layout.rings_at()], *corners = &mesh.words[mesh.layout.corners_at()];
  std::vector<std::uint32_t> words(elements, GLEANER_NONE);
  for (std::uint64_t e = 0; e < elements; ++e) {
    // All triangles about a vertex have one material.
    const std::uint32_t triangle = corners[std::uint64_t{CORNER_WORDS} * rings[e / 2] + CORNER_TRIANGLE];
    std::uint32_t material = 0;
    std::memcpy(&material, triangles.rows + std::uint64_t{triangle} * triangles.words + TRIANGLE_MATERIAL, 4);
    if (!may_be_rough_metal(&materials[std::size_t{material} * MATERIAL_WORDS])) continue;
    words[e] = static_cast<std::uint32_t>(words.size() - elements);
    words.push_back(static_cast<std::uint32_t>(e));
  }
  BatchResult result;
  result.records.resize(words.size() * 4);
  std::memcpy(result.records.data(), words.data(), result.records.size());
  result.counts = {static_cast<std::uint32_t>(words.size())};
  set_facts(result, kernels::LinksLobesFacts{static_cast<std::uint32_t>(words.size() - elements), 0});
  return result;
}

}  // namespace gleaner::worker

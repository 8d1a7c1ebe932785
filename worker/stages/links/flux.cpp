#include "worker/stages/links/flux.h"

#include <cstring>

#include "worker/stages/links/mesh.h"
#include "worker/stages/links/stages.h"
#include "worker/stages/vpl/rows.h"

namespace gleaner::worker {
namespace {

double luminance(const float* c) { return 0.2126 * c[0] + 0.7152 * c[1] + 0.0722 * c[2]; }

}  // namespace

std::vector<float> mesh_areas(const StageTask& task) {
  const MeshLayout layout = read_mesh_layout(task);
  std::vector<float> areas(layout.vertices);
  InputRows(task, "mesh", 4)
      .visit(layout.areas_at(), layout.vertices, [&](std::uint64_t first, std::span<const std::byte> words) {
        std::memcpy(&areas[first - layout.areas_at()], words.data(), words.size());
      });
  return areas;
}

kernels::LinksFluxFacts flux_of(const std::vector<float>& areas, const std::vector<float>& after,
                                const std::vector<float>& before) {
  kernels::LinksFluxFacts facts;
  for (std::size_t e = 0; e < 2 * areas.size(); ++e) {
    const float* row = &after[e * RADIOSITY_WORDS + RADIOSITY_SENT];
    const double flux = areas[e / 2] * luminance(row);
    facts.flux += flux;
    facts.grown += flux - areas[e / 2] * luminance(&before[e * RADIOSITY_WORDS + RADIOSITY_SENT]);
  }
  return facts;
}

// Stage kind "links_flux".
BatchResult measure_links_flux(const StageTask& task) {
  const auto p = host_parameters<kernels::LinksFluxParameters>(task);
  const std::vector<float> areas = mesh_areas(task);
  const std::vector<float> after = input_rows(task, "radiosity", RADIOSITY_WORDS);
  const std::vector<float> before = input_rows(task, "before", RADIOSITY_WORDS);
  const std::size_t elements = 2 * areas.size(), expected = std::size_t{p.elements} * RADIOSITY_WORDS;
  if (p.elements != elements || after.size() != expected || before.size() != expected)
    throw Error::bad_input(
        "stage links_flux", "inputs", std::to_string(elements) + " elements each",
        std::to_string(after.size() / RADIOSITY_WORDS) + " and " + std::to_string(before.size() / RADIOSITY_WORDS));
  BatchResult result;
  result.counts = {0};
  set_facts(result, flux_of(areas, after, before));
  return result;
}

}  // namespace gleaner::worker

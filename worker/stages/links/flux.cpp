// Stage kind "links_flux": how much light a bounce has added.

#include "kernels/links_records.h"
#include "worker/stages/links/mesh.h"
#include "worker/stages/links/stages.h"
#include "worker/stages/vpl/rows.h"

namespace gleaner::worker {
namespace {

double luminance(const float* c) { return 0.2126 * c[0] + 0.7152 * c[1] + 0.0722 * c[2]; }

}  // namespace

BatchResult measure_links_flux(const StageTask& task) {
  const auto p = host_parameters<kernels::LinksFluxParameters>(task);
  const MeshLayout layout = read_mesh_layout(task);
  const std::vector<float> after = input_rows(task, "radiosity", RADIOSITY_WORDS);
  const std::vector<float> before = input_rows(task, "before", RADIOSITY_WORDS);
  const std::size_t expected = std::size_t{p.elements} * RADIOSITY_WORDS;
  if (p.elements != layout.elements() || after.size() != expected || before.size() != expected)
    throw Error::bad_input(
        "stage links_flux", "inputs", std::to_string(layout.elements()) + " elements each",
        std::to_string(after.size() / RADIOSITY_WORDS) + " and " + std::to_string(before.size() / RADIOSITY_WORDS));
  std::vector<float> areas(layout.vertices);
  InputRows(task, "mesh", 4)
      .visit(layout.areas_at(), layout.vertices, [&](std::uint64_t first, std::span<const std::byte> words) {
        std::memcpy(&areas[first - layout.areas_at()], words.data(), words.size());
      });
  kernels::LinksFluxFacts facts;
  for (std::size_t e = 0; e < p.elements; ++e) {
    const float* row = &after[e * RADIOSITY_WORDS + RADIOSITY_SENT];
    const double flux = areas[e / 2] * luminance(row);
    facts.flux += flux;
    facts.grown += flux - areas[e / 2] * luminance(&before[e * RADIOSITY_WORDS + RADIOSITY_SENT]);
  }
  BatchResult result;
  result.counts = {0};
  set_facts(result, facts);
  return result;
}

}  // namespace gleaner::worker

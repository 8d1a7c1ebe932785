#include "worker/stages/links/flux.h"

#include <cmath>

#include "worker/stages/links/mesh.h"
#include "worker/stages/links/stages.h"
#include "worker/stages/vpl/rows.h"

namespace gleaner::worker {
std::vector<float> element_areas(const StageTask& task) {
  const MeshLayout layout = read_mesh_layout(task);
  std::vector<float> areas(layout.elements());
  InputRows(task, "mesh", 4)
      .visit(layout.areas_at(), layout.vertices, [&](std::uint64_t first, std::span<const std::byte> words) {
        for (std::size_t at = 0; at < words.size(); at += 4, ++first) {
          const auto area = row_word<float>(words.data() + at, 0);
          areas[2 * (first - layout.areas_at())] = areas[2 * (first - layout.areas_at()) + 1] = area;
        }
      });
  if (!task.inputs.contains("lobes")) return areas;
  // Bins have equal projected solid angles.
  const InputRows lobes(task, "lobes", 4);
  if (lobes.rows() < areas.size()) lobes.expect_rows(areas.size());
  lobes.visit(layout.elements(), lobes.rows() - layout.elements(),
              [&](std::uint64_t, std::span<const std::byte> words) {
                for (std::size_t at = 0; at < words.size(); at += 4) {
                  const auto element = row_word<std::uint32_t>(words.data() + at, 0);
                  if (element >= layout.elements())
                    throw Error::bad_input("stage " + task.kind, "input lobes", "elements of the mesh",
                                           std::to_string(element));
                  areas.insert(areas.end(), LOBE_BINS, areas[element] / LOBE_BINS);
                }
              });
  return areas;
}

kernels::LinksFluxFacts flux_of(const std::vector<float>& areas, const std::vector<float>& after,
                                const std::vector<float>& before, const std::vector<float>& earlier) {
  kernels::LinksFluxFacts facts;
  // Calls what(channel, area, flux, last growth, the one before) for each element.
  const auto visit = [&](auto what) {
    for (std::size_t e = 0; e < areas.size(); ++e)
      for (unsigned c = 0; c < 3; ++c) {
        const std::size_t at = e * RADIOSITY_WORDS + RADIOSITY_SENT + c;
        what(c, double{areas[e]}, double{after[at]}, double{after[at]} - before[at], double{before[at]} - earlier[at]);
      }
  };
  visit([&](unsigned c, double area, double sent, double grown, double grew) {
    facts.flux[c] += area * sent;
    facts.grown[c] += area * grown;
    facts.earlier[c] += area * grew;
  });
  visit([&](unsigned c, double area, double, double grown, double grew) {
    facts.strayed[c] += area * std::abs(grown - kernels::LinksBounces::ratio(facts, c) * grew);
  });
  return facts;
}

void add_tail(std::span<float> after, std::span<const float> before, const float* tail) {
  for (std::size_t row = 0; row < after.size(); row += RADIOSITY_WORDS)
    for (const unsigned word : {RADIOSITY_IRRADIANCE, RADIOSITY_SENT})
      for (unsigned c = 0; c < 3; ++c) {
        const std::size_t at = row + word + c;
        after[at] += tail[c] * (after[at] - before[at]);
      }
}

// Stage kind "links_flux".
BatchResult measure_links_flux(const StageTask& task) {
  const auto p = host_parameters<kernels::LinksFluxParameters>(task);
  const std::vector<float> areas = element_areas(task);
  const std::vector<float> after = input_rows(task, "radiosity", RADIOSITY_WORDS);
  const std::vector<float> before = input_rows(task, "before", RADIOSITY_WORDS);
  const std::vector<float> earlier = input_rows(task, "earlier", RADIOSITY_WORDS);
  const std::size_t elements = areas.size(), expected = std::size_t{p.elements} * RADIOSITY_WORDS;
  if (p.elements != elements || after.size() != expected || before.size() != expected || earlier.size() != expected)
    throw Error::bad_input("stage links_flux", "inputs", std::to_string(elements) + " elements each",
                           std::to_string(after.size() / RADIOSITY_WORDS) + ", " +
                               std::to_string(before.size() / RADIOSITY_WORDS) + " and " +
                               std::to_string(earlier.size() / RADIOSITY_WORDS));
  BatchResult result;
  result.counts = {0};
  set_facts(result, flux_of(areas, after, before, earlier));
  return result;
}

}  // namespace gleaner::worker

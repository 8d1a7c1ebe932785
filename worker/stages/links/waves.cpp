#include "worker/stages/links/waves.h"

#include <cmath>

#include "scene/model/error.h"

namespace gleaner::worker {

kernels::LinksParameters read_links_parameters(const StageRun& run) {
  const auto p = run.parameters<kernels::LinksParameters>();
  const auto side = static_cast<std::uint32_t>(std::lround(std::sqrt(p.directions)));
  if (side * side != p.directions || side % 4 != 0 || side == 0 || p.directions > LINKS_MOST_DIRECTIONS)
    throw Error::bad_input(run.where(), "directions",
                           "the square of a multiple of 4, up to " + std::to_string(LINKS_MOST_DIRECTIONS),
                           std::to_string(p.directions));
  if (p.samples == 0 || p.samples % 16 != 0 || p.samples > LINKS_MOST_SAMPLES)
    throw Error::bad_input(run.where(), "samples", "a multiple of 16, up to " + std::to_string(LINKS_MOST_SAMPLES),
                           std::to_string(p.samples));
  const auto hidden = static_cast<std::uint32_t>(std::lround(std::sqrt(p.hidden_directions)));
  if (hidden * hidden != p.hidden_directions || hidden % 4 != 0 || p.hidden_directions > p.directions)
    throw Error::bad_input(run.where(), "hidden_directions",
                           "0, or the square of a multiple of 4, up to " + std::to_string(p.directions),
                           std::to_string(p.hidden_directions));
  run.check_range(p.elements);
  return p;
}

void check_elements(const StageRun& run, std::uint64_t elements, std::uint64_t expected) {
  if (elements != expected)
    throw Error::bad_input(run.where(), "elements", std::to_string(expected) + ", those of the mesh",
                           std::to_string(elements));
}

}  // namespace gleaner::worker

#pragma once
// How much light a bounce has added (LinksFluxFacts).

#include <vector>

#include "kernels/links_records.h"
#include "worker/wavefront/stage_task.h"

namespace gleaner::worker {

// Of each element, m^2: a third of its vertex' one-ring, of the task's input "mesh"; of lobes (input "lobes", if any)
// the same over their number.
std::vector<float> element_areas(const StageTask& task);

// Of rows of RADIOSITY_WORDS, one an element: what they send, and how much that has grown.
kernels::LinksFluxFacts flux_of(const std::vector<float>& areas, const std::vector<float>& after,
                                const std::vector<float>& before);

}  // namespace gleaner::worker

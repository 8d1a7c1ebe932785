#pragma once
// How much light a bounce has added (LinksFluxFacts).

#include <span>
#include <vector>

#include "kernels/links_records.h"
#include "worker/wavefront/stage_task.h"

namespace gleaner::worker {

// Of each element, m^2: a third of its vertex' one-ring, of the task's input "mesh"; of lobes (input "lobes", if any)
// the same over their number.
std::vector<float> element_areas(const StageTask& task);

// Of rows of RADIOSITY_WORDS, one an element, after a bounce and after the two before it: what they send, and how that
// grows.
kernels::LinksFluxFacts flux_of(const std::vector<float>& areas, const std::vector<float>& after,
                                const std::vector<float>& before, const std::vector<float>& earlier);

// Adds the bounces to come to such rows: `tail`, RGB, times what the last one added.
void add_tail(std::span<float> after, std::span<const float> before, const float* tail);

}  // namespace gleaner::worker

#pragma once
// How much light a bounce has added (LinksFluxFacts).

#include <vector>

#include "kernels/links_records.h"
#include "worker/wavefront/stage_task.h"

namespace gleaner::worker {

// A third of each vertex' one-ring, m^2: of the task's input "mesh".
std::vector<float> mesh_areas(const StageTask& task);

// Of rows of RADIOSITY_WORDS, of both sides of each vertex: what they send, and how much that has grown.
kernels::LinksFluxFacts flux_of(const std::vector<float>& areas, const std::vector<float>& after,
                                const std::vector<float>& before);

}  // namespace gleaner::worker

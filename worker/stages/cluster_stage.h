#pragma once
// Stage kinds "vpl_cluster" and "point_cluster": k-means over VPLs or over points to be shaded (algorithm 1 of the
// Colom et al. 2022). Solo.

#include "worker/stages/stage.h"

namespace gleaner::worker {

BatchResult run_cluster_stage(const StageRun& run);

}  // namespace gleaner::worker

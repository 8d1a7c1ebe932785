#pragma once
// Method `vpl`: virtual point lights (VPLs) with fuzzy clusters. Stages of a pass, each reading those before it:
//
//   vpl.trace.P       light paths leave VPLs              vpl.points         some points to be shaded
//   vpl.resample.P    VPLs of equal flux                  vpl.point_cluster  clusters of them
//   vpl.cluster.P     clusters of these
//   vpl.order.P       their order, and their members
//   vpl.visibility.P  which VPL cluster sees which point cluster     (vpl.skipped.P: which were not asked)
//   vpl.shade.P       every pixel's indirect light
//
// Before the first pass, unless all counts are set, a pilot measures what numbers of VPLs and clusters would leave:
// vpl.pilot.*. On a camera trajectory the points are those of several of its cameras (vpl.points.K, vpl.merge_points),
// and all stages but vpl.shade ask for the same in every frame, so that point clusters, and with them their errors,
// stay where they are while the camera moves.
//
// Direct light and all that reaches a surface through mirrors, glass or a smooth lobe comes from camera paths
// (PathSampler), which end where a VPL would be. Passes are independent of each other: their mean has less error, and
// their differences tell how much.

#include "coordinator/plan/methods.h"

namespace gleaner::coordinator {

Method vpl_method();

}  // namespace gleaner::coordinator

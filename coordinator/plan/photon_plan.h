#pragma once
// Method `photon`: photon maps (docs/explanation/photon.md).
//
//   photon.trace -> photon.map -> photon_gather.0, .1, ...            all light but caustics: paths that read the map
//   photon.guide -> photon.guide_map ->                               how wide caustics are estimated
//     photon.trace.P -> photon.map.P -> photon.caustics.P             a pass of caustics, for each P

#include "coordinator/plan/methods.h"

namespace gleaner::coordinator {

Method photon_method();

}  // namespace gleaner::coordinator

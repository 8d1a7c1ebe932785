#pragma once
// Method `links`: radiance links between vertices (Schmitz, Tavenrath & Kobbelt 2008). Stages, each reading those
// before it:
//
//   links.mesh        vertices: nodes of the grids that divide the triangles
//   links.albedo      what they reflect
//   links.make        their links to each other; they stay with the workers that made them
//   links.light       their direct light: light links
//   links.gather.K    bounce K: every vertex gathers over its links
//   links.flux.K      how much that bounce added
//   links.shade       pixels, between the vertices about what they see
//
// The first three know nothing of lights and cameras, so that frames in which these alone differ share them. Direct
// light, mirrors, glass and lobes come from camera paths (PathSampler, kernels/radiosity_filter.h).

#include "coordinator/plan/methods.h"

namespace gleaner::coordinator {

Method links_method();

}  // namespace gleaner::coordinator

#pragma once
// Method `splat`: radiance cache splatting (docs/explanation/splat.md).
//
//   path.0, path.1, ...                                          all light but what the cache carries
//   splat.points -> splat.select -> splat.gather -> splat.shade  what pixels show; where records are needed; their
//                                                                light; pixels lit by them
//
// Where a target error is given, splat.judge looks at the cache before it is splatted: paths get what its errors leave,
// or a better one is made first.
//
// Pictures of a camera trajectory, and those that somebody looks at one after the other, begin with the records of
// cameras that their settings name, in the order in which these stand there:
//
//   splat.extend.0 -> splat.extend.1 -> ... -> splat.select      each adds the places that its camera needs
//       |                  |                        |
//   splat.gather.0     splat.gather.1     ...  splat.gather -> splat.merge -> splat.shade

#include "coordinator/plan/methods.h"

namespace gleaner::coordinator {

Method splat_method();

}  // namespace gleaner::coordinator

#pragma once
// Method `splat`: radiance cache splatting (docs/explanation/splat.md).
//
//   path.0, path.1, ...                                          all light but what the cache carries
//   splat.points -> splat.select -> splat.gather -> splat.shade  what pixels show; where records are needed; their
//                                                                light; pixels lit by them

#include "coordinator/plan/methods.h"

namespace gleaner::coordinator {

Method splat_method();

}  // namespace gleaner::coordinator

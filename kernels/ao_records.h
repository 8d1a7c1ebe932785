// Records of ambient occlusion (kernels/ao.cl).
#ifndef GLEANER_KERNELS_AO_RECORDS_H
#define GLEANER_KERNELS_AO_RECORDS_H

#include "kernels/path_records.h"

#ifndef __OPENCL_VERSION__
namespace gleaner::kernels {
#endif

// Stage kind "ao". Items and records are those of stage kind "path": a sample's direct light is the share of its rays
// that nothing hides, and it has no indirect light.
typedef struct {
  PathParameters samples;  // depth, filter and clamp are not used
  gl_float radius;         // metres; what is farther away hides nothing. 0: any distance hides
  gl_uint rays;            // of each sample, at least 1
  gl_uint reserved[2];
} AoParameters;
GLEANER_SIZE(AoParameters, 144);

#ifndef __OPENCL_VERSION__
}  // namespace gleaner::kernels
#endif

#endif

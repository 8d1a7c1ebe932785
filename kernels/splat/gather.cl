// Gathering: the light that arrives at records, by paths over strata of their hemispheres. Stage kind "splat_gather".
//
//   repeat
//     splat_gather_rays   cosine-weighted rays of records, one a stratum, which fill the room that ended paths left
//     trace               closest hits
//     splat_first_hits    how far the first surfaces are
//     path_shade, trace, shadow_connect    as kernels/path.cl: any number of bounces, lights sampled at each
//   until no path is left
//
// kernels/irradiance_filter.h tells which light is gathered. A ray's slot holds its light in SLOT_INDIRECT, and what
// gradients are made of in the words below; worker/stages/splat/irradiance.cpp makes the record of them.
#define SPLAT_GATHER
#ifndef PATH_FILTER
#define PATH_FILTER 32  // PATH_CLASS_IRRADIANCE
#endif
#include "kernels/path.cl"
#define RECORD_STATE(place) ((vf)FILTER_LAYER)
#include "kernels/splat/record_rays.h"

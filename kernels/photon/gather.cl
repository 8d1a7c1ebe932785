// Final gather: the path tracer, which reads a photon map where its paths have left their first surface. Stage kind
// "photon_gather".
//
//   repeat
//     camera_generate, trace, path_shade, trace, shadow_connect    as kernels/path.cl
//     photon_read    where a path meets a diffuse layer behind its first surface: what the map's density says of the
//                    irradiance there is added to its slot
//   until no path is left
//
// The first surface is scattered from by its BSDF, so that over a diffuse layer gather rays are distributed by the
// cosine. kernels/path_filter.h tells which light is read and which the path finds. The estimate divides the power of
// the k - 1 nearest photons by the disc that the k-th is on: of photons strewn evenly its mean is their density.
#include "kernels/photon/layer.h"

#define PHOTON_GATHER
#ifndef PATH_FILTER
#define PATH_FILTER 7  // of both maps
#endif
#include "kernels/path.cl"
#include "kernels/photon/read.h"

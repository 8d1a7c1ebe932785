// Final gather at the sample points of shading clusters (Wang et al. 2009, section 3.3). Stage kind
// "photon_cluster_gather".
//
//   repeat
//     splat_gather_rays   cosine-weighted rays of records, one a stratum     (kernels/splat/record_rays.h)
//     trace, splat_first_hits, path_shade, trace, shadow_connect    as kernels/splat/gather.cl
//     photon_read    the map's light where a path meets a diffuse layer      (kernels/photon/read.h)
//   until no path is left
//
// Gathers what PATH_CLASS_LAYER takes from camera paths: DIFFUSE and MIXED light, not CAUSTIC. Light that the first
// rays find themselves is direct, and stays in the slot's other half. A surface nearer than the spacing of the map or
// of the record is not read: the path goes on.
#include "kernels/photon/layer.h"

#define PHOTON_GATHER
#define PHOTON_RECORDS
#ifndef PATH_FILTER
#define PATH_FILTER 7  // PATH_CLASS_DIFFUSE, PATH_CLASS_CAUSTIC and PATH_CLASS_MIXED
#endif
#include "kernels/path.cl"
#define RECORD_STATE(place) (max_f(place[SPLAT_SPACING], (vf)1e-6f))
#include "kernels/photon/read.h"
#include "kernels/splat/record_rays.h"

// Records of k-means (kernels/cluster.cl).
#ifndef GLEANER_KERNELS_CLUSTER_RECORDS_H
#define GLEANER_KERNELS_CLUSTER_RECORDS_H

#include "kernels/records.h"

#ifndef __OPENCL_VERSION__
namespace gleaner::kernels {
#endif

// Stage kinds "vpl_cluster" (input "lights": rows of VPL_WORDS) and "point_cluster" (input "points"); solo. An item is
// a cluster; its record is a row of VPL_WORDS words, of flux 0 where empty, or of POINT_WORDS words, none where empty.
// vpl_cluster says behind its clusters which one each of the lights is in: uints, in the lights' order, in rows of
// VPL_WORDS.
typedef struct {
  gl_uint clusters;
  gl_uint iterations;
  gl_float least_cosine;  // eq. 7: nt
  // 0: a cluster's representative is the member nearest to its centroid. Else a random member, in proportion to its
  // flux, by this key: the mean over many keys is what all members would give.
  gl_uint random_representative;
  gl_uint lights;  // rows of "lights", all of some flux
  gl_uint reserved[3];
} ClusterParameters;
GLEANER_SIZE(ClusterParameters, 32);

// Normals that may share a cluster, and points that a cluster may speak for: eq. 7's threshold nt, sqrt(3) / 2.
#define CLUSTER_LEAST_COSINE 0.8660254f

#ifndef __OPENCL_VERSION__
}  // namespace gleaner::kernels
#endif

#endif

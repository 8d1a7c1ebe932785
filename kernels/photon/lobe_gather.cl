// Gathering incoming radiance at the sample points of shading clusters (Wang et al. 2009, section 3.4: "Representing
// Radiance Fields using SH"), as kernels/photon/cluster_gather.cl gathers irradiance, by rays of equal solid angle.
#define RECORD_RADIANCE
#include "kernels/photon/cluster_gather.cl"

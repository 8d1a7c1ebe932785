// Gathering incoming radiance at records, as kernels/splat/gather.cl gathers irradiance. Stage kind
// "splat_lobe_gather"; worker/stages/splat/radiance.cpp makes the record.
#define RECORD_RADIANCE
#include "kernels/splat/gather.cl"

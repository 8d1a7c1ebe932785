// What all methods' records share. Records are what stages take and give, as bytes on the wire and as kernels read
// them: one header a method, compiled by OpenCL C and by C++; little-endian.
#ifndef GLEANER_KERNELS_RECORDS_H
#define GLEANER_KERNELS_RECORDS_H

#include "scene/model/records.h"

#ifndef __OPENCL_VERSION__
namespace gleaner::kernels {
using scene::Camera;
}  // namespace gleaner::kernels
#endif

// How many items of a batch a stage names whose record was not finite: the first words of a report count them.
#define REPORTED_ITEMS 8u

#endif

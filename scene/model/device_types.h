// Scalar types under one name for OpenCL C and C++, so that a struct written once has one layout on both sides.
// Structs shared with kernels hold only these scalars and arrays of them (no float3: it is 16 bytes in OpenCL C).
#ifndef GLEANER_SCENE_MODEL_DEVICE_TYPES_H
#define GLEANER_SCENE_MODEL_DEVICE_TYPES_H

#ifdef __OPENCL_VERSION__
typedef float gl_float;
typedef uint gl_uint;
typedef int gl_int;
#define GLEANER_SIZE(type, bytes)
#else
#include <cstdint>
using gl_float = float;
using gl_uint = std::uint32_t;
using gl_int = std::int32_t;
#define GLEANER_SIZE(type, bytes) \
  static_assert(sizeof(type) == (bytes), #type " must have the same layout on host and device")
#endif

#endif

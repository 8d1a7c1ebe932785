#include "worker/trace/tracer.h"

#ifdef GLEANER_WITH_EMBREE
#if __has_include(<embree4/rtcore.h>)
#include <embree4/rtcore.h>
#else
#include <embree3/rtcore.h>
#endif
#endif

namespace gleaner::worker {

std::string tracer_description(TraceKind kind) {
#ifdef GLEANER_WITH_EMBREE
  if (kind == TraceKind::embree) return "Embree " RTC_VERSION_STRING;
#endif
  return kind == TraceKind::opencl ? "OpenCL BVH2" : "none";
}

}  // namespace gleaner::worker

#include "worker/trace/tracer.h"

#include "scene/model/error.h"

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

void check_motion(const SceneMotion& motion, std::size_t instances, std::size_t position_values) {
  if (!motion.instances.empty() && motion.instances.size() != instances)
    throw Error::failed("a motion of " + std::to_string(motion.instances.size()) + " instances, of a scene that has " +
                        std::to_string(instances));
  if (!motion.deformed.empty() && motion.positions.size() != position_values)
    throw Error::failed("a motion of " + std::to_string(motion.positions.size()) +
                        " coordinates, of a scene that has " + std::to_string(position_values));
}

MotionReport Tracer::follow(const SceneMotion&) { throw Error::failed("this tracer follows no motion yet"); }

}  // namespace gleaner::worker

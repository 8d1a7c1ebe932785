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

void check_motion(const SceneMotion& motion, std::span<const scene::Instance> instances, std::size_t position_values) {
  if (!motion.instances.empty() && motion.instances.size() != instances.size())
    throw Error::failed("a motion of " + std::to_string(motion.instances.size()) + " instances, of a scene that has " +
                        std::to_string(instances.size()));
  for (std::size_t i = 0; i < motion.instances.size(); ++i)
    if (motion.instances[i].mesh != instances[i].mesh)
      throw Error::failed("instance " + std::to_string(i) + " is of another mesh than when the scene was loaded");
  if (!motion.deformed.empty() && motion.positions.size() != position_values)
    throw Error::failed("a motion of " + std::to_string(motion.positions.size()) +
                        " coordinates, of a scene that has " + std::to_string(position_values));
}

}  // namespace gleaner::worker

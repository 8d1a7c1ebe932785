#include "scene/model/error.h"
#include "worker/trace/tracer.h"

namespace gleaner::worker {

bool embree_available() { return false; }

std::unique_ptr<Tracer> make_embree_tracer(const scene::Scene&, unsigned, const std::string&) {
  throw Error::failed("this program was built without Embree");
}

}  // namespace gleaner::worker

#include "coordinator/plan/path_plan.h"

#include <nlohmann/json.hpp>

namespace gleaner::coordinator {

PathPlan::PathPlan(const FrameSettings& settings, const SceneSummary& scene, const PathSampler::Complement& complement)
    : GraphPlan(settings, scene), complement_(complement), paths_(graph_, film_, settings) {
  skips_ = path_skips(scene.needs);
}

std::string PathPlan::parameters_json() const { return paths_.parameters().dump(); }

Method path_method() {
  return {.name = "path",
          .help = "Path tracing: the reference. Samples go where the noise is.",
          .make = make_plan_of<PathPlan>,
          .bytes_a_pixel = kPathBytesAPixel};
}

}  // namespace gleaner::coordinator

#include "coordinator/plan/plan.h"

#include <cmath>
#include <set>

#include "coordinator/plan/path_plan.h"
#include "coordinator/plan/setting.h"
#include "coordinator/plan/vpl_plan.h"
#include "coordinator/plan/vpl_settings.h"
#include "scene/model/error.h"

namespace gleaner::coordinator {
namespace {

// --set names of all methods: a name that belongs to another method is not an error, so that one command line serves
// all.
const std::set<std::string>& known_settings() {
  static const std::set<std::string> names = {"depth",         "vpl.clamp", "vpl.clusters",       "vpl.compensate",
                                              "vpl.count",     "vpl.doubt", "vpl.draw",           "vpl.equal_weights",
                                              "vpl.fuzziness", "vpl.least", "vpl.point_clusters", "vpl.samples",
                                              "vpl.sets"};
  return names;
}

}  // namespace

SceneSummary summarize(const scene::Scene& scene) {
  SceneSummary summary;
  summary.needs = scene::needs_of(scene);
  summary.triangles = scene.triangle_count();
  summary.lights = scene.lights.size();
  summary.bounds = scene::bounds_of(scene);
  for (std::uint32_t material : scene.triangle_material) {
    const scene::Material& m = scene.materials[material];
    if (m.emission[0] > 0 || m.emission[1] > 0 || m.emission[2] > 0) ++summary.emissive_triangles;
  }
  return summary;
}

namespace {

// Throws as check_settings() does. The settings with what --set says in place of their fields.
FrameSettings checked(const FrameSettings& given) {
  FrameSettings settings = given;
  const std::uint64_t pixels = std::uint64_t{settings.width} * settings.height;
  if (pixels == 0 || pixels > (std::uint64_t{1} << 28))
    throw Error::usage("--size: expected 1 to 2^28 pixels, found " + std::to_string(settings.width) + "x" +
                       std::to_string(settings.height));
  if (settings.spp == 0 || settings.spp > (1u << 20))
    throw Error::usage("--spp: expected 1 to 1048576 samples a pixel, found " + std::to_string(settings.spp));
  if (!(settings.target_error >= 0) || !std::isfinite(settings.target_error))
    throw Error::usage("--target-error: expected a number above 0");
  for (const auto& [key, value] : settings.set)
    if (!known_settings().contains(key)) {
      std::string names;
      for (const std::string& name : known_settings()) names += (names.empty() ? "" : ", ") + name;
      throw Error::usage("--set " + key + ": no such setting; known: " + names);
    }
  settings.depth = whole_setting(settings, "depth", settings.depth, 0, 1u << 30);
  if (settings.method == "auto") settings.method = "path";
  if (settings.method != "path" && settings.method != "vpl")
    throw Error::usage("--method: expected path or vpl, found " + settings.method);
  if (settings.method == "vpl") make_vpl_settings(settings);
  return settings;
}

}  // namespace

void check_settings(const FrameSettings& settings, const SceneSummary&) { checked(settings); }

std::uint64_t predicted_memory(const FrameSettings& given, const SceneSummary&) {
  const FrameSettings settings = checked(given);
  return settings.method == "vpl" ? VplPlan::memory(settings) : PathPlan::memory(settings);
}

std::unique_ptr<Plan> make_plan(const FrameSettings& given, const SceneSummary& scene) {
  const FrameSettings settings = checked(given);
  if (settings.method == "vpl") return std::make_unique<VplPlan>(settings, scene);
  return std::make_unique<PathPlan>(settings, scene);
}

}  // namespace gleaner::coordinator

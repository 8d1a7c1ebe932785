#include "coordinator/plan/plan.h"

#include <cmath>

#include "coordinator/film/accumulator.h"
#include "coordinator/plan/denoise_plan.h"
#include "coordinator/plan/limited_plan.h"
#include "coordinator/plan/methods.h"
#include "scene/model/error.h"

namespace gleaner::coordinator {

Denoise parse_denoise(const std::string& word) {
  for (const Denoise denoise : {Denoise::off, Denoise::fast, Denoise::high})
    if (word == word_of(denoise)) return denoise;
  throw Error::usage("--denoise: expected off, fast or high, found \"" + word + "\"");
}

const char* word_of(Denoise denoise) {
  return denoise == Denoise::off ? "off" : denoise == Denoise::fast ? "fast" : "high";
}

SceneSummary summarize(const scene::Scene& scene) {
  SceneSummary summary;
  summary.needs = scene::needs_of(scene);
  summary.triangles = scene.triangle_count();
  summary.lights = scene.lights.size();
  summary.bounds = summary.rest_bounds = scene::bounds_of(scene);
  summary.matrices = scene.rig.matrices;
  summary.morph_weights = scene.rig.morph_weights;
  for (std::uint32_t material : scene.triangle_material) {
    const scene::Material& m = scene.materials[material];
    if (m.emission[0] > 0 || m.emission[1] > 0 || m.emission[2] > 0) ++summary.emissive_triangles;
    if (!(m.flags & GLEANER_MATERIAL_UNLIT) && (m.metallic > 0 || m.specular > 0))
      summary.roughest_lobe = std::max(summary.roughest_lobe, m.roughness * m.roughness);
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
  if (settings.denoise != Denoise::off && settings.spp < 2)
    throw Error::usage("--denoise: expected --spp 2 or more, since two halves of the samples tell its error; found 1");
  rename_old_settings(settings.set);
  check_set(settings.set);
  settings.depth = whole_setting(settings, "depth").value_or(settings.depth);
  const Method& method = method_of(settings.method);
  settings.method = method.name;
  if (method.check) method.check(settings);
  return settings;
}

}  // namespace

void check_settings(const FrameSettings& settings, const SceneSummary&) { checked(settings); }

std::uint64_t predicted_memory(const FrameSettings& given, const SceneSummary&) {
  const FrameSettings settings = checked(given);
  return std::uint64_t{settings.width} * settings.height *
         (Accumulator::bytes_a_pixel + method_of(settings.method).bytes_a_pixel +
          (settings.denoise == Denoise::off ? 0 : kDenoiseBytesAPixel));
}

std::unique_ptr<Plan> make_plan(const FrameSettings& given, const SceneSummary& scene) {
  const FrameSettings settings = checked(given);
  const auto make = method_of(settings.method).make;
  std::unique_ptr<Plan> plan =
      settings.limited ? std::make_unique<LimitedPlan>(settings, scene, make) : make(settings, scene);
  return settings.denoise == Denoise::off ? std::move(plan)
                                          : std::make_unique<DenoisePlan>(settings, scene, std::move(plan));
}

}  // namespace gleaner::coordinator

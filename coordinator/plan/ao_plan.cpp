#include "coordinator/plan/ao_plan.h"

#include <nlohmann/json.hpp>

#include "coordinator/plan/path_sampler.h"
#include "kernels/ao_records.h"

namespace gleaner::coordinator {
namespace {

// What AoParameters has behind the sampler's part.
struct AoSettings {
  float radius;
  std::uint32_t rays;
  std::uint32_t reserved[2];
};
static_assert(sizeof(kernels::PathParameters) + sizeof(AoSettings) == sizeof(kernels::AoParameters));

AoSettings read_settings(const FrameSettings& settings) {
  return {static_cast<float>(real_setting(settings, "ao.radius").value_or(0)),
          whole_setting(settings, "ao.rays").value_or(4),
          {}};
}

class AoPlan final : public GraphPlan {
 public:
  AoPlan(const FrameSettings& settings, const SceneSummary& scene)
      : GraphPlan(settings, scene),
        ao_(read_settings(settings)),
        samples_(graph_, film_, settings, {.kind = "ao", .method_parameters = bytes_of(ao_), .sees_emission = false}) {
    skips_.push_back({"lights and materials", "ambient occlusion is of the shape alone", 1});
    if (!scene.needs.alpha) skips_.push_back({"alpha tests", "every surface is opaque", 1});
  }

  bool conclude(const std::vector<CutStage>& cut) override { return samples_.conclude(cut, skips_); }
  double predicted_work() const override { return samples_.predicted_work(); }
  std::vector<std::string> warnings() const override { return samples_.warnings(); }
  std::string parameters_json() const override {
    nlohmann::json json = samples_.parameters();
    json.erase("depth");
    json["ao.radius"] = ao_.radius;
    json["ao.rays"] = ao_.rays;
    return json.dump();
  }
  std::vector<std::string> outline() const override { return samples_.outline(); }

 private:
  void begin() override { samples_.begin({}); }

  AoSettings ao_;
  PathSampler samples_;
};

}  // namespace

Method ao_method() {
  return {
      .name = "ao",
      .help =
          "Ambient occlusion: how much of the hemisphere over each point nothing near hides. A clay preview: 1 is "
          "open, 0 is hidden, and where the camera sees no surface the picture is 1.",
      .make = make_plan_of<AoPlan>,
      .bytes_a_pixel = kPathBytesAPixel,
      .settings = {
          {"ao.radius", SettingType::real, 0, 1e9, "0", "metres; what is farther away hides nothing; 0: any distance"},
          {"ao.rays", SettingType::whole, 1, 1024, "4", "rays of each sample of a pixel"},
      }};
}

}  // namespace gleaner::coordinator

#pragma once
// Method `path`: the path tracer, the reference of all other methods.

#include "coordinator/plan/methods.h"
#include "coordinator/plan/path_sampler.h"

namespace gleaner::coordinator {

class PathPlan final : public GraphPlan {
 public:
  PathPlan(const FrameSettings& settings, const SceneSummary& scene) : PathPlan(settings, scene, {}) {}
  PathPlan(const FrameSettings& settings, const SceneSummary& scene, const PathSampler::Complement& complement);

  bool conclude(const std::vector<CutStage>& cut) override { return paths_.conclude(cut, skips_); }
  double predicted_work() const override { return paths_.predicted_work(); }
  std::vector<std::string> warnings() const override { return paths_.warnings(); }
  std::string parameters_json() const override;
  std::vector<std::string> outline() const override { return paths_.outline(); }

 private:
  void begin() override { paths_.begin(complement_); }

  PathSampler::Complement complement_;
  PathSampler paths_;
};

Method path_method();

}  // namespace gleaner::coordinator

#pragma once
// Any method's plan for a frame with a time limit. A small stage of paths shows how fast the farm is; then the method
// is planned for so many samples as there is time for. Where the farm is faster after all, samples go on.

#include <limits>
#include <memory>

#include "coordinator/plan/graph.h"

namespace gleaner::coordinator {

class LimitedPlan final : public Plan {
 public:
  using Maker = std::unique_ptr<Plan> (*)(const FrameSettings& settings, const SceneSummary& scene);

  // Throws as `make` does.
  LimitedPlan(const FrameSettings& settings, const SceneSummary& scene, Maker make);

  Step next(const FinishedStage* finished) override;
  void take(const std::string& stage, std::uint64_t first, std::uint64_t count, const Bytes& records) override;
  double predicted_work() const override { return method_->predicted_work(); }
  void allow(double work) override;
  void preview(const std::string& stage, std::uint64_t first, std::uint64_t count, const Bytes& records) override;
  Film preview_film(bool guides = false) const override { return method_->preview_film(guides); }
  // How fast the farm is, shows no picture.
  bool conclude(const std::vector<CutStage>& cut) override { return planned() && method_->conclude(cut); }
  double shared_squared_error() const override { return method_->shared_squared_error(); }
  Step after_conclude() override { return method_->after_conclude(); }
  Film film() const override { return method_->film(); }
  Film take_film() override { return method_->take_film(); }
  Film take_picture() override { return method_->take_picture(); }
  std::vector<Skip> skips() const override { return method_->skips(); }
  std::vector<std::string> warnings() const override { return method_->warnings(); }
  std::string parameters_json() const override { return method_->parameters_json(); }
  std::vector<std::string> outline() const override;

 private:
  bool planned() const { return settings_.fitting_spp > 0; }
  void ask_pace();
  std::uint32_t fitting_spp() const;

  FrameSettings settings_;
  SceneSummary scene_;
  Maker make_;
  std::unique_ptr<Plan> method_;  // until the farm's pace is known: for all samples
  Graph graph_;
  Graph::Artifact pace_;
  double allowed_ = std::numeric_limits<double>::infinity();  // work, by the latest word
};

}  // namespace gleaner::coordinator

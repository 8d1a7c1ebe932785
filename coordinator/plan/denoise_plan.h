#pragma once
// Any method's plan with one stage more: what it has rendered is denoised (kernels/denoise_records.h).

#include <memory>
#include <optional>

#include "coordinator/plan/graph.h"
#include "kernels/denoise_records.h"

namespace gleaner::coordinator {

class DenoisePlan final : public Plan {
 public:
  // `method` shows two halves of its samples in its film (Accumulator::keep_halves()).
  DenoisePlan(const FrameSettings& settings, const SceneSummary& scene, std::unique_ptr<Plan> method);

  Step next(const FinishedStage* finished) override;
  void take(const std::string& stage, std::uint64_t first, std::uint64_t count, const Bytes& records) override;
  double predicted_work() const override;
  void preview(const std::string& stage, std::uint64_t first, std::uint64_t count, const Bytes& records) override;
  Film preview_film() const override;
  // The picture is then as it was sampled.
  bool conclude(const std::vector<CutStage>& cut) override;
  // The method's layers; R G B denoised, and noisy.* and error.Y beside them.
  Film film() const override;
  Film take_film() override;
  std::vector<Skip> skips() const override;
  std::vector<std::string> warnings() const override { return method_->warnings(); }
  std::string parameters_json() const override;
  std::vector<std::string> outline() const override;

 private:
  Step ask();
  void absorb(const Bytes& records);

  FrameSettings settings_;
  std::unique_ptr<Plan> method_;
  Graph graph_;
  Graph::Artifact stage_;
  std::optional<Film> film_;  // once the method is done
  std::optional<kernels::DenoiseFacts> facts_;
  bool cut_ = false;  // the time limit came first
};

// What the stage's input, its records and the layers of its own take.
inline constexpr std::uint64_t kDenoiseBytesAPixel =
    (kernels::kDenoiseWords + 8) * sizeof(float) + sizeof(kernels::DenoiseRecord);

}  // namespace gleaner::coordinator

#pragma once
// Any method's plan with one stage more: what it has rendered is denoised (kernels/denoise_records.h).

#include <memory>
#include <optional>
#include <span>
#include <string>
#include <utility>

#include "coordinator/plan/graph.h"
#include "kernels/denoise_records.h"

namespace gleaner::coordinator {

// Asks for a film to be denoised: a solo stage, whose facts and records the next two functions read. Throws as
// denoiser_input() does.
Graph::Artifact ask_denoising(Graph& graph, const std::string& name, const Film& film, Denoise quality);
kernels::DenoiseFacts denoise_facts(const Graph::Artifact& stage);
std::span<const kernels::DenoiseRecord> denoise_records(const Graph::Artifact& stage);

class DenoisePlan final : public Plan {
 public:
  // `method` shows two halves of its samples in its film (Accumulator::keep_halves()).
  DenoisePlan(const FrameSettings& settings, const SceneSummary& scene, std::unique_ptr<Plan> method);

  Step next(const FinishedStage* finished) override;
  void take(const std::string& stage, std::uint64_t first, std::uint64_t count, const Bytes& records) override;
  double predicted_work() const override;
  void allow(double work) override;
  void preview(const std::string& stage, std::uint64_t first, std::uint64_t count, const Bytes& records) override;
  Film preview_film(bool guides = false) const override;
  // What there is of the samples is denoised all the same.
  bool conclude(const std::vector<CutStage>& cut) override;
  Step after_conclude() override;
  // The method's layers; R G B denoised, and noisy.* and error.Y beside them.
  Film film() const override;
  Film take_film() override;
  std::vector<Skip> skips() const override;
  std::vector<std::string> warnings() const override;
  std::string parameters_json() const override;
  std::vector<std::string> outline() const override;

 private:
  Step ask();
  double own_work() const;

  FrameSettings settings_;
  std::unique_ptr<Plan> method_;
  Graph graph_;
  Graph::Artifact stage_;
  std::optional<Film> film_;  // once the method is done
  std::optional<kernels::DenoiseFacts> facts_;
  double shared_ = 0;  // Plan::shared_squared_error()
};

// A picture that is there already, as the method of a DenoisePlan.
class GivenPicture final : public Plan {
 public:
  explicit GivenPicture(Film film) : film_(std::move(film)) {}

  Step next(const FinishedStage*) override;
  void preview(const std::string&, std::uint64_t, std::uint64_t, const Bytes&) override {}
  Film preview_film(bool) const override { return film_; }
  Film film() const override { return film_; }
  Film take_film() override { return std::move(film_); }
  std::vector<Skip> skips() const override { return {}; }
  std::string parameters_json() const override { return "{}"; }
  std::vector<std::string> outline() const override { return {}; }

 private:
  Film film_;
};

// What the stage's input, its records and the layers of its own take.
inline constexpr std::uint64_t kDenoiseBytesAPixel =
    (kernels::kDenoiseWords + 2 * kernels::kDenoiseEmissionWords + 8) * sizeof(float) + sizeof(kernels::DenoiseRecord);

}  // namespace gleaner::coordinator

#include "coordinator/plan/limited_plan.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <utility>

#include "kernels/path_records.h"

namespace gleaner::coordinator {
namespace {

using kernels::PathParameters;
using kernels::PathRecord;

// Of the stage that shows how fast the farm is: some tenths of a second on two cores.
constexpr std::uint32_t kPacePixels = 1u << 14, kPaceSamples = 16;
// Of the time that is left, what is planned for; the rest is for what predictions miss.
constexpr double kPlannedShare = 0.85;
// Samples of a pixel that are planned for where nothing is known of the farm.
constexpr std::uint32_t kUnknownPaceSamples = 16;

}  // namespace

LimitedPlan::LimitedPlan(const FrameSettings& settings, const SceneSummary& scene, Maker make)
    : settings_(settings), scene_(scene), make_(make), method_(make(settings, scene)), graph_(scene.lineage) {}

Step LimitedPlan::next(const FinishedStage* finished) {
  if (planned()) return method_->next(finished);
  if (!finished) {
    ask_pace();
    return graph_.take_step();
  }
  graph_.finish(*finished);
  pace_ = {};
  settings_.fitting_spp = fitting_spp();
  method_ = make_(settings_, scene_);
  method_->allow(allowed_);
  Step step = method_->next(nullptr);
  for (ArtifactId& id : graph_.take_step().released) step.released.push_back(std::move(id));
  return step;
}

// The picture's paths, at fewer pixels. Nobody reads what they bring.
void LimitedPlan::ask_pace() {
  const double pixels = static_cast<double>(settings_.width) * settings_.height;
  const double edge = std::min(1.0, std::sqrt(kPacePixels / pixels));
  PathParameters p{};
  p.camera = settings_.camera;
  p.width = std::max(1u, static_cast<std::uint32_t>(edge * settings_.width));
  p.height = std::max(1u, static_cast<std::uint32_t>(edge * settings_.height));
  p.samples_per_item = p.last_item_samples = kPaceSamples;
  p.depth = settings_.depth;
  p.seed_low = low(settings_.seed);
  p.seed_high = high(settings_.seed);
  p.items_low = p.width * p.height;
  pace_ = graph_.add({.name = "pace",
                      .kind = "path",
                      .items = p.items_low,
                      .work = static_cast<double>(p.items_low) * kPaceSamples,
                      .output = {.record_bytes = sizeof(PathRecord), .placement = Placement::stream, .floats = true}},
                     p);
}

// As many as fit, in powers of two below what is asked for.
std::uint32_t LimitedPlan::fitting_spp() const {
  const std::uint32_t least = settings_.denoise == Denoise::off ? 1 : 2;
  if (!std::isfinite(allowed_)) return std::min(settings_.spp, kUnknownPaceSamples);
  FrameSettings settings = settings_;
  for (settings.fitting_spp = settings.spp; settings.fitting_spp > least;
       settings.fitting_spp = std::bit_floor(settings.fitting_spp - 1))
    if (make_(settings, scene_)->predicted_work() <= kPlannedShare * allowed_) break;
  return std::max(settings.fitting_spp, least);
}

void LimitedPlan::take(const std::string& stage, std::uint64_t first, std::uint64_t count, const Bytes& records) {
  if (planned())
    method_->take(stage, first, count, records);
  else
    graph_.take(stage, first, count, records);
}

void LimitedPlan::allow(double work) {
  allowed_ = work;
  method_->allow(work);
}

void LimitedPlan::preview(const std::string& stage, std::uint64_t first, std::uint64_t count, const Bytes& records) {
  if (planned()) method_->preview(stage, first, count, records);
}

std::vector<std::string> LimitedPlan::outline() const {
  std::vector<std::string> lines = {"pace: paths of up to " + std::to_string(kPacePixels) +
                                    " pixels, split: how fast the farm is; the counts below are for all samples, and "
                                    "become less where the time limit asks"};
  for (std::string& line : method_->outline()) lines.push_back(std::move(line));
  return lines;
}

}  // namespace gleaner::coordinator

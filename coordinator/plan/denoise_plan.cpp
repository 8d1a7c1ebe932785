#include "coordinator/plan/denoise_plan.h"

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>
#include <utility>

#include "coordinator/plan/denoised_film.h"
#include "scene/model/names.h"

namespace gleaner::coordinator {
namespace {

using kernels::DenoiseFacts;
using kernels::DenoiseParameters;
using kernels::DenoiseRecord;

// What denoising a pixel costs, in samples of a path tracer.
constexpr double kWorkAPixel = 2;

}  // namespace

Graph::Artifact ask_denoising(Graph& graph, const std::string& name, const Film& film, Denoise quality) {
  const DenoiserInput input = denoiser_input(film, "the frame");
  DenoiseParameters p{};
  p.width = film.width;
  p.height = film.height;
  p.quality = quality == Denoise::fast ? kernels::kDenoiseFast : kernels::kDenoiseHigh;
  p.halves = input.halves ? 1 : 0;
  p.emission = input.emission ? 1 : 0;
  StageSpec spec;
  spec.name = name;
  spec.kind = "denoise";
  spec.items = std::uint64_t{p.width} * p.height;
  spec.solo = true;
  spec.denoises = true;
  spec.scene_parts = kNoScene;
  spec.work = kWorkAPixel * static_cast<double>(spec.items);
  spec.output = {.record_bytes = sizeof(DenoiseRecord), .floats = true};
  return graph.add(std::move(spec), p, {{"film", graph.data(input.planes)}});
}

DenoiseFacts denoise_facts(const Graph::Artifact& stage) {
  auto facts = stage.facts<DenoiseFacts>();
  // Words of a worker's: they end.
  for (const auto& [word, size] : {std::pair{facts.version, sizeof facts.version},
                                   {facts.device, sizeof facts.device},
                                   {facts.why, sizeof facts.why}})
    word[size - 1] = 0;
  const auto sound = [](double value) { return value >= 0 && std::isfinite(value); };
  stage.check_facts(sound(facts.squared_error) && sound(facts.deviation) && facts.denoised >= 0 && facts.denoised <= 1,
                    "a squared error of " + std::to_string(facts.squared_error) + " +- " +
                        std::to_string(facts.deviation) + ", and a denoised share of " +
                        std::to_string(facts.denoised));
  return facts;
}

std::span<const DenoiseRecord> denoise_records(const Graph::Artifact& stage) {
  const Bytes& bytes = stage.records();
  return {reinterpret_cast<const DenoiseRecord*>(bytes.data()), bytes.size() / sizeof(DenoiseRecord)};
}

Step GivenPicture::next(const FinishedStage*) {
  Step step;
  step.done = true;
  return step;
}

DenoisePlan::DenoisePlan(const FrameSettings& settings, const SceneSummary& scene, std::unique_ptr<Plan> method)
    : settings_(settings), method_(std::move(method)), graph_(scene.lineage) {}

Step DenoisePlan::next(const FinishedStage* finished) {
  if (!film_) {
    Step step = method_->next(finished);
    if (!step.done) return step;
    Step last = ask();
    // What was judged for a target error may be the very same film.
    last.released = std::move(step.released);
    std::erase_if(last.released, [&](const ArtifactId& id) { return last.artifacts.contains(id); });
    return last;
  }
  graph_.finish(*finished);
  facts_ = denoise_facts(stage_);
  show_denoised(*film_, denoise_records(stage_), true);
  for (float& error : film_->channel("error.Y").values) error += static_cast<float>(shared_);
  stage_ = {};
  Step step = graph_.take_step();
  step.done = true;
  return step;
}

Step DenoisePlan::ask() {
  shared_ = method_->shared_squared_error();
  film_ = method_->take_film();
  stage_ = ask_denoising(graph_, "denoise", *film_, settings_.denoise);
  return graph_.take_step();
}

Step DenoisePlan::after_conclude() { return ask(); }

void DenoisePlan::take(const std::string& stage, std::uint64_t first, std::uint64_t count, const Bytes& records) {
  method_->take(stage, first, count, records);
}

double DenoisePlan::own_work() const { return kWorkAPixel * settings_.width * settings_.height; }

double DenoisePlan::predicted_work() const { return film_ ? 0 : method_->predicted_work() + own_work(); }

void DenoisePlan::allow(double work) { method_->allow(std::max(0.0, work - own_work())); }

void DenoisePlan::preview(const std::string& stage, std::uint64_t first, std::uint64_t count, const Bytes& records) {
  if (!film_) method_->preview(stage, first, count, records);
}

Film DenoisePlan::preview_film(bool guides) const {
  if (!film_) return method_->preview_film(guides);
  Film film{film_->width, film_->height, {}};
  for (const char* name : {"R", "G", "B"}) film.channels.push_back(*film_->find(name));
  return film;
}

bool DenoisePlan::conclude(const std::vector<CutStage>& cut) { return !film_ && method_->conclude(cut); }

Film DenoisePlan::film() const { return film_ ? *film_ : method_->film(); }

Film DenoisePlan::take_film() { return film_ ? std::move(*film_) : method_->take_film(); }

std::vector<Skip> DenoisePlan::skips() const { return method_->skips(); }

std::vector<std::string> DenoisePlan::warnings() const {
  std::vector<std::string> warnings = method_->warnings();
  if (facts_ && !facts_->version[0]) warnings.push_back("the picture is not denoised: " + printable(facts_->why));
  return warnings;
}

std::string DenoisePlan::parameters_json() const {
  nlohmann::json json = nlohmann::json::parse(method_->parameters_json());
  nlohmann::json denoise = {{"quality", word_of(settings_.denoise)}};
  if (facts_) {
    if (facts_->version[0]) {
      denoise["library"] = "Open Image Denoise " + printable(facts_->version);
      denoise["device"] = printable(facts_->device);
    }
    denoise["share"] = facts_->denoised;
    if (facts_->mean > 0) denoise["expected_error"] = std::sqrt(facts_->squared_error + shared_) / facts_->mean;
  }
  json["denoise"] = std::move(denoise);
  return json.dump();
}

std::vector<std::string> DenoisePlan::outline() const {
  std::vector<std::string> lines = method_->outline();
  lines.push_back("denoise: " + std::to_string(std::uint64_t{settings_.width} * settings_.height) +
                  " items, on one worker: two halves of the samples, which tell each other's error");
  return lines;
}

}  // namespace gleaner::coordinator

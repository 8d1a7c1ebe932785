#include "coordinator/plan/denoise_plan.h"

#include <cmath>
#include <cstring>
#include <iterator>
#include <nlohmann/json.hpp>
#include <utility>

#include "scene/model/error.h"

namespace gleaner::coordinator {
namespace {

using kernels::DenoiseFacts;
using kernels::DenoiseParameters;
using kernels::DenoiseRecord;

// What denoising a pixel costs, in samples of a path tracer.
constexpr double kWorkAPixel = 2;

constexpr const char* kColor[] = {"R", "G", "B"};

// Three channels as a plane of the stage's input, pixel by pixel.
float* interleave(const Film& film, const std::string& layer, const char* const names[3], float* to) {
  for (std::size_t k = 0; k < 3; ++k)
    if (const Channel* channel = film.find(layer + names[k]))
      for (std::size_t i = 0; i < channel->values.size(); ++i) to[3 * i + k] = channel->values[i];
  return to + std::size_t{3} * film.width * film.height;
}

const std::vector<float>& values_of(const Film& film, const std::string& name) {
  const Channel* channel = film.find(name);
  if (!channel) throw Error::failed("denoising: the film has no layer " + name);
  return channel->values;
}

// The layout of kernels/denoise_records.h. Guides that the film does not have are black.
std::shared_ptr<const Bytes> stage_input(const Film& film) {
  static constexpr const char* kAxis[] = {"X", "Y", "Z"};
  const std::size_t pixels = std::size_t{film.width} * film.height;
  auto bytes = std::make_shared<Bytes>(pixels * kernels::kDenoiseWords * sizeof(float));
  auto* const first = reinterpret_cast<float*>(bytes->data());
  float* const second = interleave(film, "half.", kColor, first);
  const std::vector<float>& share = values_of(film, "half.A");
  for (std::size_t k = 0; k < 3; ++k) {
    const std::vector<float>& all = values_of(film, kColor[k]);
    for (std::size_t i = 0; i < pixels; ++i) {
      const float of_first = first[3 * i + k], rest = 1 - share[i];
      second[3 * i + k] = rest > 0 ? (all[i] - share[i] * of_first) / rest : of_first;
    }
  }
  float* to = interleave(film, "albedo.", kColor, second + 3 * pixels);
  to = interleave(film, "normal.", kAxis, to);
  std::copy(share.begin(), share.end(), to);
  return bytes;
}

}  // namespace

DenoisePlan::DenoisePlan(const FrameSettings& settings, const SceneSummary& scene, std::unique_ptr<Plan> method)
    : settings_(settings), method_(std::move(method)), graph_(scene.blob) {}

Step DenoisePlan::next(const FinishedStage* finished) {
  if (!film_) {
    Step step = method_->next(finished);
    if (!step.done) return step;
    film_ = method_->take_film();
    Step last = ask();
    last.released = std::move(step.released);
    return last;
  }
  graph_.finish(*finished);
  facts_ = stage_.facts<DenoiseFacts>();
  absorb(stage_.records());
  stage_ = {};
  Step step = graph_.take_step();
  step.done = true;
  return step;
}

Step DenoisePlan::ask() {
  DenoiseParameters p{};
  p.width = settings_.width;
  p.height = settings_.height;
  p.quality = settings_.denoise == Denoise::fast ? kernels::kDenoiseFast : kernels::kDenoiseHigh;
  StageSpec spec;
  spec.name = spec.kind = "denoise";
  spec.items = std::uint64_t{p.width} * p.height;
  spec.solo = true;
  spec.work = kWorkAPixel * static_cast<double>(spec.items);
  spec.output = {.record_bytes = sizeof(DenoiseRecord)};
  stage_ = graph_.add(std::move(spec), p, {{"film", graph_.data(stage_input(*film_))}});
  return graph_.take_step();
}

void DenoisePlan::absorb(const Bytes& records) {
  const std::size_t pixels = std::size_t{film_->width} * film_->height;
  std::vector<float>& error = film_->channel("error.Y").values;
  for (std::size_t k = 0; k < 3; ++k)
    film_->channel(std::string("noisy.") + kColor[k]).values = values_of(*film_, kColor[k]);
  for (std::size_t i = 0; i < pixels; ++i) {
    DenoiseRecord record;
    std::memcpy(&record, &records[i * sizeof record], sizeof record);
    if (!std::isfinite(record.color[0] + record.color[1] + record.color[2]) || !(record.squared_error >= 0))
      throw Error::failed("stage denoise, item " + std::to_string(i) + ": a colour or an error that is no number");
    error[i] = record.squared_error;
    for (std::size_t k = 0; k < 3; ++k) film_->channel(kColor[k]).values[i] = record.color[k];
  }
}

void DenoisePlan::take(const std::string& stage, std::uint64_t first, std::uint64_t count, const Bytes& records) {
  method_->take(stage, first, count, records);
}

double DenoisePlan::predicted_work() const {
  if (film_) return 0;
  return method_->predicted_work() + kWorkAPixel * settings_.width * settings_.height;
}

void DenoisePlan::preview(const std::string& stage, std::uint64_t first, std::uint64_t count, const Bytes& records) {
  if (!film_) method_->preview(stage, first, count, records);
}

Film DenoisePlan::preview_film() const {
  if (!film_) return method_->preview_film();
  Film film{film_->width, film_->height, {}};
  for (const char* name : kColor) film.channels.push_back({name, values_of(*film_, name)});
  return film;
}

bool DenoisePlan::conclude(const std::vector<CutStage>& cut) {
  if (!film_ && !method_->conclude(cut)) return false;
  return cut_ = true;
}

Film DenoisePlan::film() const { return film_ ? *film_ : method_->film(); }

Film DenoisePlan::take_film() { return film_ ? std::move(*film_) : method_->take_film(); }

std::vector<Skip> DenoisePlan::skips() const {
  std::vector<Skip> skips = method_->skips();
  if (cut_) skips.push_back({"denoising", "the time limit ended the frame", 1});
  return skips;
}

std::string DenoisePlan::parameters_json() const {
  nlohmann::json json = nlohmann::json::parse(method_->parameters_json());
  nlohmann::json denoise = {{"quality", word_of(settings_.denoise)}};
  if (facts_) {
    denoise["library"] = std::string("Open Image Denoise ") + facts_->version;
    denoise["device"] = facts_->device;
    denoise["share"] = facts_->denoised;
    if (facts_->mean > 0) denoise["expected_error"] = std::sqrt(facts_->squared_error) / facts_->mean;
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

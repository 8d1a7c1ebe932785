#include "coordinator/plan/path_plan.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>
#include <nlohmann/json.hpp>

#include "coordinator/blobs/sha256.h"
#include "kernels/path_records.h"
#include "scene/model/error.h"

namespace gleaner::coordinator {
namespace {

using kernels::PathFeatureRecord;
using kernels::PathItem;
using kernels::PathParameters;
using kernels::PathRecord;

// Where only an error is wished for, samples may grow to this a pixel before the frame gives up.
constexpr std::uint64_t kMostSamplesForTarget = 1u << 16;
// A stage's records and list stay below a gigabyte, however many samples are wished for.
constexpr std::uint64_t kMostItems = std::uint64_t{1} << 25;
// Neighbours asked about a pixel's noise: half of (2 r + 1)^2, two chunks each. Fewer would make the counts themselves
// noisy.
constexpr int kNoiseRadius = 3;

// The budget in quarters: two chunks for every pixel first (the least that shows a variance), then as the noise asks.
std::uint32_t chunk_samples(std::uint32_t spp) {
  return std::clamp<std::uint32_t>(std::bit_floor(std::max(1u, spp / 4)), 1, GLEANER_PATH_MAX_ITEM_SAMPLES);
}

}  // namespace

PathPlan::PathPlan(const FrameSettings& settings, const SceneSummary& scene, Covered covered)
    : settings_(settings),
      scene_(scene),
      covered_(covered),
      chunk_samples_(chunk_samples(settings.spp)),
      first_chunks_(std::min<std::uint32_t>(2, settings.spp / chunk_samples_)),
      film_(settings.width, settings.height),
      used_chunks_(std::size_t{settings.width} * settings.height, 0),
      preview_(std::size_t{settings.width} * settings.height) {
  if (settings.target_error > 0) {
    chunk_samples_ = 16;
    first_chunks_ = 2;
  }
  const scene::SceneNeeds& n = scene.needs;
  const auto skip = [&](bool needed, const char* what, const char* why) {
    if (!needed) skips_.push_back({what, why, 1});
  };
  skip(n.specular || n.glossy || n.metallic, "specular lobe", "no material has one");
  skip(n.transmissive, "transmission", "no material lets light through");
  skip(n.attenuation, "absorption in solids", "no solid absorbs");
  skip(n.alpha, "alpha tests", "every surface is opaque");
  skip(n.unlit, "unlit surfaces", "no material is unlit");
  skip(n.textures, "texture lookups", "no material has a texture");
  skip(n.normal_maps, "normal maps", "no material has one");
  skip(n.smooth_normals, "interpolated normals", "every triangle is flat");
  skip(n.emissive_triangles, "light samples on triangles", "no triangle emits");
  skip(n.punctual_lights, "punctual lights", "the scene has none");
  skip(n.environment, "environment light", "the scene has none");
}

// The stage that gives every pixel its features is the largest: two chunks' records a pixel beside the film.
std::uint64_t PathPlan::memory(const FrameSettings& settings) {
  const std::uint64_t a_pixel =
      PathFilm::bytes_a_pixel + 2 * sizeof(PathFeatureRecord) + sizeof(std::uint32_t) + sizeof(PreviewPixel);
  return std::uint64_t{settings.width} * settings.height * a_pixel;
}

std::uint64_t PathPlan::budget() const {
  if (settings_.target_error <= 0) return pixels() * settings_.spp;
  return pixels() * kMostSamplesForTarget;
}

std::size_t PathPlan::record_bytes(const Planned& planned) const {
  return (planned.features ? sizeof(PathFeatureRecord) : sizeof(PathRecord)) + (covered_.covered ? 12 : 0);
}

Step PathPlan::stage(Planned planned) {
  PathParameters p{};
  p.camera = settings_.camera;
  p.width = settings_.width;
  p.height = settings_.height;
  p.samples_per_item = chunk_samples_;
  p.last_item_samples = planned.last_item_samples;
  p.depth = settings_.depth;
  p.seed_low = static_cast<std::uint32_t>(settings_.seed);
  p.seed_high = static_cast<std::uint32_t>(settings_.seed >> 32);
  p.features = planned.features ? 1 : 0;
  p.items_low = static_cast<std::uint32_t>(planned.items);
  p.items_high = static_cast<std::uint32_t>(planned.items >> 32);
  p.covered = covered_.covered ? 1 : 0;
  p.clamp = covered_.clamp;
  StageSpec spec;
  spec.name = planned.name;
  spec.kind = "path";
  spec.items = planned.items;
  // 16 paths are one packet: what shares a packet must not depend on where batches are cut.
  spec.tile = std::max(1u, 16 / chunk_samples_);
  spec.parameters.resize(sizeof p);
  std::memcpy(spec.parameters.data(), &p, sizeof p);
  spec.output.record_bytes = static_cast<std::uint32_t>(record_bytes(planned));
  Step step;
  if (planned.list) {
    const ArtifactId id = sha256_hex(*planned.list);
    spec.inputs.push_back({"items", id});
    step.artifacts[id] = planned.list;
  }
  step.stages.push_back(std::move(spec));
  spent_ += (planned.items - 1) * chunk_samples_ + planned.last_item_samples;
  planned_.push_back(std::move(planned));
  return step;
}

// A stage of so many samples, given out by the noise seen so far.
Step PathPlan::spend(std::uint64_t samples) {
  samples = std::min(samples, kMostItems * chunk_samples_);
  const std::uint64_t whole = samples / chunk_samples_;
  const std::uint32_t rest = static_cast<std::uint32_t>(samples % chunk_samples_);
  const std::uint64_t items = whole + (rest ? 1 : 0);
  PixelNoise noise = film_.noise();
  noise.chunk_samples = static_cast<float>(chunk_samples_);
  const std::vector<std::uint32_t> more = allocate_by_noise(noise, used_chunks_, items, kNoiseRadius);
  auto list = std::make_shared<Bytes>(items * sizeof(PathItem));
  auto* item = reinterpret_cast<PathItem*>(list->data());
  for (std::uint32_t pixel = 0; pixel < more.size(); ++pixel)
    for (std::uint32_t k = 0; k < more[pixel]; ++k) *item++ = {pixel, used_chunks_[pixel]++};
  Planned planned;
  planned.name = "path." + std::to_string(planned_.size());
  planned.items = items;
  planned.last_item_samples = rest ? rest : chunk_samples_;
  planned.list = std::move(list);
  return stage(std::move(planned));
}

Step PathPlan::next(const FinishedStage* finished) {
  if (!finished) {
    Planned planned;
    planned.name = "path.0";
    planned.items = pixels() * first_chunks_;
    planned.features = true;
    planned.last_item_samples = chunk_samples_;
    std::ranges::fill(used_chunks_, first_chunks_);
    return stage(std::move(planned));
  }
  const Planned& planned = planned_.back();
  absorb(planned, *finished, {0, planned.items});
  // Lists are large, and needed no more.
  planned_.back().list.reset();

  Step done;
  done.done = true;
  const std::uint64_t all = budget();
  if (spent_ >= all) return done;
  if (settings_.target_error > 0) {
    const double error = std::sqrt(film_.squared_error_bound());
    // A black picture has no mean to be relative to.
    const double mean = film_.mean_radiance() + covered_.mean, whole = mean > 0 ? mean : 1;
    // Whatever the lights are off by, samples are not asked for more than four times what they would be alone.
    const double wished = std::pow(settings_.target_error * whole, 2);
    const double share = std::sqrt(std::max(wished - covered_.squared_error, 0.25 * wished) / wished);
    const double relative = error / (whole * share);
    if (relative <= settings_.target_error) return done;
    // Error falls as one over the root of the samples; the estimate is noisy, so no stage more than trebles them.
    const double factor = std::clamp(std::pow(relative / settings_.target_error, 2) * 1.05, 1.1, 4.0);
    const auto wanted = static_cast<std::uint64_t>(static_cast<double>(spent_) * (factor - 1));
    return spend(std::min(std::max<std::uint64_t>(wanted, chunk_samples_), all - spent_));
  }
  const std::uint64_t left = all - spent_;
  // A first look at two chunks is a noisy guide for a long way: half now, and the rest once more is known. Not for a
  // few chunks: each stage ends with workers waiting for the last.
  const bool halves = planned_.size() == 1 && left >= pixels() * chunk_samples_ * 2;
  return spend(halves ? left / 2 : left);
}

std::uint64_t PathPlan::samples_of(const Planned& planned, const ItemRange& range) const {
  const bool last = range.count > 0 && range.first + range.count == planned.items;
  return range.count * chunk_samples_ - (last ? chunk_samples_ - planned.last_item_samples : 0);
}

// Adds the records of a range of a stage's items to the film.
void PathPlan::absorb(const Planned& planned, const FinishedStage& finished, const ItemRange& range) {
  if (finished.name != planned.name || !finished.records)
    throw Error::failed("plan path: " + finished.name + " was not asked for");
  const std::size_t stride = record_bytes(planned);
  if (finished.records->size() != planned.items * stride || range.first + range.count > planned.items)
    throw Error::failed("plan path: " + finished.name + " has " + std::to_string(finished.records->size()) +
                        " bytes, expected " + std::to_string(planned.items * stride));
  for (std::uint64_t i = range.first; i < range.first + range.count; ++i) {
    const std::uint32_t samples = i + 1 == planned.items ? planned.last_item_samples : chunk_samples_;
    const PathItem item = item_of(planned, i);
    PathFeatureRecord record{};
    const std::byte* at = finished.records->data() + i * stride;
    std::memcpy(&record, at, planned.features ? sizeof(PathFeatureRecord) : sizeof(PathRecord));
    film_.add(item.pixel, item.chunk, record.direct, record.indirect, samples, samples == chunk_samples_);
    if (planned.features) film_.add_features(item.pixel, record, samples);
    if (covered_.covered) {
      float clamped[3];
      std::memcpy(clamped, at + stride - sizeof clamped, sizeof clamped);
      film_.add_clamped(item.pixel, clamped);
    }
  }
}

bool PathPlan::conclude(const std::vector<CutStage>& cut) {
  // The first stage gives every pixel its first samples: before it is whole there are holes.
  if (planned_.size() < 2) return false;
  const Planned& planned = planned_.back();
  const std::uint64_t asked = samples_of(planned, {0, planned.items});
  std::uint64_t taken = 0;
  for (const CutStage& part : cut) {
    if (part.stage.name != planned.name) continue;
    for (const ItemRange& range : part.whole) {
      absorb(planned, part.stage, range);
      taken += samples_of(planned, range);
    }
  }
  const std::uint64_t left_out = budget() - (spent_ - asked + taken);
  spent_ = spent_ - asked + taken;
  planned_.back().list.reset();
  skips_.push_back({"samples", "the time limit ended the frame", left_out});
  return true;
}

PathItem PathPlan::item_of(const Planned& planned, std::uint64_t item) const {
  if (!planned.list) return {static_cast<std::uint32_t>(item % pixels()), static_cast<std::uint32_t>(item / pixels())};
  PathItem entry;
  std::memcpy(&entry, planned.list->data() + item * sizeof entry, sizeof entry);
  return entry;
}

void PathPlan::preview(const std::string& name, std::uint64_t first, std::uint64_t count, const Bytes& records) {
  const auto planned = std::ranges::find(planned_, name, &Planned::name);
  if (planned == planned_.end()) return;
  const std::size_t stride = record_bytes(*planned);
  if (records.size() < count * stride || first + count > planned->items) return;
  if (name != "path.0" && !planned->list) return;  // a late batch of a stage that is already in the film
  for (std::uint64_t i = 0; i < count; ++i) {
    PathRecord record;
    std::memcpy(&record, records.data() + i * stride, sizeof record);
    PreviewPixel& pixel = preview_[item_of(*planned, first + i).pixel];
    for (int k = 0; k < 3; ++k) pixel.sum[k] += record.direct[k] + record.indirect[k];
    pixel.samples += static_cast<float>(first + i + 1 == planned->items ? planned->last_item_samples : chunk_samples_);
  }
}

Film PathPlan::preview_film() const {
  static const char* const kColor[] = {"R", "G", "B"};
  Film film{settings_.width, settings_.height, {}};
  for (int k = 0; k < 3; ++k) {
    std::vector<float>& values = film.channel(kColor[k]).values;
    for (std::size_t i = 0; i < preview_.size(); ++i)
      values[i] = preview_[i].samples > 0 ? preview_[i].sum[k] / preview_[i].samples : 0.0f;
  }
  return film;
}

std::string PathPlan::parameters_json() const {
  nlohmann::json json = {{"spp", settings_.spp},          {"depth", settings_.depth},
                         {"seed", settings_.seed},        {"samples_per_chunk", chunk_samples_},
                         {"first_chunks", first_chunks_}, {"samples", spent_}};
  if (settings_.target_error > 0) json["target_error"] = settings_.target_error;
  return json.dump();
}

std::vector<std::string> PathPlan::outline() const {
  std::vector<std::string> lines;
  const std::uint64_t first = pixels() * first_chunks_;
  lines.push_back("path.0: " + std::to_string(first) +
                  " items, split: " + std::to_string(first_chunks_ * chunk_samples_) +
                  " samples in every pixel, with albedo, normal and depth");
  if (settings_.target_error > 0)
    lines.push_back("path.1 and on: split: samples where the noise is, until its estimate is below " +
                    std::to_string(settings_.target_error) + " of the mean radiance");
  else if (const std::uint64_t rest = budget() - std::min(budget(), first * chunk_samples_))
    lines.push_back("path.1 and on: split: " + std::to_string(rest) + " samples where the noise is");
  return lines;
}

}  // namespace gleaner::coordinator

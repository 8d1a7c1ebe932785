#include "coordinator/plan/path_sampler.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstring>
#include <nlohmann/json.hpp>
#include <numeric>

#include "coordinator/plan/allocation.h"
#include "coordinator/plan/denoise_plan.h"
#include "coordinator/plan/denoised_film.h"
#include "coordinator/plan/seen_emission.h"
#include "scene/model/error.h"

namespace gleaner::coordinator {
namespace {

using kernels::PathFeatureRecord;
using kernels::PathItem;
using kernels::PathParameters;
using kernels::PathRecord;

// Where only a target error is given, samples may grow to this a pixel before the frame gives up.
constexpr std::uint64_t kMostSamplesForTarget = 1u << 16;
// A stage's records and list stay below a gigabyte, however many samples are wanted.
constexpr std::uint64_t kMostItems = std::uint64_t{1} << 25;
// Neighbours asked about a pixel's noise: half of (2 r + 1)^2, two chunks each. Fewer would make the counts themselves
// noisy.
constexpr int kNoiseRadius = 3;

// Emission seen directly, at edges: in each half of the samples, kSeenRays to kMostSeenRays rays a pixel,
// kSeenFactor times its samples. Of the picture's pixels, one in kSeenPixels at most, by each half; and, in all, no
// more rays than half of the samples, or than kSeenBudget a pixel of the picture.
constexpr std::uint32_t kSeenRays = 512, kMostSeenRays = 2048, kSeenFactor = 4, kSeenPixels = 16, kSeenBudget = 8;
// Differences below this share of the picture's mean are left as they were sampled.
constexpr double kSeenLeast = 0.05;
// What such a ray costs, in samples of a path tracer.
constexpr double kSeenWork = 0.2;

// The budget in quarters: two chunks for every pixel first (the least that shows a variance), then as the noise asks.
std::uint32_t chunk_samples(std::uint32_t spp) {
  return std::clamp<std::uint32_t>(std::bit_floor(std::max(1u, spp / 4)), 1, GLEANER_PATH_MAX_ITEM_SAMPLES);
}

// Chunk after chunk of one pixel, then of the next.
void list_by_pixel(const Allocation& given, PathItem* item) {
  for (std::uint32_t pixel = 0; pixel < given.more.size(); ++pixel)
    for (std::uint32_t k = 0; k < given.more[pixel]; ++k) *item++ = {pixel, given.chunks[pixel] + k};
}

// A chunk for each pixel that gets one, then a further one and so on: however much of the list a time limit leaves, it
// is spread over the picture.
void list_in_rounds(const Allocation& given, PathItem* item) {
  std::vector<std::uint32_t> pixels(given.more.size());
  std::iota(pixels.begin(), pixels.end(), 0u);
  for (std::uint32_t round = 0; !pixels.empty(); ++round) {
    std::erase_if(pixels, [&](std::uint32_t pixel) { return given.more[pixel] <= round; });
    for (const std::uint32_t pixel : pixels) *item++ = {pixel, given.chunks[pixel] + round};
  }
}

// One item's record, of which some words may be missing: those stay 0.
struct Sums {
  PathFeatureRecord record{};
  float seen[3] = {};  // of record.direct
  float clamped[3] = {};
};

Sums read_sums(const std::byte* at, bool features, bool apart, bool compensates) {
  Sums sums;
  const auto read = [&](void* to, std::size_t bytes) {
    std::memcpy(to, at, bytes);
    at += bytes;
  };
  read(&sums.record, features ? sizeof(PathFeatureRecord) : sizeof(PathRecord));
  if (apart) read(sums.seen, sizeof sums.seen);
  if (compensates) read(sums.clamped, sizeof sums.clamped);
  return sums;
}

// Throws Error::failed where a sum of the items from `first` on is not finite. `stride`: bytes of an item's record.
void check_finite(const Bytes& records, std::size_t stride, const Graph::Artifact& stage, std::uint64_t first) {
  constexpr std::uint32_t exponent = 0x7f800000;  // all bits of it are set in what is not finite
  const auto odd = [&](std::size_t at) {
    std::uint32_t word;
    std::memcpy(&word, records.data() + at, sizeof word);
    return (word & exponent) == exponent;
  };
  // Without a branch for each word: this is done for all pixels and chunks.
  bool any = false;
  for (std::size_t at = 0; at < records.size(); at += 4) any |= odd(at);
  if (!any) return;
  std::size_t at = 0;
  while (!odd(at)) at += 4;
  throw Error::failed("stage " + stage.stage() + ", item " + std::to_string(first + at / stride) +
                      ": a sum that is not finite");
}

}  // namespace

PathSampler::PathSampler(Graph& graph, Accumulator& film, const FrameSettings& settings, Program program)
    : graph_(graph),
      film_(film),
      settings_(settings),
      program_(std::move(program)),
      chunk_samples_(chunk_samples(settings.planned_spp())),
      first_chunks_(std::min<std::uint32_t>(2, settings.planned_spp() / chunk_samples_)) {
  if (settings.target_error > 0) {
    chunk_samples_ = settings.fitting_spp ? std::min(16u, chunk_samples_) : 16;
    first_chunks_ = 2;
  }
}

std::uint64_t PathSampler::budget() const {
  return pixels() * (settings_.target_error > 0 ? kMostSamplesForTarget : settings_.spp);
}

std::uint64_t PathSampler::planned() const { return std::min(budget(), pixels() * settings_.planned_spp()); }

std::uint32_t PathSampler::samples_of(const Asked& asked, std::uint64_t item) const {
  return item + 1 == asked.items ? asked.last_item_samples : samples_per_item(asked);
}

std::uint32_t PathSampler::samples_per_item(const Asked& asked) const {
  return asked.seen == PATH_SEEN_ALONE ? GLEANER_PATH_MAX_ITEM_SAMPLES : chunk_samples_;
}

std::uint64_t PathSampler::samples_of(const Asked& asked, const ItemRange& range) const {
  const bool last = range.count > 0 && range.first + range.count == asked.items;
  return range.count * chunk_samples_ - (last ? chunk_samples_ - asked.last_item_samples : 0);
}

std::size_t PathSampler::record_bytes(const Asked& asked) const {
  return (asked.features ? sizeof(PathFeatureRecord) : sizeof(PathRecord)) + (asked.seen == PATH_SEEN_APART ? 12 : 0) +
         (complement_.classes ? 12 : 0);
}

PathItem PathSampler::item_of(const Asked& asked, std::uint64_t item) const {
  if (!asked.list) return {static_cast<std::uint32_t>(item % pixels()), static_cast<std::uint32_t>(item / pixels())};
  PathItem entry;
  std::memcpy(&entry, asked.list->data() + item * sizeof entry, sizeof entry);
  return entry;
}

void PathSampler::begin(const Complement& complement) {
  complement_ = complement;
  ask({.artifact = {},
       .items = pixels() * first_chunks_,
       .features = !settings_.only_picture,
       .last_item_samples = chunk_samples_});
}

void PathSampler::begin(const Complement& complement, Program program) {
  program_ = std::move(program);
  begin(complement);
}

PathParameters PathSampler::parameters_of(const Asked& asked) const {
  PathParameters p{};
  p.camera = settings_.camera;
  p.width = settings_.width;
  p.height = settings_.height;
  p.samples_per_item = samples_per_item(asked);
  p.last_item_samples = asked.last_item_samples;
  p.depth = settings_.depth;
  p.seed_low = low(settings_.seed);
  p.seed_high = high(settings_.seed);
  p.features = asked.features ? 1 : 0;
  p.items_low = static_cast<std::uint32_t>(asked.items);
  p.items_high = static_cast<std::uint32_t>(asked.items >> 32);
  p.filter = complement_.classes;
  p.clamp = complement_.limit;
  p.seen = asked.seen;
  return p;
}

Graph::Artifact PathSampler::add_stage(const Asked& asked, const std::string& name, double work) {
  StageSpec spec;
  spec.name = name;
  spec.kind = program_.kind;
  spec.items = asked.items;
  // 16 paths are one packet: what shares a packet must not depend on where batches are cut.
  spec.tile = std::max(1u, 16 / samples_per_item(asked));
  spec.work = work;
  // The records of a whole stage of a large film are larger than all that the film holds.
  spec.output = {
      .record_bytes = static_cast<std::uint32_t>(record_bytes(asked)), .placement = Placement::stream, .floats = true};
  std::vector<Graph::Input> inputs = program_.inputs;
  if (asked.list) inputs.push_back({"items", graph_.data(asked.list), Extent::own_items});
  spec.parameters = bytes_of(parameters_of(asked));
  spec.parameters.insert(spec.parameters.end(), program_.method_parameters.begin(), program_.method_parameters.end());
  return graph_.add(std::move(spec), std::move(inputs));
}

void PathSampler::ask(Asked asked) {
  if (tells_emission()) asked.seen = PATH_SEEN_APART;
  const std::uint64_t samples = samples_of(asked, {0, asked.items});
  asked.artifact = add_stage(asked, program_.kind + "." + std::to_string(stages_.size()), static_cast<double>(samples));
  graph_.on_records(asked.artifact,
                    [this](auto first, auto count, const Bytes& records) { absorb(first, count, records); });
  graph_.when({asked.artifact}, [this] { continue_or_end(); });
  spent_ += samples;
  stages_.push_back(std::move(asked));
}

// What one half of the samples has seen decides for the other half: had a pixel's own samples a say in whether they
// stay, those that by chance saw nothing of a small light would.
void PathSampler::ask_seen() {
  const double least = kSeenLeast * (film_.mean_radiance() + complement_.mean);
  std::array<std::vector<std::uint32_t>, 2> edges;  // by half
  for (std::size_t half = 0; half < 2; ++half)
    edges[half] =
        emission_edges(film_.seen(1 - half), settings_.width, settings_.height, least, pixels() / kSeenPixels);
  const std::uint64_t found = edges[0].size() + edges[1].size();
  if (found == 0) return;
  const std::uint32_t spp = settings_.planned_spp();
  const std::uint64_t wanted = std::clamp(kSeenFactor * (spp / 2), kSeenRays, kMostSeenRays),
                      most = pixels() * std::max(spp / 2, kSeenBudget) / found;
  const auto chunks = static_cast<std::uint32_t>(
      std::bit_floor(std::max<std::uint64_t>(1, std::min(wanted, most) / GLEANER_PATH_MAX_ITEM_SAMPLES)));
  std::vector<PathItem> list;
  for (std::uint32_t half = 0; half < 2; ++half)
    for (const std::uint32_t pixel : edges[half])
      for (std::uint32_t k = 0; k < chunks; ++k) list.push_back({pixel, 2 * k + half});
  seen_ = Asked{.artifact = {},
                .items = list.size(),
                .last_item_samples = GLEANER_PATH_MAX_ITEM_SAMPLES,
                .list = bytes_of(list),
                .seen = PATH_SEEN_ALONE};
  seen_work_ = kSeenWork * static_cast<double>(list.size()) * GLEANER_PATH_MAX_ITEM_SAMPLES;
  seen_->artifact = add_stage(*seen_, program_.kind + ".seen", seen_work_);
  graph_.on_records(seen_->artifact,
                    [this](auto first, auto count, const Bytes& records) { absorb_seen(first, count, records); });
}

void PathSampler::absorb_seen(std::uint64_t first, std::uint64_t count, const Bytes& records) {
  const std::size_t stride = record_bytes(*seen_);
  check_finite(records, stride, seen_->artifact, first);
  for (std::uint64_t k = 0; k < count; ++k) {
    const Sums sums = read_sums(records.data() + k * stride, false, false, false);
    const PathItem item = item_of(*seen_, first + k);
    film_.add_seen_alone(item.pixel, item.chunk, sums.record.direct, samples_of(*seen_, first + k));
  }
}

PixelNoise PathSampler::noise_so_far() const {
  PixelNoise noise = film_.noise();
  noise.chunk_samples = static_cast<float>(chunk_samples_);
  return noise;
}

double PathSampler::sample_error() const { return gleaner::coordinator::sample_error(noise_so_far(), kNoiseRadius); }

// A stage of so many samples, given out by the noise seen so far.
void PathSampler::spend(std::uint64_t samples) {
  samples = std::min(samples, kMostItems * chunk_samples_);
  const std::uint64_t whole = samples / chunk_samples_;
  const auto rest = static_cast<std::uint32_t>(samples % chunk_samples_);
  const std::uint64_t items = whole + (rest ? 1 : 0);
  PixelNoise noise = noise_so_far();
  if (!denoised_error_.empty()) {
    // What is left of a pixel's error once it is denoised, as if it fell with one over the chunks.
    for (std::size_t i = 0; i < noise.chunks.size(); ++i)
      noise.chunk_variance[i] = denoised_error_[i] * static_cast<float>(noise.chunks[i]);
    noise.mean = std::vector<float>();
    denoised_error_ = std::vector<float>();
  }
  const Allocation given = allocate_by_noise(std::move(noise), items, kNoiseRadius);
  auto list = std::make_shared<Bytes>(items * sizeof(PathItem));
  (settings_.limited ? list_in_rounds : list_by_pixel)(given, reinterpret_cast<PathItem*>(list->data()));
  ask({.artifact = {},
       .items = items,
       .features = false,
       .last_item_samples = rest ? rest : chunk_samples_,
       .list = std::move(list)});
}

// Adds the records of `count` items, from `first` on, to the film.
void PathSampler::absorb(std::uint64_t first, std::uint64_t count, const Bytes& records) {
  const Asked& asked = stages_.back();
  const std::size_t stride = record_bytes(asked);
  check_finite(records, stride, asked.artifact, first);
  for (std::uint64_t k = 0; k < count; ++k) {
    Sums sums =
        read_sums(records.data() + k * stride, asked.features, asked.seen == PATH_SEEN_APART, complement_.compensates);
    const std::uint32_t samples = samples_of(asked, first + k);
    const PathItem item = item_of(asked, first + k);
    PathFeatureRecord& r = sums.record;
    if (asked.seen == PATH_SEEN_APART) {
      for (int c = 0; c < 3; ++c) r.direct[c] -= sums.seen[c];
      film_.add_seen(item.pixel, item.chunk, sums.seen);
    }
    film_.add(item.pixel, item.chunk, r.direct, r.indirect, samples, samples == chunk_samples_);
    if (asked.features)
      film_.add_features(
          item.pixel,
          {{r.albedo[0], r.albedo[1], r.albedo[2]}, {r.normal[0], r.normal[1], r.normal[2]}, r.depth, r.hits}, samples);
    if (complement_.compensates) film_.add_clamped(item.pixel, sums.clamped);
  }
}

// Samples that the target error still asks for; 0: it is met.
std::uint64_t PathSampler::wanted_for_target() {
  const double error = std::sqrt(denoised_bound_ ? *denoised_bound_ : film_.squared_error_bound());
  // A black picture has no mean to be relative to.
  const double mean = film_.mean_radiance() + complement_.mean, whole = mean > 0 ? mean : 1;
  // Whatever the VPLs are off by, samples are not asked for more than four times what they would be alone.
  const double target = std::pow(settings_.target_error * whole, 2);
  const double share = std::sqrt(std::max(target - complement_.squared_error, 0.25 * target) / target);
  const double relative = error / (whole * share);
  if (!(relative > settings_.target_error)) return 0;
  // Error falls as one over the root of the samples; the estimate is noisy, so no stage more than trebles them.
  const double all = std::pow(relative / settings_.target_error, 2) * 1.05, factor = std::clamp(all, 1.1, 4.0);
  target_samples_ = static_cast<std::uint64_t>(
      std::min(static_cast<double>(spent_) * std::max(all, factor), static_cast<double>(budget())));
  return std::max<std::uint64_t>(static_cast<std::uint64_t>(static_cast<double>(spent_) * (factor - 1)),
                                 chunk_samples_);
}

void PathSampler::ask_judgement() {
  // The fast model errs a little more than the one that the picture may get.
  judgement_ = ask_denoising(graph_, numbered("denoise", stages_.size() - 1), film_.film_of_samples(), Denoise::fast);
  graph_.when({judgement_}, [this] { take_judgement(); });
}

void PathSampler::take_judgement() {
  const kernels::DenoiseFacts facts = denoise_facts(judgement_);
  denoised_bound_ = facts.squared_error + 2 * facts.deviation;
  const std::span<const kernels::DenoiseRecord> records = denoise_records(judgement_);
  check_denoised(records, "stage " + judgement_.stage());
  denoised_error_.resize(records.size());
  std::ranges::transform(records, denoised_error_.begin(), &kernels::DenoiseRecord::squared_error);
  judgement_ = {};
  reach_for_target();
}

void PathSampler::reach_for_target() {
  const std::uint64_t left = budget() - spent_, wanted = wanted_for_target();
  done_ = wanted == 0 || left == 0;
  if (wanted > 0 && left == 0)
    warnings_.push_back("the target error was not reached with " + std::to_string(kMostSamplesForTarget) +
                        " samples a pixel, the most that are taken for one");
  if (done_) return program_.inputs.clear();
  graph_.when_released([this, samples = std::min(wanted, left)] { spend(samples); });
}

void PathSampler::continue_or_end() {
  // Lists are large: the next one is made when this one's memory is free.
  stages_.back().list.reset();
  if (stages_.size() == 1 && tells_emission()) ask_seen();
  if (settings_.target_error > 0) {
    const auto look = [this] { settings_.denoise == Denoise::off ? reach_for_target() : ask_judgement(); };
    std::vector<Graph::Artifact> known;
    if (complement_.known) known.push_back(complement_.known);
    if (seen_) known.push_back(seen_->artifact);
    return known.empty() ? look() : graph_.when(std::move(known), look);
  }
  done_ = spent_ == budget();
  if (done_) return program_.inputs.clear();
  graph_.when_released([this] { spend(next_samples()); });
}

std::uint64_t PathSampler::next_samples() const {
  // The time limit is further away than was predicted: on in small steps.
  if (spent_ >= planned()) return std::min(budget() - spent_, std::max(planned() / 4, pixels() * chunk_samples_));
  const std::uint64_t left = planned() - spent_;
  // A first look at two chunks is a noisy guide for a long way: half now, and the rest once more is known. Not for a
  // few chunks: each stage ends with workers waiting for the last.
  const bool halves = stages_.size() == 1 && left >= pixels() * chunk_samples_ * 2;
  return halves ? left / 2 : left;
}

bool PathSampler::conclude(const std::vector<CutStage>& cut, std::vector<Skip>& skips) {
  if (done_) return true;
  // The first stage gives every pixel its first samples: before it is whole there are holes.
  if (stages_.size() < 2) return false;
  const Asked& asked = stages_.back();
  // A stage of samples runs, or what it brought is being judged.
  if (const CutStage* part = find_cut(cut, asked.artifact)) {
    std::uint64_t taken = 0;
    for (const ItemRange& range : part->whole) taken += samples_of(asked, range);
    spent_ -= samples_of(asked, {0, asked.items}) - taken;
  }
  stages_.back().list.reset();
  program_.inputs.clear();
  skips.push_back({"samples", "the time limit ended the frame", budget() - spent_});
  return done_ = true;
}

double PathSampler::predicted_work() const {
  if (done_) return 0;
  const std::uint64_t all = settings_.target_error > 0 ? target_samples_ : planned();
  return static_cast<double>(all - std::min(all, spent_));
}

nlohmann::json PathSampler::parameters() const {
  nlohmann::json json = {{"spp", settings_.spp},          {"depth", settings_.depth},
                         {"seed", settings_.seed},        {"samples_per_chunk", chunk_samples_},
                         {"first_chunks", first_chunks_}, {"samples", spent_}};
  if (settings_.fitting_spp) json["planned_spp"] = settings_.fitting_spp;
  if (settings_.target_error > 0) json["target_error"] = settings_.target_error;
  return json;
}

std::vector<std::string> PathSampler::outline() const {
  std::vector<std::string> lines;
  const std::uint64_t first = pixels() * first_chunks_;
  lines.push_back(program_.kind + ".0: " + std::to_string(first) +
                  " items, split: " + std::to_string(first_chunks_ * chunk_samples_) +
                  " samples in every pixel, with albedo, normal and depth");
  if (settings_.target_error > 0)
    lines.push_back(program_.kind + ".1 and on: split: samples where the noise is, until its estimate is below " +
                    std::to_string(settings_.target_error) + " of the mean radiance");
  else if (const std::uint64_t rest = budget() - std::min(budget(), first * chunk_samples_))
    lines.push_back(program_.kind + ".1 and on: split: " + std::to_string(rest) + " samples where the noise is");
  return lines;
}

std::vector<Skip> path_skips(const scene::SceneNeeds& n) {
  std::vector<Skip> skips;
  const auto skip = [&](bool needed, const char* what, const char* why) {
    if (!needed) skips.push_back({what, why, 1});
  };
  skip(n.specular || n.glossy || n.metallic || n.clearcoat || n.sheen, "specular lobe", "no material has one");
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
  if (n.punctual_lights && n.refractive)
    skips.push_back({"punctual lights through refracting solids", "no shadow ray finds its way through", 1});
  if (n.punctual_lights && n.specular)
    skips.push_back({"punctual lights by way of mirrors", "no shadow ray is mirrored", 1});
  return skips;
}

}  // namespace gleaner::coordinator

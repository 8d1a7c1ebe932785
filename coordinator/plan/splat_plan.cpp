#include "coordinator/plan/splat_plan.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <nlohmann/json.hpp>
#include <optional>

#include "coordinator/plan/graph.h"
#include "coordinator/plan/lobe_cache.h"
#include "coordinator/plan/path_sampler.h"
#include "coordinator/plan/pixel_cache.h"
#include "coordinator/plan/record_look.h"
#include "coordinator/plan/splat_choice.h"
#include "kernels/splat_records.h"
#include "scene/model/error.h"

namespace gleaner::coordinator {
namespace {

using namespace kernels;
using Artifact = Graph::Artifact;

// Neighbours bound what these tell: records of 16 and of 256 are as many within 0.5 %.
constexpr std::uint32_t kMostProbeRays = 32;
// Bounds of R_k: with an accuracy of 0.3 a record reaches 6 pixels at least, and in a picture that is 512 pixels wide
// 77 at most. Smaller pictures have smaller ones, for what they show is as large.
constexpr float kLeastRadius = 20, kLeastRadiusOfSmall = 10;  // pixels
constexpr float kLeastRadiusOfWidth = 0.08f, kMostRadiusOfWidth = 0.5f;
// Pixels that a look at a cache looks at, and caches that are made for a target error, at most.
constexpr std::uint32_t kJudgedPixels = 1024;
constexpr unsigned kMostCaches = 2;
// Of what a time limit leaves the cache gets so much, or all that the paths do not ask for but for a margin.
constexpr double kCacheShareOfLimit = 0.5, kMostOfLimit = 0.9;
// Where paths carry direct light alone, as in cornell-box, a ray of a record takes as long as so many of their samples;
// where they carry more it takes less.
constexpr double kRayWork = 4.5;
// Edge of the blocks of pixels that are visited side by side, in tiles.
constexpr std::uint32_t kBlockTiles = 2;
// Records whose Hessians shape the others are chosen by mean distances, with so many times the accuracy: some third of
// what the whole cache would take. Both together are usually so many times these.
constexpr float kFirstAccuracy = 1.75f;
constexpr std::uint64_t kRecordsAFirst = 2;

struct SplatSettings : SplatCounts {
  GivenSplatCounts given;
  std::uint32_t bounces, records, order;  // records: new ones, at most
  bool smooth, hessian;
};

SplatTarget target_of(const FrameSettings& settings) {
  return {PixelCache::samples_of_records(settings), settings.target_error, settings.denoise != Denoise::off};
}

SplatSettings read_settings(const FrameSettings& settings) {
  SplatSettings s{};
  s.given = {.accuracy = real_setting(settings, "splat.accuracy"),
             .rays = whole_setting(settings, "splat.gather_rays")};
  static_cast<SplatCounts&>(s) = choose_splat_counts(target_of(settings), s.given);
  s.bounces = whole_setting(settings, "splat.bounces").value_or(0);
  s.records = whole_setting(settings, "splat.new_records").value_or(0);
  s.order = whole_setting(settings, "splat.order").value_or(0);
  s.smooth = flag_setting(settings, "splat.smooth").value_or(true);
  s.hessian = flag_setting(settings, "splat.hessian").value_or(false);
  return s;
}

void check(const FrameSettings& settings) {
  if (!PixelCache::holds(settings))
    throw Error::usage("--method splat: expected a film of at most " + std::to_string(PixelCache::most_pixels) +
                       " pixels, found " + std::to_string(settings.width) + "x" + std::to_string(settings.height));
}

class SplatPlan final : public GraphPlan {
 public:
  SplatPlan(const FrameSettings& settings, const SceneSummary& scene)
      : GraphPlan(settings, scene),
        settings_(settings),
        splat_(read_settings(settings)),
        strata_(strata_of(std::max(1u, splat_.rays))),
        cache_(settings, splat_.points),
        lobes_(graph_, cache_),
        glossy_(LobeCache::has_lobes(scene, 0)),
        paths_(graph_, film_, settings),
        cameras_(splat_.accuracy > 0 ? PixelCache::begins_with(settings) : std::vector<scene::Camera>()) {
    skips_ = path_skips(scene.needs);
    if (splat_.order && !glossy_) skips_.push_back({"records of incoming radiance", "no material has a rough lobe", 1});
    if (splat_.hessian && !shapes())
      skips_.push_back({"Hessians of records", "records are shared with other pictures, or limited in number", 1});
    if (settings.depth == 1)
      skips_.push_back({"the cache", "a depth of 1 is direct light alone", 1});
    else if (!splat_.rays)
      skips_.push_back({"the cache", "splat.gather_rays is 0: paths find all light", 1});
  }

  bool conclude(const std::vector<CutStage>& cut) override {
    // Less than the cache's light and the paths' first samples is no picture.
    return (!caches() || film_.passes() > 0) && paths_.conclude(cut, skips_);
  }
  double shared_squared_error() const override {
    return judged_ ? judged_->noise + judged_->sampling + splat_interpolation_error(*judged_, own_.facts.accuracy) : 0;
  }
  double predicted_work() const override {
    return paths_.predicted_work() + work_to_come(own_work(), paths_.asked_work());
  }
  std::vector<std::string> warnings() const override;
  std::string parameters_json() const override;
  std::vector<std::string> outline() const override;

 private:
  bool caches() const { return settings_.depth != 1 && splat_.rays > 0; }
  bool caches_lobes() const { return caches() && glossy_ && splat_.order > 0; }
  // Most scatterings on the light's way; 0: no limit.
  std::uint32_t depth() const {
    const std::uint32_t most = splat_.bounces ? splat_.bounces + 1 : 0;
    return most && settings_.depth ? std::min(most, settings_.depth) : std::max(most, settings_.depth);
  }

  // Places, of which all but those of the camera before are new, and what is gathered at these.
  struct Records {
    Artifact places, gathered;  // gathered: none where no place is new
    SplatSelectFacts facts{};
  };

  double own_work() const;
  double cached_pixels() const { return static_cast<double>(cache_.points()) / cache_.samples(); }

  // Whether the cache is looked at before paths begin, or so that a denoiser knows what it cannot see.
  bool judges() const { return settings_.target_error > 0 || settings_.denoise != Denoise::off; }

  void begin() override;
  // Scatterings on the way to a point that its records' light does not lack: a limit of bounces is the cache's alone,
  // one of the depth counts mirrors and glass before the surface as well.
  std::uint32_t free_scatterings() const { return settings_.depth ? settings_.depth - depth() : SPLAT_LEVEL; }
  void make_cache();
  void make_first_records(std::function<void()> then);
  // Whether Hessians tell how far records reach. Those that pictures share would be shaped by what came first, and a
  // limit of new ones says how many are chosen.
  bool shapes() const { return splat_.hessian && splat_.accuracy > 0 && cameras_.empty() && !splat_.records; }
  void add_own_records();
  void look_at_records(std::function<void()> then);
  void gather_own_records();
  // Whether the cache follows a time limit: what other frames begin with stays as it is.
  bool limited() const { return allowed_work_ && cameras_.empty(); }
  std::optional<double> limited_work() const;  // rays of each cache; none: no limit, or nothing is known
  void fit_limit();
  void fit_rays(std::uint64_t records);
  void tell_fewer_rays(std::uint32_t than);
  // Whether the rays of records follow what is seen of both kinds' noise. A denoiser takes that of paths out.
  bool looks_at_noise() const {
    return !splat_.given.rays && settings_.target_error == 0 && settings_.denoise == Denoise::off && cameras_.empty();
  }
  void judge(const Artifact& cache);
  void take_judgement(const Artifact& cache, const Artifact& judgement);
  double wanted_squared_error() const;  // by the samples so far
  std::optional<SplatCounts> better_counts() const;
  std::string of_this_cache(const std::string& stage) const {
    return caches_made_ > 1 ? numbered(stage, caches_made_ - 1) : stage;
  }
  SplatSelectParameters select_parameters(std::uint32_t width, std::uint32_t height, std::uint32_t samples) const;
  SplatExtendParameters extend_parameters(std::size_t camera) const;
  void extend(std::size_t camera);
  SplatGatherParameters gather_parameters(std::uint64_t records) const;
  Artifact ask_places(float coarser, const std::string& name);
  void take_facts(Records& records, std::uint64_t given);
  void gather_new(Records& records, const std::string& stage);
  void gather(Records& records, const std::string& stage);
  static StageSpec of_records(const std::string& name, const char* kind, std::uint64_t records);
  Artifact ask_merge();
  Artifact ask_smoothing(const Artifact& cache);
  void shade(const Artifact& cache);
  Artifact choose_lobe_places(const Artifact& points);
  Artifact gather_lobes(const Artifact& places, const Strata& strata);
  void begin_lobes();
  void add_light(const std::vector<float>& picture);

  FrameSettings settings_;
  SplatSettings splat_;
  Strata strata_;
  PixelCache cache_;
  LobeCache lobes_;
  bool glossy_;
  PathSampler paths_;
  CacheLight light_;
  std::vector<scene::Camera> cameras_;  // whose records the picture begins with
  std::vector<Records> before_;         // of each of these; or the first ones, by whose Hessians others are chosen
  Artifact points_;
  Records own_;
  unsigned caches_made_ = 0;
  std::optional<SplatJudgeFacts> judged_;  // of the last cache
  std::optional<double> planned_work_;     // limited_work() before places were chosen
  Artifact errors_known_;                  // an event, where a target error is given: paths may go on
  double wanted_squared_error_ = 0;        // of the whole picture, where one is given
  CacheNoise noise_;
  double albedo_ = 0;    // of what the first samples saw, in the mean
  bool chosen_ = false;  // the facts of all are known
};

void SplatPlan::begin() {
  if (!caches()) {
    paths_.begin({});
    return;
  }
  // Samples for a target error are as many as the cache leaves to them.
  if (settings_.target_error > 0) errors_known_ = graph_.event();
  paths_.begin({.classes = caches_lobes() ? PATH_CLASS_RADIANCE : PATH_CLASS_IRRADIANCE,
                .limit = std::numeric_limits<float>::infinity(),
                .known = errors_known_});
  // At once: samples that come later, while places are chosen, are more or fewer from run to run.
  if (looks_at_noise())
    graph_.when({paths_.first_samples()}, [this] {
      noise_.sample = paths_.sample_error();
      albedo_ = film_.mean_albedo();
    });
  light_.expect(caches_lobes() ? 2 : 1);
  points_ = cache_.ask_points(graph_, "splat.points", kFirst, free_scatterings());
  before_.resize(cameras_.size());
  for (std::size_t camera = 0; camera < cameras_.size(); ++camera) extend(camera);
  const auto make = [this] {
    if (caches_lobes()) begin_lobes();
    make_cache();
  };
  if (!limited()) return make();
  // How fast the farm is, the first samples tell; no picture is without them.
  graph_.when({points_, paths_.first_samples()}, [this, make] {
    fit_limit();
    make();
  });
}

std::optional<double> SplatPlan::limited_work() const {
  if (!limited() || !std::isfinite(*allowed_work_)) return std::nullopt;
  double share = kCacheShareOfLimit * *allowed_work_;
  if (settings_.target_error == 0) share = std::max(share, kMostOfLimit * *allowed_work_ - paths_.predicted_work());
  return std::max(0.0, share - cache_.work()) / kRayWork / (caches_lobes() ? 2 : 1);
}

// Before places are chosen.
void SplatPlan::fit_limit() {
  const std::optional<double> work = planned_work_ = limited_work();
  if (!work) return;
  const double accuracy = splat_.accuracy;
  const std::uint32_t rays = splat_.rays;
  static_cast<SplatCounts&>(splat_) = splat_counts_within(*work, cached_pixels(), target_of(settings_), splat_.given);
  if (splat_.accuracy > accuracy)
    skips_.push_back({"a finer cache", "the time limit leaves less for it than --spp or --target-error ask for", 1});
  tell_fewer_rays(rays);
}

// Once they are known. What a target error asks for is judged later, and frames that share records have the same rays.
void SplatPlan::fit_rays(std::uint64_t records) {
  if (splat_.given.rays) return;
  if (settings_.target_error == 0 && cameras_.empty()) {
    splat_.rays = splat_rays_of_many(static_cast<double>(records), cached_pixels(), splat_);
    splat_.rays = splat_rays_beside(noise_, splat_);
    strata_ = strata_of(splat_.rays);
  }
  std::optional<double> work = limited_work();
  if (!work) return;
  // Nothing but one worker chose places meanwhile, and the farm looks slower than it is.
  if (planned_work_) work = std::min(*planned_work_, *allowed_work_ / kRayWork);
  const std::uint32_t rays = splat_.rays;
  splat_.rays = splat_rays_within(*work, static_cast<double>(records), rays);
  tell_fewer_rays(rays);
}

void SplatPlan::tell_fewer_rays(std::uint32_t than) {
  strata_ = strata_of(splat_.rays);
  if (splat_.rays == than) return;
  skips_.push_back({"rays of each record", "the time limit leaves no time for them", than - splat_.rays});
}

void SplatPlan::make_cache() {
  ++caches_made_;
  own_ = {};
  if (!shapes()) return add_own_records();
  before_.clear();
  make_first_records([this] { add_own_records(); });
}

// Few records, which reach as far as their Hessians say.
void SplatPlan::make_first_records(std::function<void()> then) {
  const Artifact places = ask_places(kFirstAccuracy, of_this_cache("splat.first_select"));
  std::vector<Artifact> known = {places};
  if (looks_at_noise()) known.push_back(paths_.first_samples());
  graph_.when(std::move(known), [this, places, then = std::move(then)] {
    Records first;
    first.places = places;
    take_facts(first, 0);
    if (first.facts.records > 0) {
      fit_rays(kRecordsAFirst * first.facts.records);
      gather(first, of_this_cache("splat.first_gather"));
      const SplatSelectParameters bounds = select_parameters(settings_.width, settings_.height, cache_.samples());
      StageSpec spec = of_records(of_this_cache("splat.shape"), "splat_shape", first.facts.records);
      spec.output.record_bytes = SPLAT_PLACE_WORDS * 4;
      first.places = graph_.add(
          std::move(spec), SplatShapeParameters{.least_radius = bounds.least_radius, .most_radius = bounds.most_radius},
          {{"places", places}, {"records", first.gathered}});
      before_ = {first};
    }
    then();
  });
}

void SplatPlan::add_own_records() {
  own_.places = ask_places(1, of_this_cache("splat.select"));
  std::vector<Artifact> all = {own_.places};
  for (const Records& records : before_) all.push_back(records.places);
  if (looks_at_noise()) all.push_back(paths_.first_samples());
  graph_.when(std::move(all), [this] {
    take_facts(own_, before_.empty() ? 0 : before_.back().facts.records);
    look_at_records([this] { gather_own_records(); });
  });
}

// Some of the places, with few rays, before all of them.
void SplatPlan::look_at_records(std::function<void()> then) {
  const std::uint64_t added = own_.facts.records - own_.facts.given;
  const std::optional<RecordLook> look = RecordLook::at(added, splat_.rays);
  if (!looks_at_noise() || shapes() || !look) return then();
  const Artifact looked =
      graph_.add(look->stage("splat.look", "splat_gather", kFirst),
                 look->parameters(gather_parameters(look->records), own_.facts.given), {{"places", own_.places}});
  graph_.when({looked}, [this, looked, look, then = std::move(then)] {
    noise_.ray = look->noise_of(looked, albedo_);
    then();
  });
}

void SplatPlan::gather_own_records() {
  gather_new(own_, of_this_cache("splat.gather"));
  chosen_ = true;
  if (own_.facts.records == 0) {
    if (errors_known_) graph_.announce(errors_known_);
    add_light({});
    own_stages_asked_ = true;
  } else {
    const Artifact cache = ask_smoothing(ask_merge());
    judges() ? judge(cache) : shade(cache);
  }
}

void SplatPlan::judge(const Artifact& cache) {
  StageSpec spec = {.name = of_this_cache("splat.judge"),
                    .kind = "splat_judge",
                    .items = 1,
                    .solo = true,
                    .scene_parts = kNoScene,
                    .priority = kFirst,
                    .output = {.record_bytes = 4, .counted = true, .placement = Placement::retain}};
  const Artifact judgement =
      graph_.add(std::move(spec), SplatJudgeParameters{.samples = cache_.samples(), .pixels = kJudgedPixels},
                 {{"points", points_}, {"cache", cache}});
  // How much error that is, the picture's mean says, of which the first samples know the rest.
  graph_.when({judgement, paths_.first_samples()}, [this, cache, judgement] { take_judgement(cache, judgement); });
}

void SplatPlan::take_judgement(const Artifact& cache, const Artifact& judgement) {
  const auto facts = judgement.facts<SplatJudgeFacts>();
  bool sound = true;
  for (const double value : {facts.mean, facts.square, facts.noise, facts.sampling, facts.spread})
    sound = sound && value >= 0 && std::isfinite(value);
  judgement.check_facts(sound, "a noise of " + std::to_string(facts.noise));
  judged_ = facts;
  if (const std::optional<SplatCounts> better = better_counts()) {
    static_cast<SplatCounts&>(splat_) = *better;
    strata_ = strata_of(splat_.rays);
    make_cache();
    return;
  }
  if (errors_known_) {
    paths_.tell(judged_->mean, shared_squared_error());
    graph_.announce(errors_known_);
    wanted_squared_error_ = wanted_squared_error();
  }
  shade(cache);
}

double SplatPlan::wanted_squared_error() const {
  return std::pow(settings_.target_error * (film_.mean_radiance() + judged_->mean), 2);
}

// What other frames begin with stays as it is.
std::optional<SplatCounts> SplatPlan::better_counts() const {
  if (!settings_.target_error || !cameras_.empty() || caches_made_ == kMostCaches || splat_.records)
    return std::nullopt;
  std::optional<SplatCounts> better = better_splat_counts(splat_, *judged_, wanted_squared_error(), splat_.given);
  const std::optional<double> work = limited_work();
  if (better && work && usual_splat_records(cached_pixels(), better->accuracy) * better->rays > *work)
    return std::nullopt;
  return better;
}

// Both caches' light is one pass.
void SplatPlan::add_light(const std::vector<float>& picture) {
  if (light_.add(picture)) film_.add_pass(light_.take());
}

Artifact SplatPlan::choose_lobe_places(const Artifact& points) {
  return graph_.add(cache_.choosing("splat.lobe_select", "splat_select", kFirst, SPLAT_PLACE_WORDS),
                    select_parameters(settings_.width, settings_.height, cache_.samples()), {{"points", points}});
}

// `strata`: those that are chosen first, whichever cache's places are known sooner.
Artifact SplatPlan::gather_lobes(const Artifact& places, const Strata& strata) {
  const std::uint64_t records = places.record_count();
  places.check_facts(places.facts<SplatSelectFacts>().records == records, std::to_string(records) + " places");
  SplatLobeGatherParameters p{};
  p.records = gather_parameters(records);
  p.records.polar = strata.polar;
  p.records.azimuthal = strata.azimuthal;
  p.order = splat_.order;
  return graph_.add(PixelCache::gathering("splat.lobe_gather", "splat_lobe_gather", kFirst, records, strata,
                                          RADIANCE_WORDS(splat_.order)),
                    p, {{"places", places}});
}

void SplatPlan::begin_lobes() {
  lobes_.begin({.method = "splat",
                .order = splat_.order,
                .least_order = 0,
                .free_scatterings = free_scatterings(),
                .priority = kFirst,
                .choose = [this](const Artifact& points) { return choose_lobe_places(points); },
                .until = {},
                .gather = [this, strata = strata_](const Artifact& places) { return gather_lobes(places, strata); }},
               [this](const std::vector<float>& picture) { add_light(picture); });
}

double SplatPlan::own_work() const {
  if (!caches()) return 0;
  const double records =
      chosen_ ? static_cast<double>(own_.facts.records) : usual_splat_records(cached_pixels(), splat_.accuracy);
  return cache_.work() + records * strata_.count();
}

SplatSelectParameters SplatPlan::select_parameters(std::uint32_t width, std::uint32_t height,
                                                   std::uint32_t samples) const {
  SplatSelectParameters p{};
  p.width = width;
  p.height = height;
  p.samples = samples;
  p.accuracy = static_cast<float>(splat_.accuracy);
  p.most_new = splat_.records;
  p.probe_rays = std::min(kMostProbeRays, (splat_.rays + 15) / 16 * 16);
  // Of a picture with fewer pixels these are larger.
  const float scale = static_cast<float>(width) / static_cast<float>(settings_.width);
  const auto whole = static_cast<float>(settings_.width);
  const float least = std::clamp(kLeastRadiusOfWidth * whole, kLeastRadiusOfSmall, kLeastRadius);
  p.least_radius = least * scale;
  p.most_radius = std::max(least, kMostRadiusOfWidth * whole) * scale;
  p.block_tiles = kBlockTiles;
  return p;
}

// A camera's picture of its own points.
SplatExtendParameters SplatPlan::extend_parameters(std::size_t camera) const {
  SplatExtendParameters p{};
  p.points = cache_.camera_point_parameters(cameras_[camera], camera, free_scatterings());
  p.select = select_parameters(p.points.width, p.points.height, p.points.samples);
  return p;
}

// The records that this camera needs beside those of the cameras before it. They know nothing of the frame that asks.
void SplatPlan::extend(std::size_t camera) {
  std::vector<Graph::Input> given;
  if (camera > 0) given.push_back({"given", before_[camera - 1].places});
  StageSpec spec = cache_.choosing(numbered("splat.extend", camera), "splat_extend", kFirst, SPLAT_PLACE_WORDS);
  spec.output.most_records = 0xffffffffu;
  spec.output.reusable = true;
  before_[camera].places = graph_.add(std::move(spec), extend_parameters(camera), std::move(given));
  std::vector<Artifact> until;
  for (std::size_t k = 0; k <= camera; ++k) until.push_back(before_[k].places);
  graph_.when(std::move(until), [this, camera] {
    take_facts(before_[camera], camera > 0 ? before_[camera - 1].facts.records : 0);
    gather_new(before_[camera], numbered("splat.gather", camera));
  });
}

Artifact SplatPlan::ask_places(float coarser, const std::string& name) {
  SplatSelectParameters p = select_parameters(settings_.width, settings_.height, cache_.samples());
  p.accuracy *= coarser;
  std::vector<Graph::Input> inputs;
  inputs.push_back({"points", points_});
  StageSpec spec = cache_.choosing(name, "splat_select", kFirst, SPLAT_PLACE_WORDS);
  if (!before_.empty()) {
    inputs.push_back({"given", before_.back().places});
    p.keep_accuracy = shapes() ? 0 : 1;
    spec.output.most_records = 0xffffffffu;
  }
  spec.output.reusable = true;  // other lights shine on the same places
  return graph_.add(std::move(spec), p, std::move(inputs));
}

SplatGatherParameters SplatPlan::gather_parameters(std::uint64_t records) const {
  SplatGatherParameters p = cache_.gather_parameters(records, strata_);
  p.samples.depth = depth();
  p.samples.filter = PATH_CLASS_IRRADIANCE;
  p.samples.clamp = std::numeric_limits<float>::infinity();
  return p;
}

// What was chosen is known.
void SplatPlan::take_facts(Records& records, std::uint64_t given) {
  const auto facts = records.facts = records.places.facts<SplatSelectFacts>();
  records.places.check_facts(facts.records == records.places.record_count() && facts.given == given &&
                                 facts.records >= given && facts.accuracy >= 0 && std::isfinite(facts.accuracy),
                             std::to_string(facts.records) + " records, " + std::to_string(facts.given) +
                                 " of them given, at an accuracy of " + std::to_string(facts.accuracy) + ", and " +
                                 std::to_string(records.places.record_count()) + " places");
}

void SplatPlan::gather_new(Records& records, const std::string& stage) {
  const std::uint64_t added = records.facts.records - records.facts.given;
  if (added == 0) return;
  if (&records == &own_ && !shapes()) fit_rays(added);
  gather(records, stage);
}

// Light is gathered at the places that are new.
void SplatPlan::gather(Records& records, const std::string& stage) {
  const SplatSelectFacts& facts = records.facts;
  const std::uint64_t added = facts.records - facts.given;
  SplatGatherParameters p = gather_parameters(added);
  p.first_place = low(facts.given);
  p.hessian = shapes() && &records != &own_;
  StageSpec spec = PixelCache::gathering(stage, "splat_gather", kFirst, added, strata_);
  spec.output.reusable = &records != &own_ && !shapes();
  records.gathered = graph_.add(std::move(spec), p, {{"places", records.places}});
}

// All records as one cache.
Artifact SplatPlan::ask_merge() {
  if (before_.empty()) return own_.gathered;
  std::vector<Graph::Input> inputs = {{"places", own_.places}};
  for (const Records& records : before_)
    if (records.gathered) inputs.push_back({numbered("records", inputs.size() - 1), records.gathered});
  if (own_.gathered) inputs.push_back({numbered("records", inputs.size() - 1), own_.gathered});
  return graph_.add(of_records(of_this_cache("splat.merge"), "splat_merge", own_.facts.records),
                    SplatMergeParameters{.records = low(own_.facts.records)}, std::move(inputs));
}

StageSpec SplatPlan::of_records(const std::string& name, const char* kind, std::uint64_t records) {
  return {.name = name,
          .kind = kind,
          .items = 1,
          .solo = true,
          .scene_parts = kNoScene,
          .priority = kFirst,
          .output = {.record_bytes = CACHE_WORDS * 4,
                     .counted = true,
                     .most_records = low(records),
                     .placement = Placement::retain}};
}

// A record at every point is asked for to see what it gathered.
Artifact SplatPlan::ask_smoothing(const Artifact& cache) {
  if (!splat_.smooth || splat_.accuracy == 0) return cache;
  return graph_.add(of_records(of_this_cache("splat.smooth"), "splat_smooth", own_.facts.records),
                    SplatSmoothParameters{}, {{"cache", cache}});
}

void SplatPlan::shade(const Artifact& cache) {
  const Artifact shaded = cache_.ask_shading(graph_, "splat.shade", kFirst, points_, cache);
  points_ = {};
  own_stages_asked_ = true;
  cache_.preview(graph_, film_, shaded);
  graph_.when({shaded}, [this, shaded] { add_light(cache_.picture_of(shaded.records())); });
}

std::vector<std::string> SplatPlan::warnings() const {
  std::vector<std::string> warnings = paths_.warnings();
  if (judged_ && settings_.target_error > 0 && shared_squared_error() > wanted_squared_error_)
    warnings.push_back("the cache alone is predicted to be off by more than the target error of " +
                       std::to_string(settings_.target_error));
  const std::uint64_t added = own_.facts.records - own_.facts.given;
  if (splat_.records && added > splat_.records)
    warnings.push_back("splat.new_records is " + std::to_string(splat_.records) +
                       ", but the coarsest cache that covers the picture needs " + std::to_string(added) +
                       " new records");
  return warnings;
}

std::string SplatPlan::parameters_json() const {
  nlohmann::json json = paths_.parameters();
  nlohmann::json splat = {{"accuracy", splat_.accuracy}, {"gather_rays", splat_.rays}, {"bounces", splat_.bounces}};
  if (caches()) {
    splat["gather_rays"] = strata_.count();
    splat["points_a_pixel"] = cache_.samples();
    splat["points"] = own_.facts.points;
    splat["records"] = own_.facts.records;
    splat["rounds"] = own_.facts.rounds;
    splat["probes"] = own_.facts.probes;
    if (!cameras_.empty()) {
      splat["cameras"] = cameras_.size();
      splat["new_records"] = own_.facts.records - own_.facts.given;
    }
    if (shapes()) splat["first_records"] = own_.facts.given;
    if (caches_lobes()) splat["order"] = splat_.order, splat["lobe_records"] = lobes_.records();
    if (splat_.accuracy > 0) splat["accuracy"] = own_.facts.accuracy;
    if (noise_.sample > 0) splat["sample_error"] = noise_.sample;
    if (noise_.ray > 0) splat["ray_error"] = noise_.ray;
    if (judged_ && judged_->mean > 0) {
      splat["caches"] = caches_made_;
      splat["mean"] = judged_->mean;
      splat["error_of_records"] = std::sqrt(judged_->noise) / judged_->mean;
      splat["error_of_sampling"] = std::sqrt(judged_->sampling) / judged_->mean;
      splat["error_of_interpolation"] =
          std::sqrt(splat_interpolation_error(*judged_, own_.facts.accuracy)) / judged_->mean;
    }
  }
  json["splat"] = splat;
  return json.dump();
}

std::vector<std::string> SplatPlan::outline() const {
  std::vector<std::string> lines;
  if (caches()) {
    lines.push_back("splat.points: " + std::to_string(cache_.samples()) + " surface points of each pixel, in " +
                    std::to_string(cache_.tiles()) + " tiles, split");
    if (!cameras_.empty())
      lines.push_back("splat.extend, splat.gather: records of " + std::to_string(cameras_.size()) +
                      " cameras, those of one beside what the ones before it have; made once for all pictures");
    if (shapes())
      lines.push_back("splat.first_select, first_gather, shape: few records, whose Hessians say how far they reach");
    lines.push_back("splat.select: where records are needed, solo");
    if (looks_at_noise() && !shapes())
      lines.push_back(
          "splat.look: some records with few rays, which tell with the first samples how many all get, split");
    lines.push_back("splat.gather: light from " + std::to_string(strata_.count()) +
                    " directions at each record, split");
    if (splat_.smooth && splat_.accuracy > 0)
      lines.push_back("splat.smooth: records blended with their neighbours, as far as they are noisy, solo");
    if (judges()) lines.push_back("splat.judge: how far the cache is off, from itself, solo");
    lines.push_back("splat.shade: " + std::to_string(cache_.tiles()) + " tiles lit by the records near them, split");
    if (caches_lobes())
      lines.push_back(
          "splat.lobe_points, lobe_select, lobe_gather, lobe_shade: the same for rough lobes, by incoming "
          "radiance in hemispherical harmonics of order " +
          std::to_string(splat_.order));
  }
  for (const std::string& line : paths_.outline()) lines.push_back(line);
  return lines;
}

}  // namespace

Method splat_method() {
  using enum SettingType;
  return {
      .name = "splat",
      .help =
          "Radiance cache splatting: indirect light on diffuse surfaces is gathered at a few records and interpolated "
          "between them; explained in docs/explanation/splat.md. * What is not set is chosen for --spp or "
          "--target-error.",
      .make = make_plan_of<SplatPlan>,
      // Beside the paths: the pass, its square, the preview and the records twice, all RGB.
      .bytes_a_pixel = kPathBytesAPixel + 5 * 3 * sizeof(float),
      .check = check,
      .settings = {
          {"splat.accuracy", real, 0, 1, "*",
           "a: a record reaches that part of the mean distance to the surfaces about it; less: more records; 0: a "
           "record at every point that a pixel shows"},
          {"splat.gather_rays", whole, 0, SPLAT_MOST_RAYS / 2, "*",
           "rays of each record; 0: no cache, paths find all light"},
          {"splat.bounces", whole, 0, 1024, "0", "bounces of the cache's light; 0: until Russian roulette ends it"},
          {"splat.smooth", flag, 0, 1, "1",
           "1: each record takes part of what its neighbours say of its place, as far as records are noisy; 0: none "
           "does"},
          {"splat.hessian", flag, 0, 1, "0",
           "1: second derivatives of the light say how far a record reaches, along each tangent its own way; 0: the "
           "mean distance to the surfaces about it does. Pictures that share records, and splat.new_records, keep the "
           "latter"},
          {"splat.new_records", whole, 0, 1u << 24, "0",
           "new records of a frame, at most, beside those it begins with: the accuracy is coarsened until they "
           "suffice, "
           "and frames that follow make it finer; 0: no limit"},
          {"splat.order", whole, 0, SPLAT_MOST_ORDER, "0",
           "order of hemispherical harmonics that light on rough lobes (roughness from 0.45 on) is cached in; 0: paths "
           "find that light"},
      }};
}

}  // namespace gleaner::coordinator

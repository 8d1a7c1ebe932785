#include "coordinator/plan/photon_plan.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <limits>
#include <nlohmann/json.hpp>
#include <span>

#include "coordinator/plan/graph.h"
#include "coordinator/plan/lobe_cache.h"
#include "coordinator/plan/path_sampler.h"
#include "coordinator/plan/photon_choice.h"
#include "coordinator/plan/pixel_cache.h"
#include "coordinator/plan/record_look.h"
#include "kernels/photon_records.h"

namespace gleaner::coordinator {
namespace {

using namespace kernels;
using Artifact = Graph::Artifact;

// Photons of a density estimate: of the map that paths gather from, and of caustics in the first pass. Measured on
// the Cornell boxes.
constexpr std::uint32_t kGatherNeighbours = 24, kCausticNeighbours = 64;
// The widest estimate, over the diagonal of the scene's bounds.
constexpr double kMostRadius = 0.05;
// Places of a pass, at least, where caustics are read, for each of its light paths: they take half of its time then.
constexpr double kReadsOfALightPath = 0.5;
// Samples of a pixel for each point that clusters light. Of as many points as samples the error is as large in rooms
// but for the worst 0.1 % of the pixels, and a picture takes a tenth to a fifth longer.
constexpr std::uint32_t kSamplesOfAPoint = 2;
// Of a place where caustics are read, the time over that of a path's sample.
constexpr double kReadWork = 2;
// The guide's photons are those of a pass that is none.
constexpr std::uint32_t kGlobalPass = 0, kGuidePass = 1, kFirstPass = 2, kPilotPass = 1u << 31;
// Turns of k-means.
constexpr std::uint32_t kIterations = 6;
// Rounds in which samples are added where their records may be off most, each of a third of the clusters at most. More
// than one of them pays where records are less noisy than with so many rays.
constexpr std::uint32_t kRefineRounds = 3, kRaysOfRounds = 384;
// Photons of the estimates at a cut's nodes, rounds of its refinement, the ratio of section 3.3, and how much
// irradiance may vary within a node.
constexpr std::uint32_t kCutNeighbours = 24, kCutRounds = 4;
constexpr float kCutRatio = 1.2f, kCutSpread = 0.1f;
// A cluster of a camera before stands for what is seen from no nearer by than half as far as that camera saw it.
constexpr float kKeptFootprint = 2;
// Of hemispherical harmonics, where it is not set.
constexpr std::uint32_t kUsualOrder = 4;
// Noise of a sample's record of one ray, over its light, as pixels share it.
constexpr double kRecordNoise = 0.5;
// The same of incoming radiance, as rough lobes show it: 0.5 at a roughness of 0.7, 0.9 at 0.5.
constexpr double kLobeNoise = 0.8;
// Photons this near to what is seen or read are of use, over the diagonal of the scene's bounds.
constexpr double kGuideNear = 0.01;

struct PhotonSettings : PhotonCounts {
  std::uint32_t samples;  // of a pixel and pass of caustics
  double radius;          // m; 0: by the nearest photons
  std::uint32_t order;    // of hemispherical harmonics of light on rough lobes; 0: paths find that light
  std::uint32_t guide;    // light paths of the pilot that tells where photons are of use; 0: none
  GivenPhotonCounts given;
};

PhotonSettings read_settings(const FrameSettings& settings) {
  const GivenPhotonCounts given = {.count = whole_setting(settings, "photon.count"),
                                   .caustics = whole_setting(settings, "photon.caustics"),
                                   .passes = whole_setting(settings, "photon.passes"),
                                   .clusters = whole_setting(settings, "photon.clusters"),
                                   .rays = whole_setting(settings, "photon.gather_rays"),
                                   .cut = whole_setting(settings, "photon.cut")};
  const auto chosen = [&](std::uint32_t spp) {
    return choose_photon_counts(std::uint64_t{settings.width} * settings.height, spp, settings.target_error,
                                PixelCache::holds(settings), given);
  };
  PhotonSettings p{chosen(PixelCache::samples_of_records(settings)),
                   1,
                   real_setting(settings, "photon.radius").value_or(0),
                   whole_setting(settings, "photon.order").value_or(kUsualOrder),
                   whole_setting(settings, "photon.guide").value_or(0),
                   given};
  p.passes = chosen(settings.planned_spp()).passes;  // which nothing is shared of
  // As many places of caustics in a pixel as samples. More where pixels are few: what a pass traces is worth more
  // reads.
  const double pixels = static_cast<double>(std::uint64_t{settings.width} * settings.height),
               reads = kReadsOfALightPath * p.caustics / pixels;
  const double samples = std::max(static_cast<double>(settings.planned_spp()) / std::max(1u, p.passes), reads);
  p.samples = std::bit_floor(static_cast<std::uint32_t>(std::clamp(samples, 1.0, 16.0)));
  return p;
}

double diagonal_of(const scene::Bounds& bounds) {
  double sum = 0;
  for (int k = 0; k < 3; ++k) sum += std::pow(double{bounds.upper[k]} - bounds.lower[k], 2);
  return std::max(std::sqrt(sum), 1e-6);
}

// Whether any surface has a sharp part (kernels/transport/parts.h).
bool has_sharp_parts(const scene::SceneNeeds& n) {
  return n.specular || n.glossy || n.metallic || n.transmissive || n.clearcoat || n.sheen || n.iridescence;
}

// What photons alone bring to the picture: mean radiance, and predicted squared error, over pixels and channels.
struct OwnLight {
  double mean = 0, squared_error = 0;

  // Light whose standard deviation is `noise` of itself.
  void add(std::span<const float> picture, double noise) {
    double sum = 0, squares = 0;
    for (const float value : picture) {
      sum += double{value};
      squares += double{value} * value;
    }
    const double count = std::max<double>(1, static_cast<double>(picture.size()));
    mean += sum / count;
    squared_error += noise * noise * squares / count;
  }
};

PhotonMapFacts checked_map(const Graph::Artifact& map) {
  const auto facts = map.facts<PhotonMapFacts>();
  map.check_facts(facts.radius >= 0 && std::isfinite(facts.radius) &&
                      std::ranges::all_of(facts.power, [](double w) { return w >= 0 && std::isfinite(w); }),
                  "a radius of " + std::to_string(facts.radius) + " m");
  return facts;
}

class PhotonPlan final : public GraphPlan {
 public:
  PhotonPlan(const FrameSettings& settings, const SceneSummary& scene);

  bool conclude(const std::vector<CutStage>& cut) override;
  double predicted_work() const override {
    return paths_.predicted_work() + work_to_come(own_work(), paths_.asked_work());
  }
  std::vector<std::string> warnings() const override { return paths_.warnings(); }
  std::string parameters_json() const override;
  std::vector<std::string> outline() const override;

 private:
  struct Pass {
    Artifact map;
    PhotonMapFacts facts;
  };

  std::uint64_t pixels() const { return std::uint64_t{settings_.width} * settings_.height; }
  bool indirect() const { return settings_.depth != 1; }
  bool gathers() const { return indirect() && photon_.count > 0; }
  bool has_caustics() const { return indirect() && photon_.caustics > 0 && sharp_; }
  // A frame alone: pictures that share clusters share photons as well, which are no camera's.
  bool is_guided() const {
    return photon_.guide > 0 && (gathers() || has_caustics()) && PixelCache::holds(settings_) &&
           PixelCache::begins_with(settings_).empty();
  }
  bool has_clusters() const { return gathers() && photon_.clusters > 0 && photon_.rays > 0; }
  bool has_lobes() const { return has_clusters() && photon_.order > 0 && glossy_; }
  std::uint32_t classes() const {
    return (gathers() ? PATH_CLASS_DIFFUSE | PATH_CLASS_MIXED : 0) | (has_caustics() ? PATH_CLASS_CAUSTIC : 0) |
           (has_clusters() ? PATH_CLASS_LAYER : 0) | (has_lobes() ? PATH_CLASS_LOBE : 0);
  }
  // Pictures that the film takes the mean of.
  std::size_t passes() const { return has_caustics() ? passes_.size() : has_clusters() ? 1 : 0; }
  PhotonEstimate estimate(std::uint32_t neighbours) const;
  // Of the map, m, once it is known.
  double spacing() const { return photon_.radius > 0 ? photon_.radius : std::min(gathered_.radius, most_radius_); }
  float limit() const;
  // Maps are traced and built, those of caustics read by every pixel; clusters' samples send rays.
  double own_work() const {
    return (gathers() ? 2.0 * photon_.count : 0.0) +
           static_cast<double>(passes_.size()) *
               (2.0 * photon_.caustics + static_cast<double>(pixels()) * photon_.samples) +
           (has_clusters() ? cluster_work() + (has_lobes() ? cluster_work() : 0) : 0.0);
  }

  // Whether counts follow what is seen of the noise of paths and of the method's own light. A denoiser takes the former
  // out; pictures of a row, and a target error, choose by what they know before.
  bool looks_at_noise() const {
    return gathers() && settings_.target_error == 0 && settings_.denoise == Denoise::off &&
           PixelCache::begins_with(settings_).empty();
  }
  double pass_work() const {
    return 2.0 * photon_.caustics + kReadWork * static_cast<double>(pixels()) * photon_.samples;
  }

  double cluster_work() const { return cache_.work() + static_cast<double>(photon_.clusters) * strata_.count(); }

  void begin() override;
  Artifact ask_photons(const std::string& suffix, PhotonTraceParameters p, std::uint32_t paths,
                       std::vector<Graph::Input> inputs);
  void ask_guides();
  Artifact ask_guide(const std::string& suffix, const Artifact& pilot, std::uint32_t classes, bool gathers);
  Artifact ask_map(const std::string& suffix, std::uint32_t pass, std::uint32_t paths, std::uint32_t classes);
  Artifact ask_cut(const Artifact& map);
  std::uint32_t cut_depth() const;
  std::vector<Graph::Input> light_of(const Artifact& map) const;
  void gather(const Artifact& map);
  // A chain of sample points: each stage's are those of the one before and new ones, where records are gathered.
  struct Places {
    Artifact places, gathered;  // gathered: none where no place is new
    std::uint64_t count = 0;    // of places
  };
  void ask_clusters();
  PhotonClusterParameters cluster_parameters(std::uint32_t width, std::uint32_t height, std::uint32_t samples) const;
  PhotonClusterGatherParameters gather_parameters(std::uint64_t records, std::uint32_t order) const;
  PhotonClusterRefineParameters refine_parameters(std::uint32_t width, std::uint32_t height, std::uint32_t samples,
                                                  std::size_t round) const;
  PhotonClusterFacts checked_places(const Artifact& places, std::uint64_t given) const;
  void gather_new(Places& places, std::uint64_t count, std::uint64_t given, const std::string& name, bool shared);
  std::vector<Artifact> places_and_light(std::size_t cameras) const;
  StageSpec shared_choice(const std::string& name, const char* kind) const;
  void extend(std::size_t camera);
  void look_at_records(std::function<void()> then);
  void gather_own();
  std::size_t rounds() const { return strata_.count() < kRaysOfRounds ? 1 : kRefineRounds; }
  void refine_next();
  Artifact ask_refinement(std::size_t camera, std::size_t round, std::vector<Graph::Input> inputs);
  // Those of the places that are new, as input "records.N".
  static void add_records(const Places& places, std::vector<Graph::Input>& inputs);
  std::uint64_t refined() const { return refined_.empty() ? 0 : refined_.back().count; }
  void shade_clusters();
  void show_clusters(const std::vector<float>& picture, double noise);
  Artifact choose_lobe_places(const Artifact& points);
  Artifact gather_lobes(const Artifact& places);
  void begin_lobes();
  void ask_caustics(std::uint32_t pass);
  void shade_caustics(std::uint32_t pass);
  void ask_caustics_after(std::uint32_t pass);
  void choose_passes(const Artifact& first);

  FrameSettings settings_;
  PhotonSettings photon_;
  bool sharp_, glossy_;
  double near_;         // m: kGuideNear
  double most_radius_;  // m
  PathSampler paths_;
  PhotonMapFacts gathered_;
  Artifact cut_;  // none: there is no cut
  PhotonCutFacts cut_facts_;
  PixelCache cache_;
  LobeCache lobes_;
  Strata strata_;
  std::vector<scene::Camera> cameras_;  // whose sample points the picture begins with
  std::vector<Places> before_;          // of each of these, what it needs beside the cameras before it
  Artifact map_;                        // that samples' rays read
  Artifact points_;                     // that the picture shows
  Places own_;
  std::vector<Places> refined_;       // kRefineRounds of each camera, of the picture alone where there is none
  std::size_t gathered_cameras_ = 0;  // whose own places are gathered at; the picture counts for one
  bool refining_ = false;
  PhotonClusterFacts clusters_;
  std::shared_ptr<Beside> beside_;  // the passes: the clusters' light
  CacheLight light_;                // of the clusters: on layers, on lobes
  Artifact first_caustics_;         // an event, where a target error waits for the first pass
  OwnLight own_light_;
  Artifact seen_;        // an event: the first samples' noise is known; none: it is not asked for
  Artifact rays_known_;  // an event, beside that one
  CacheNoise noise_;
  double albedo_ = 0;  // of what the first samples saw, in the mean
  double first_pass_error_ = 0;
  double usual_work_ = 0;  // of all but the passes, in samples, before anything is seen
  bool clusters_asked_ = false, caustics_asked_ = false;
  Artifact map_emission_, caustic_emission_;  // emission guides; none: light paths begin anywhere alike
  PhotonGuideFacts map_guide_, caustic_guide_;
  Artifact guide_;  // of caustics' radii
  std::vector<Pass> passes_;
};

PhotonPlan::PhotonPlan(const FrameSettings& settings, const SceneSummary& scene)
    : GraphPlan(settings, scene),
      settings_(settings),
      photon_(read_settings(settings)),
      sharp_(has_sharp_parts(scene.needs)),
      glossy_(LobeCache::has_lobes(scene, photon_.order)),
      near_(kGuideNear * diagonal_of(scene.bounds)),
      most_radius_(photon_.radius > 0 ? photon_.radius : kMostRadius * diagonal_of(scene.bounds)),
      paths_(graph_, film_, settings),
      cache_(settings, std::max(1u, settings.method_spp() / kSamplesOfAPoint)),
      lobes_(graph_, cache_),
      strata_(strata_of(std::max(1u, photon_.rays))),
      // As many clusters as points are no clusters.
      cameras_(has_clusters() && photon_.clusters < pixels() ? PixelCache::begins_with(settings)
                                                             : std::vector<scene::Camera>()) {
  skips_ = path_skips(scene.needs);
  if (has_caustics()) {
    passes_.resize(photon_.passes);
    // Photons find these by themselves.
    std::erase_if(skips_, [](const Skip& skip) { return skip.what.starts_with("punctual lights "); });
  }
  if (photon_.guide && !is_guided() && (gathers() || has_caustics()))
    skips_.push_back({"guided photons", "the film is too large, or pictures share their photons", 1});
  if (!indirect()) skips_.push_back({"photons", "a depth of 1 is direct light alone", 1});
  if (indirect() && !photon_.count)
    skips_.push_back({"the photon map", "photon.count is 0: paths find all light but caustics", 1});
  if (gathers() && !has_clusters())
    skips_.push_back({"shading clusters",
                      PixelCache::holds(settings_)
                          ? "photon.clusters or photon.gather_rays is 0: each sample gathers by itself"
                          : "the film is too large: each sample gathers by itself",
                      1});
  if (has_clusters() && photon_.order && !glossy_)
    skips_.push_back({"records of incoming radiance", "no material has a lobe that is rough enough", 1});
  if (indirect() && !photon_.caustics)
    skips_.push_back({"caustic photons", "photon.caustics is 0: paths find the caustics", 1});
  if (indirect() && photon_.caustics && !sharp_)
    skips_.push_back({"caustic photons", "no surface has a mirror, glass or a lobe", 1});
}

PhotonEstimate PhotonPlan::estimate(std::uint32_t neighbours) const {
  return {.neighbours = photon_.radius > 0 ? 0 : neighbours, .most_radius = static_cast<float>(most_radius_)};
}

void PhotonPlan::begin() {
  if (has_clusters()) beside_ = std::make_shared<Beside>(graph_.event());
  // Samples for a target error are as many as the rest of the picture leaves to them.
  std::vector<Artifact> known;
  if (settings_.target_error > 0 && gathers()) {
    if (has_clusters()) known.push_back(beside_->known);
    if (has_caustics()) known.push_back(first_caustics_ = graph_.event());
  }
  if (looks_at_noise()) {
    seen_ = graph_.event();
    rays_known_ = graph_.event();
  }
  usual_work_ = static_cast<double>(pixels()) * settings_.planned_spp() + (has_clusters() ? cluster_work() : 0);
  if (is_guided()) ask_guides();
  if (has_caustics()) {
    guide_ = ask_map("guide", kGuidePass, photon_.caustics, PHOTON_CLASS_BIT(PHOTON_CAUSTIC));
    ask_caustics(0);
  }
  if (gathers()) {
    const Artifact map = ask_map("global", kGlobalPass, photon_.count, PHOTON_ALL_CLASSES);
    if (photon_.cut) cut_ = ask_cut(map);
    known.push_back(cut_ ? cut_ : map);
    graph_.when(std::move(known), [this, map] {
      gathered_ = checked_map(map);
      if (cut_) cut_facts_ = cut_.facts<PhotonCutFacts>();
      gather(map);
    });
    if (has_clusters()) {
      map_ = map;
      light_.expect(has_lobes() ? 2 : 1);
      ask_clusters();
      if (has_lobes()) begin_lobes();
    }
  } else {
    paths_.begin({.classes = classes(), .limit = std::numeric_limits<float>::infinity()});
  }
}

// Where photons are of use, by a few paths that begin anywhere.
void PhotonPlan::ask_guides() {
  points_ = cache_.ask_points(graph_, "photon.points", kFirst);
  PhotonTraceParameters p{};
  p.most_depth = settings_.depth ? settings_.depth - 1 : GLEANER_NONE;
  p.classes = PHOTON_ALL_CLASSES;
  p.pass = kPilotPass;
  p.pilot = 1;
  const Artifact pilot = ask_photons("pilot", p, photon_.guide, {});
  if (gathers()) map_emission_ = ask_guide("global", pilot, PHOTON_ALL_CLASSES, true);
  if (has_caustics()) caustic_emission_ = ask_guide("caustics", pilot, PHOTON_CLASS_BIT(PHOTON_CAUSTIC), false);
}

Artifact PhotonPlan::ask_guide(const std::string& suffix, const Artifact& pilot, std::uint32_t classes, bool gathers) {
  PhotonGuideParameters p{};
  p.width = settings_.width;
  p.height = settings_.height;
  p.samples = cache_.samples();
  p.paths = photon_.guide;
  p.classes = classes;
  p.gathers = gathers;
  p.near = static_cast<float>(near_);
  p.seed_low = low(settings_.seed);
  p.seed_high = high(settings_.seed);
  StageSpec spec = cache_.choosing("photon.guide." + suffix, "photon_guide", kFirst);
  spec.output.record_bytes = GUIDE_WORDS * 4;
  spec.output.most_records = GUIDE_MOST_ROWS;
  const Artifact guide = graph_.add(std::move(spec), p, {{"points", points_}, {"photons", pilot}});
  graph_.when({guide}, [this, guide, gathers] {
    const auto facts = guide.facts<PhotonGuideFacts>();
    guide.check_facts(facts.cells > 0 && facts.useful <= photon_.guide && std::isfinite(facts.most),
                      std::to_string(facts.useful) + " useful paths, " + std::to_string(facts.cells) + " cells");
    (gathers ? map_guide_ : caustic_guide_) = facts;
  });
  return guide;
}

// Light paths, which leave photons.
Artifact PhotonPlan::ask_photons(const std::string& suffix, PhotonTraceParameters p, std::uint32_t paths,
                                 std::vector<Graph::Input> inputs) {
  p.items_low = paths;
  p.seed_low = low(settings_.seed);
  p.seed_high = high(settings_.seed);
  // Another camera sees the same photons.
  return graph_.add({.name = "photon.trace." + suffix,
                     .kind = "photon_trace",
                     .items = paths,
                     .tile = 16,
                     .priority = kFirst,
                     .work = static_cast<double>(paths),
                     .output = {.record_bytes = PHOTON_WORDS * 4,
                                .counted = true,
                                .most_records = PHOTON_PATH_SLOTS,
                                .placement = Placement::retain,
                                .reusable = true}},
                    p, std::move(inputs));
}

// Light paths, and the map of the photons that they leave.
Artifact PhotonPlan::ask_map(const std::string& suffix, std::uint32_t pass, std::uint32_t paths,
                             std::uint32_t classes) {
  const bool caustics = classes == PHOTON_CLASS_BIT(PHOTON_CAUSTIC);
  PhotonTraceParameters p{};
  // Beside its own scatterings light takes one at the first surface, and what is gathered one more.
  p.most_depth = settings_.depth ? settings_.depth - (caustics ? 1 : 2) : GLEANER_NONE;
  p.classes = classes;
  p.pass = pass;
  const Artifact& emission = caustics ? caustic_emission_ : map_emission_;
  std::vector<Graph::Input> inputs;
  if (emission) inputs.push_back({"emission", emission});
  const Artifact traced = ask_photons(suffix, p, paths, std::move(inputs));
  // A node for each 8 photons at most, in whole blocks.
  const std::uint64_t most = 2 * std::uint64_t{paths} * PHOTON_PATH_SLOTS + 64;
  return graph_.add({.name = "photon.map." + suffix,
                     .kind = "photon_map",
                     .items = 1,
                     .solo = true,
                     .priority = kFirst,
                     .work = static_cast<double>(paths),
                     .output = {.record_bytes = PHOTON_WORDS * 4,
                                .counted = true,
                                .most_records = low(std::min<std::uint64_t>(most, 0xffffffffu)),
                                .placement = Placement::retain,
                                .reusable = true}},
                    PhotonMapParameters{.classes = classes,
                                        .neighbours = kGatherNeighbours,
                                        .shine = caustics ? 0u : 1u,
                                        .most_radius = static_cast<float>(most_radius_)},
                    {{"photons", traced}});
}

// Nearer than an estimate is wide, its photons are those of the surface that the path comes from, and their mean over
// it says little of this place.
float PhotonPlan::limit() const { return std::max(static_cast<float>(spacing()), std::numeric_limits<float>::min()); }

Artifact PhotonPlan::ask_cut(const Artifact& map) {
  PhotonCutParameters p{};
  p.nodes = photon_.cut;
  p.rounds = kCutRounds;
  p.ratio = kCutRatio;
  p.spread = kCutSpread;
  p.estimate = estimate(kCutNeighbours);
  return graph_.add({.name = "photon.cut",
                     .kind = "photon_cut",
                     .items = 1,
                     .solo = true,
                     .priority = kFirst,
                     .output = {.record_bytes = PHOTON_WORDS * 4,
                                .counted = true,
                                .most_records = 0xffffffffu,
                                .placement = Placement::retain,
                                .reusable = true}},
                    p, {{"map", map}});
}

// Scatterings that the map's photons may have: as ask_map() has them.
std::uint32_t PhotonPlan::cut_depth() const {
  return settings_.depth ? std::min(settings_.depth - 2, PHOTON_MOST_DEPTH) : PHOTON_MOST_DEPTH;
}

std::vector<Graph::Input> PhotonPlan::light_of(const Artifact& map) const {
  std::vector<Graph::Input> inputs = {{"map", map}};
  if (cut_) inputs.push_back({"cut", cut_});
  return inputs;
}

// Paths that read the map behind their first surface.
void PhotonPlan::gather(const Artifact& map) {
  struct {
    PhotonEstimate estimate;
    std::uint32_t cut_depth, order;
  } program{.estimate = estimate(kGatherNeighbours), .cut_depth = cut_depth(), .order = photon_.order};
  static_assert(sizeof(PathParameters) + sizeof program == sizeof(PhotonGatherParameters));
  paths_.begin(
      {.classes = classes(), .limit = limit(), .mean = own_light_.mean, .squared_error = own_light_.squared_error},
      {.kind = "photon_gather", .method_parameters = bytes_of(program), .inputs = light_of(map)});
  if (!looks_at_noise()) return;
  // At once: samples that come later are more or fewer from run to run.
  graph_.when({paths_.first_samples()}, [this] {
    noise_.sample = paths_.sample_error();
    albedo_ = film_.mean_albedo();
    graph_.announce(seen_);
  });
}

// --- Shading clusters ---

// Which points are gathered at depends on geometry alone: they are chosen while photons are traced.
void PhotonPlan::ask_clusters() {
  if (!points_) points_ = cache_.ask_points(graph_, "photon.points", kFirst);
  before_.resize(cameras_.size());
  for (std::size_t camera = 0; camera < cameras_.size(); ++camera) extend(camera);
  PhotonClusterParameters p = cluster_parameters(settings_.width, settings_.height, cache_.samples());
  std::vector<Graph::Input> inputs = {{"points", points_}};
  if (!before_.empty()) {
    inputs.push_back({"given", before_.back().places});
    // Cameras' pictures have fewer pixels than this one.
    const auto camera = cache_.camera_point_parameters(cameras_.back(), 0, SPLAT_LEVEL);
    p.kept_footprint *= static_cast<float>(settings_.width) / static_cast<float>(camera.width);
  }
  own_.places = graph_.add(shared_choice("photon.clusters", "photon_cluster"), p, std::move(inputs));
  std::vector<Artifact> until = places_and_light(before_.size());
  until.push_back(own_.places);
  if (seen_) until.push_back(seen_);
  graph_.when(std::move(until), [this] {
    look_at_records([this] {
      if (rays_known_) graph_.announce(rays_known_);
      gather_own();
    });
  });
}

// Some of the places, with few rays, before all of them.
void PhotonPlan::look_at_records(std::function<void()> then) {
  gathered_ = checked_map(map_);
  const std::uint64_t places = own_.places.record_count();
  const std::optional<RecordLook> look = RecordLook::at(places, strata_.count());
  if (!looks_at_noise() || photon_.given.rays || !look) return then();
  PhotonClusterGatherParameters p = gather_parameters(places, 0);
  p.records = look->parameters(p.records, 0);
  std::vector<Graph::Input> inputs = light_of(map_);
  inputs.push_back({"places", own_.places});
  const Artifact looked = graph_.add(look->stage("photon.look", "photon_cluster_gather", kFirst), p, std::move(inputs));
  graph_.when({looked}, [this, looked, look, then = std::move(then)] {
    noise_.ray = look->noise_of(looked, albedo_, CLUSTER_NOISE);
    photon_.rays = photon_rays_beside(noise_, photon_);
    strata_ = strata_of(photon_.rays);
    then();
  });
}

PhotonClusterParameters PhotonPlan::cluster_parameters(std::uint32_t width, std::uint32_t height,
                                                       std::uint32_t samples) const {
  PhotonClusterParameters p{};
  p.width = width;
  p.height = height;
  p.samples = samples;
  p.clusters = photon_.clusters;
  p.iterations = kIterations;
  p.seed_low = low(settings_.seed);
  p.seed_high = high(settings_.seed);
  p.kept_footprint = kKeptFootprint;
  return p;
}

PhotonClusterRefineParameters PhotonPlan::refine_parameters(std::uint32_t width, std::uint32_t height,
                                                            std::uint32_t samples, std::size_t round) const {
  const std::uint64_t most = std::uint64_t{photon_.clusters} * (round + 1) / kRefineRounds;
  return {.width = width,
          .height = height,
          .samples = samples,
          .most = std::max(1u, low(most)),
          .noise = static_cast<float>(kRecordNoise / std::sqrt(strata_.count()))};
}

PhotonClusterFacts PhotonPlan::checked_places(const Artifact& places, std::uint64_t given) const {
  const auto facts = places.facts<PhotonClusterFacts>();
  places.check_facts(facts.places == places.record_count() && facts.given == given && facts.places >= given,
                     std::to_string(facts.places) + " places, " + std::to_string(facts.given) + " of them given, and " +
                         std::to_string(places.record_count()) + " records");
  return facts;
}

// `order`: of incoming radiance; 0: irradiance.
PhotonClusterGatherParameters PhotonPlan::gather_parameters(std::uint64_t records, std::uint32_t order) const {
  PhotonClusterGatherParameters p{};
  p.records = cache_.gather_parameters(records, strata_);
  p.records.samples.filter = PATH_CLASS_DIFFUSE | PATH_CLASS_CAUSTIC | PATH_CLASS_MIXED;
  p.records.samples.clamp = limit();
  p.estimate = estimate(kGatherNeighbours);
  p.cut_depth = cut_depth();
  p.order = order;
  return p;
}

// Stage `name`: records of those of the `count` places that are new. `shared`: other frames read them as well.
void PhotonPlan::gather_new(Places& places, std::uint64_t count, std::uint64_t given, const std::string& name,
                            bool shared) {
  places.places.check_facts(count >= given, std::to_string(count) + " places of " + std::to_string(given) + " given");
  places.count = count;
  if (count == given) return;
  PhotonClusterGatherParameters p = gather_parameters(count - given, 0);
  p.records.first_place = low(given);
  std::vector<Graph::Input> inputs = light_of(map_);
  inputs.push_back({"places", places.places});
  StageSpec spec = PixelCache::gathering(name, "photon_cluster_gather", kFirst, count - given, strata_);
  spec.output.reusable = shared;
  places.gathered = graph_.add(std::move(spec), p, std::move(inputs));
}

// The sample points that this camera needs beside those of the cameras before it, and the light that arrives at them.
// They know nothing of the frame that asks.
void PhotonPlan::extend(std::size_t camera) {
  PhotonExtendParameters p{};
  p.points = cache_.camera_point_parameters(cameras_[camera], camera, SPLAT_LEVEL);
  p.clusters = cluster_parameters(p.points.width, p.points.height, p.points.samples);
  std::vector<Graph::Input> inputs;
  if (camera > 0) inputs.push_back({"given", before_[camera - 1].places});
  before_[camera].places =
      graph_.add(shared_choice(numbered("photon.extend", camera), "photon_extend"), p, std::move(inputs));
  graph_.when(places_and_light(camera + 1), [this, camera] {
    gathered_ = checked_map(map_);
    const std::uint64_t given = camera > 0 ? before_[camera - 1].count : 0;
    Places& clusters = before_[camera];
    gather_new(clusters, checked_places(clusters.places, given).places, given, numbered("photon.extend_gather", camera),
               true);
    gathered_cameras_ = camera + 1;
    refine_next();
  });
}

// Sample points of so many cameras, and what their rays read.
std::vector<Artifact> PhotonPlan::places_and_light(std::size_t cameras) const {
  std::vector<Artifact> all = {cut_ ? cut_ : map_};
  for (std::size_t k = 0; k < cameras; ++k) all.push_back(before_[k].places);
  return all;
}

// A stage that chooses places, which other frames share.
StageSpec PhotonPlan::shared_choice(const std::string& name, const char* kind) const {
  StageSpec spec = cache_.choosing(name, kind, kFirst);
  spec.output.most_records = 0xffffffffu;
  spec.output.reusable = true;
  return spec;
}

// What this frame shows and no camera before did. Of a frame that stands alone that is all.
void PhotonPlan::gather_own() {
  gathered_ = checked_map(map_);
  const std::uint64_t given = before_.empty() ? 0 : before_.back().count;
  clusters_ = checked_places(own_.places, given);
  if (clusters_.places == 0) return show_clusters({}, 0);
  gather_new(own_, clusters_.places, given, "photon.cluster_gather", false);
  gathered_cameras_ = std::max<std::size_t>(gathered_cameras_, 1);
  refine_next();
}

// Cameras are refined one after the other, each in rounds that know what the rounds before have gathered. The picture
// itself is, where it has no cameras. After all of it, the picture is shaded.
void PhotonPlan::refine_next() {
  const std::size_t number = refined_.size(), camera = number / rounds();
  if (refining_) return;
  if (number == rounds() * std::max<std::size_t>(1, before_.size())) {
    if (clusters_.places > 0) shade_clusters();
    return;
  }
  if (camera >= gathered_cameras_) return;
  std::vector<Graph::Input> inputs;
  if (before_.empty()) add_records(own_, inputs);
  for (std::size_t k = 0; k < before_.size() && k <= camera; ++k) add_records(before_[k], inputs);
  for (const Places& refined : refined_) add_records(refined, inputs);
  if (inputs.empty()) {  // nothing is seen
    refined_.emplace_back();
    return refine_next();
  }
  if (number > 0 && refined_.back().places) inputs.push_back({"given", refined_.back().places});
  refining_ = true;
  refined_.push_back({ask_refinement(camera, number % rounds(), std::move(inputs)), {}, 0});
  graph_.when({refined_.back().places}, [this, number, camera] {
    Places& refined = refined_[number];
    const std::uint64_t given = number > 0 ? refined_[number - 1].count : 0;
    const std::string name = before_.empty() ? numbered("photon.cluster_gather", number + 1)
                                             : numbered(numbered("photon.refine_gather", camera), number % rounds());
    gather_new(refined, refined.places.record_count(), given, name, !before_.empty());
    refining_ = false;
    refine_next();
  });
}

Artifact PhotonPlan::ask_refinement(std::size_t camera, std::size_t round, std::vector<Graph::Input> inputs) {
  if (before_.empty()) {
    inputs.push_back({"points", points_});
    StageSpec spec = cache_.choosing(numbered("photon.cluster_refine", round), "photon_cluster_refine", kFirst);
    return graph_.add(std::move(spec), refine_parameters(settings_.width, settings_.height, cache_.samples(), round),
                      std::move(inputs));
  }
  PhotonExtendRefineParameters p{};
  p.points = cache_.camera_point_parameters(cameras_[camera], camera, SPLAT_LEVEL);
  p.refine = refine_parameters(p.points.width, p.points.height, p.points.samples, round);
  return graph_.add(shared_choice(numbered(numbered("photon.extend_refine", camera), round), "photon_extend_refine"), p,
                    std::move(inputs));
}

void PhotonPlan::add_records(const Places& places, std::vector<Graph::Input>& inputs) {
  if (places.gathered) inputs.push_back({numbered("records", inputs.size()), places.gathered});
}

// All records as one cache.
void PhotonPlan::shade_clusters() {
  std::vector<Graph::Input> records;
  for (const Places& before : before_) add_records(before, records);
  add_records(own_, records);
  for (const Places& refined : refined_) add_records(refined, records);
  const Artifact cache = graph_.add({.name = "photon.cluster_smooth",
                                     .kind = "photon_cluster_smooth",
                                     .items = 1,
                                     .solo = true,
                                     .priority = kFirst,
                                     .output = {.record_bytes = CACHE_WORDS * 4,
                                                .counted = true,
                                                .most_records = low(clusters_.places + refined()),
                                                .placement = Placement::retain}},
                                    PhotonClusterSmoothParameters{}, std::move(records));
  const Artifact shaded = cache_.ask_shading(graph_, "photon.shade", kFirst, points_, cache);
  cache_.preview(graph_, film_, shaded);
  graph_.when({shaded}, [this, shaded] { show_clusters(cache_.picture_of(shaded.records()), kRecordNoise); });
}

Artifact PhotonPlan::choose_lobe_places(const Artifact& points) {
  PhotonClusterParameters p = cluster_parameters(settings_.width, settings_.height, cache_.samples());
  p.whole = 1;
  return graph_.add(shared_choice("photon.lobe_clusters", "photon_cluster"), p, {{"points", points}});
}

Artifact PhotonPlan::gather_lobes(const Artifact& places) {
  gathered_ = checked_map(map_);
  const std::uint64_t records = checked_places(places, 0).places;
  std::vector<Graph::Input> inputs = light_of(map_);
  inputs.push_back({"places", places});
  return graph_.add(PixelCache::gathering("photon.lobe_gather", "photon_cluster_gather", kFirst, records, strata_,
                                          RADIANCE_WORDS(photon_.order)),
                    gather_parameters(records, photon_.order), std::move(inputs));
}

// Light on rough lobes by sample points of their own, of which harmonics tell from where it comes (section 3.4,
// "Representing Radiance Fields using SH"). Lobes that are too sharp for that stay the paths'.
void PhotonPlan::begin_lobes() {
  std::vector<Artifact> until = places_and_light(0);
  if (rays_known_) until.push_back(rays_known_);
  lobes_.begin({.method = "photon",
                .order = photon_.order,
                .least_order = photon_.order,
                .free_scatterings = SPLAT_LEVEL,
                .priority = kFirst,
                .choose = [this](const Artifact& points) { return choose_lobe_places(points); },
                .until = std::move(until),
                .gather = [this](const Artifact& places) { return gather_lobes(places); }},
               [this](const std::vector<float>& picture) { show_clusters(picture, kLobeNoise); });
}

// The clusters' light, of layers and lobes, is a part of every pass of caustics, and a pass of its own where there is
// none. `noise`: of a record of one ray.
void PhotonPlan::show_clusters(const std::vector<float>& picture, double noise) {
  if (settings_.target_error > 0) own_light_.add(picture, noise / std::sqrt(strata_.count()));
  if (!light_.add(picture)) return;
  if (has_caustics())
    beside_->light = light_.take();
  else
    film_.add_pass(light_.take());
  graph_.announce(beside_->known);
  clusters_asked_ = true;
  own_stages_asked_ = caustics_asked_ || !has_caustics();
}

// --- Caustics ---

void PhotonPlan::ask_caustics(std::uint32_t pass) {
  passes_[pass].map =
      ask_map(std::to_string(pass), kFirstPass + pass, photon_.caustics, PHOTON_CLASS_BIT(PHOTON_CAUSTIC));
  graph_.when({passes_[pass].map, guide_}, [this, pass] { shade_caustics(pass); });
}

void PhotonPlan::shade_caustics(std::uint32_t pass) {
  Pass& s = passes_[pass];
  s.facts = checked_map(s.map);
  PhotonCausticsParameters p{};
  p.camera = settings_.camera;
  p.width = settings_.width;
  p.height = settings_.height;
  p.samples = photon_.samples;
  p.pass = pass;
  p.seed_low = low(settings_.seed);
  p.seed_high = high(settings_.seed);
  p.depth = settings_.depth;
  p.estimate = estimate(kCausticNeighbours);
  // Squared radii: of pass i + 1 over pass i, (i + shrinkage) / (i + 1), passes counted from 1.
  double squared = 1;
  for (std::uint32_t i = 1; i <= pass; ++i) squared *= (i + kShrinkage) / (i + 1);
  p.shrink = static_cast<float>(std::sqrt(squared));
  const Artifact shaded = graph_.add({.name = numbered("photon.caustics", pass),
                                      .kind = "photon_caustics",
                                      .items = pixels(),
                                      .priority = kFirst,
                                      .work = static_cast<double>(pixels()) * photon_.samples,
                                      .output = {.record_bytes = 12, .floats = true}},
                                     p, {{"guide", guide_}, {"map", s.map}});
  s.map = {};
  if (first_caustics_ && pass == 0)
    graph_.when({shaded}, [this, shaded] {
      // Of a pass; radii shrink, so that variance falls by less than the passes' number.
      own_light_.add(float_view(shaded.records()),
                     std::pow(passes_.size(), -kShrinkage / 2) / std::sqrt(kCausticNeighbours));
      graph_.announce(first_caustics_);
    });
  preview_pass(shaded);
  add_pass(shaded, beside_);
  if (pass > 0 || !seen_ || photon_.given.passes) return ask_caustics_after(pass);
  graph_.when({shaded, seen_}, [this, shaded] {
    choose_passes(shaded);
    ask_caustics_after(0);
  });
}

void PhotonPlan::ask_caustics_after(std::uint32_t pass) {
  caustics_asked_ = pass + 1 == passes_.size();
  own_stages_asked_ = caustics_asked_ && (clusters_asked_ || !has_clusters());
  if (caustics_asked_)
    guide_ = {};
  else
    ask_caustics(pass + 1);
}

// Where caustics are little beside the noise of paths, fewer passes are worth their time.
void PhotonPlan::choose_passes(const Artifact& first) {
  OwnLight light;
  light.add(float_view(first.records()), 1 / std::sqrt(kCausticNeighbours));
  first_pass_error_ = std::sqrt(light.squared_error);
  passes_.resize(worthwhile_passes({.sample_error = noise_.sample,
                                    .pass_error = first_pass_error_,
                                    .samples = static_cast<double>(settings_.planned_spp()),
                                    .work = usual_work_,
                                    .pass_work = pass_work()},
                                   low(passes_.size())));
}

// --- The film and the report ---

bool PhotonPlan::conclude(const std::vector<CutStage>& cut) {
  if (!paths_.begun() || (passes() > 0 && film_.passes() == 0)) return false;
  if (!paths_.conclude(cut, skips_)) return false;
  if (has_caustics() && film_.passes() < passes_.size())
    skips_.push_back({"passes of caustics", "the time limit ended the frame", passes_.size() - film_.passes()});
  return true;
}

std::string PhotonPlan::parameters_json() const {
  nlohmann::json photon = {{"count", photon_.count}, {"caustics", photon_.caustics}, {"radius", photon_.radius}};
  if (gathers())
    photon["map"] = {{"photons", gathered_.photons},
                     {"neighbours", estimate(kGatherNeighbours).neighbours},
                     {"radius", gathered_.radius},
                     {"spacing", spacing()}};
  if (is_guided()) {
    const auto told = [](const PhotonGuideFacts& f) {
      return nlohmann::json{{"useful", f.useful}, {"cells", f.cells}, {"most", f.most}};
    };
    photon["guide"] = {{"paths", photon_.guide}};
    if (gathers()) photon["guide"]["map"] = told(map_guide_);
    if (has_caustics()) photon["guide"]["caustics"] = told(caustic_guide_);
  }
  if (noise_.sample > 0) photon["sample_error"] = noise_.sample;
  if (noise_.ray > 0) photon["ray_error"] = noise_.ray;
  if (first_pass_error_ > 0) photon["pass_error"] = first_pass_error_;
  photon["cut"] = photon_.cut;
  if (gathers() && photon_.cut) {
    photon["cut_nodes"] = cut_facts_.nodes;
    photon["cut_opened"] = cut_facts_.opened;
    photon["cut_radius"] = cut_facts_.radius;
  }
  photon["clusters"] = photon_.clusters;
  if (has_clusters()) {
    photon["gather_rays"] = strata_.count();
    photon["points"] = clusters_.points;
    photon["places"] = clusters_.places;
    photon["strays"] = clusters_.strays;
    photon["refined"] = refined();
    if (!cameras_.empty()) {
      photon["cameras"] = cameras_.size();
      photon["kept"] = clusters_.given;
    }
    photon["reach"] = clusters_.reach;
  }
  if (has_lobes()) photon["order"] = photon_.order, photon["lobe_places"] = lobes_.records();
  if (has_caustics()) {
    photon["passes"] = passes_.size();
    photon["samples"] = photon_.samples;
    photon["neighbours"] = estimate(kCausticNeighbours).neighbours;
    std::uint64_t photons = 0;
    for (const Pass& pass : passes_) photons += pass.facts.photons;
    photon["caustic_photons"] = photons;
  }
  nlohmann::json json = paths_.begun() ? paths_.parameters() : nlohmann::json::object();
  json["photon"] = photon;
  return json.dump();
}

std::vector<std::string> PhotonPlan::outline() const {
  std::vector<std::string> lines;
  if (is_guided())
    lines.push_back(
        "photon.trace.pilot: " + std::to_string(photon_.guide) +
        " light paths that tell where photons are of use, split; photon.guide: how densely others begin, solo");
  if (gathers()) {
    lines.push_back("photon.trace.global: " + std::to_string(photon_.count) + " light paths, split");
    lines.push_back("photon.map.global: the tree over their photons, solo");
    if (photon_.cut) lines.push_back("photon.cut: " + std::to_string(photon_.cut) + " nodes that stand for them, solo");
  }
  if (has_clusters() && !cameras_.empty())
    lines.push_back("photon.extend, extend_refine, and gather of both: sample points of " +
                    std::to_string(cameras_.size()) +
                    " cameras, those of one beside what the ones before it have; made once for all pictures");
  if (has_clusters()) {
    lines.push_back("photon.points: " + std::to_string(cache_.samples()) + " surface points of each pixel, in " +
                    std::to_string(cache_.tiles()) + " tiles, split");
    lines.push_back("photon.clusters: " + std::to_string(photon_.clusters) + " clusters of these, solo");
    if (looks_at_noise() && !photon_.given.rays)
      lines.push_back(
          "photon.look: some sample points with few rays, which tell with the first samples how many all get, split");
    lines.push_back("photon.cluster_gather: " + std::to_string(strata_.count()) +
                    " rays of each cluster's sample point, which read the map, split");
    if (cameras_.empty())
      lines.push_back(
          "photon.cluster_refine: sample points more where their records may be off most, at most one for a "
          "cluster, in " +
          std::to_string(rounds()) + " rounds, solo");
    lines.push_back("photon.shade: " + std::to_string(cache_.tiles()) + " tiles lit by the samples near them, split");
  }
  if (has_lobes())
    lines.push_back(
        "photon.lobe_points, lobes, lobe_clusters, lobe_gather, lobe_shade: the same for rough lobes, by incoming "
        "radiance in hemispherical harmonics of order " +
        std::to_string(photon_.order));
  if (has_caustics()) {
    const std::string each = ", for each of " + std::to_string(passes_.size()) + " passes";
    lines.push_back("photon.trace.guide: " + std::to_string(photon_.caustics) +
                    " light paths by mirrors, glass and lobes, split; their map tells how wide caustics are estimated");
    lines.push_back("photon.trace: as many light paths, split" + each);
    lines.push_back("photon.map: the tree over their photons, solo" + each);
    lines.push_back("photon.caustics: " + std::to_string(pixels()) + " pixels of " + std::to_string(photon_.samples) +
                    " samples, split" + each);
  }
  for (const std::string& line : paths_.outline()) lines.push_back(line);
  return lines;
}

}  // namespace

Method photon_method() {
  using enum SettingType;
  return {
      .name = "photon",
      .help =
          "Photon maps: light paths leave photons, whose density tells how bright surfaces are. Carries caustics, of "
          "punctual lights too; explained in docs/explanation/photon.md.",
      .make = make_plan_of<PhotonPlan>,
      // Beside the paths: the passes' sum, its squares, the preview, two passes' records, a picture and the clusters'
      // light, all RGB.
      .bytes_a_pixel = kPathBytesAPixel + 7 * 3 * sizeof(float),
      .settings = {
          {"photon.count", whole, 0, 1u << 24, "an eighth of the samples, 100,000 to 1,000,000",
           "light paths of the map that paths read behind their first surface; 0: no such map, paths go on"},
          {"photon.caustics", whole, 0, 1u << 24, "200000",
           "light paths of each pass of caustics; 0: paths find the caustics"},
          {"photon.passes", whole, 1, 4096, "at most `--spp` / 4, 2 to 64",
           "independent passes of caustics, each of a smaller radius; their mean is the picture"},
          {"photon.clusters", whole, 0, 1u << 20, "4 to 16 times the root of the number of pixels",
           "clusters of the points that pixels show, at whose sample points indirect light on diffuse layers is "
           "gathered and between which it is interpolated; 0: each sample of a pixel gathers by itself"},
          {"photon.cut", whole, 0, PHOTON_MOST_CUT, "4096 for more than 200,000 rays, else 0",
           "nodes of the map's tree that are read in place of its photons, before they are refined; 0: photons are "
           "read"},
          {"photon.gather_rays", whole, 0, SPLAT_MOST_RAYS / 2, "at most 24 times `--spp`, 96 to 1024",
           "rays of each cluster's sample point; 0: no clusters"},
          {"photon.guide", whole, 0, 1u << 24, "0",
           "light paths that tell where photons are of use: others begin where more of them are, and count for less; "
           "0: "
           "light paths begin by power alone"},
          {"photon.order", whole, 0, SPLAT_MOST_ORDER, "4",
           "order of hemispherical harmonics in which clusters' sample points carry light on rough lobes (alpha, "
           "roughness squared, of 0.9 over the order and more, and of 0.2); 0: paths find that light"},
          {"photon.radius", real, 0, 1e9, "0",
           "metres: of density estimates (of caustics: of the first pass); 0: as wide as the nearest photons lie"},
      }};
}

}  // namespace gleaner::coordinator

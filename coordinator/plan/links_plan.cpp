#include "coordinator/plan/links_plan.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <limits>
#include <nlohmann/json.hpp>
#include <numbers>
#include <span>
#include <utility>

#include "coordinator/plan/graph.h"
#include "coordinator/plan/links_choice.h"
#include "coordinator/plan/path_sampler.h"
#include "coordinator/plan/spread_points.h"
#include "kernels/links_records.h"
#include "kernels/vpl_records.h"
#include "scene/model/error.h"

namespace gleaner::coordinator {
namespace {

using namespace kernels;
using Artifact = Graph::Artifact;

constexpr Extent kOwnItems = Extent::own_items;
// What links follow from: neither lights, nor what glows, nor colours.
constexpr unsigned kShapes = kGeometry | kMaterials;
// Points at which an element's albedo is read.
constexpr std::uint32_t kAlbedoSamples = 16;
// Bounces go on until all that are left would add less than this share of the light, unless a setting says which.
constexpr double kUsualLeastShare = 1e-3;
constexpr std::uint32_t kMostBounces = 64, kUsualBounces = 8;
constexpr std::uint32_t kMostShadeSamples = 16;
// Rays that show where irradiance bends; the test lights' longest wave is about the scene's size.
constexpr std::uint32_t kProbeDirections = 64;
// Rays that tell which vertices lie inside of something.
constexpr std::uint32_t kInsideDirections = 16;
constexpr float kWavesOfScene = 6.0f;
// Samples of a pixel that links of a session's pictures are good for: these keep them, however many samples each has.
constexpr std::uint32_t kSessionSamples = 40;
// Pixels that an audit looks at, and links that are made for a target error, at most.
constexpr std::uint64_t kAuditedPixels = 1024;
constexpr std::uint32_t kAuditedPoints = 4;  // of each
constexpr unsigned kMostLinks = 2;

struct LinksSettings : LinksCounts {
  GivenLinksCounts given;
  std::uint32_t bounces;
  double smooth_angle;  // degrees
  double least_share;   // single precision, as stages are told
  bool refine, compress, exact, solo_exchange, sample_lights, metal;
};

// `triangles`: of the scene.
LinksSettings read_settings(const FrameSettings& settings, double triangles) {
  LinksSettings links{};
  links.given = {.vertices = whole_setting(settings, "links.vertices"),
                 .directions = whole_setting(settings, "links.directions"),
                 .light_samples = whole_setting(settings, "links.light_samples")};
  // All pictures of a session have the same links, whether they are denoised or not.
  const bool one_picture = settings.looks.empty();
  const LinksTarget target{.pixels = std::uint64_t{settings.width} * settings.height,
                           .spp = one_picture ? settings.method_spp() : kSessionSamples,
                           .error = settings.target_error,
                           .denoised = one_picture && settings.denoise != Denoise::off};
  static_cast<LinksCounts&>(links) = choose_links_counts(triangles, target, links.given);
  links.bounces = whole_setting(settings, "links.bounces").value_or(0);
  links.smooth_angle = real_setting(settings, "links.smooth_angle").value_or(0);
  links.least_share =
      double{static_cast<float>(real_setting(settings, "links.least_share").value_or(kUsualLeastShare))};
  links.refine = flag_setting(settings, "links.refine").value_or(true);
  links.compress = flag_setting(settings, "links.compress").value_or(true);
  links.exact = flag_setting(settings, "links.exact_weights").value_or(false);
  links.solo_exchange = flag_setting(settings, "links.solo_exchange").value_or(false);
  links.sample_lights = flag_setting(settings, "links.sample_lights").value_or(false);
  links.metal = flag_setting(settings, "links.metal").value_or(false);
  return links;
}

void check(const FrameSettings& settings) {
  const LinksSettings links = read_settings(settings, 0);
  const auto side = static_cast<std::uint32_t>(std::lround(std::sqrt(links.directions)));
  if (side * side != links.directions || side % 4 != 0)
    throw Error::usage(
        "--set links.directions: expected the square of a multiple of 4 (16, 64, 144, 256, ...), found " +
        std::to_string(links.directions));
  if (links.light_samples % 16 != 0)
    throw Error::usage("--set links.light_samples: expected a multiple of 16, found " +
                       std::to_string(links.light_samples));
}

StageOutput retained(std::size_t record_bytes) {
  return {.record_bytes = static_cast<std::uint32_t>(record_bytes), .placement = Placement::retain};
}
StageOutput retained_words(std::uint64_t most) {
  StageOutput output = retained(4);
  output.counted = true;
  output.most_records = static_cast<std::uint32_t>(std::min<std::uint64_t>(most, 0xffffffffu));
  return output;
}
StageOutput reusable(StageOutput output) {
  output.reusable = true;
  return output;
}

// An element is a side of a vertex: their number has 32 bits.
LinksMeshFacts checked_facts(const Artifact& mesh) {
  const auto facts = mesh.facts<LinksMeshFacts>();
  mesh.check_facts(facts.vertices <= 0x7fffffffu, std::to_string(facts.vertices) + " vertices");
  return facts;
}

class LinksPlan final : public GraphPlan {
 public:
  LinksPlan(const FrameSettings& settings, const SceneSummary& scene)
      : GraphPlan(settings, scene),
        settings_(settings),
        links_(read_settings(settings, static_cast<double>(scene.triangles))),
        paths_(graph_, film_, settings) {
    if (scene.needs.instances)
      throw Error::usage(
          "--method links: expected a scene of copies, found one with instances, whose vertices are one for all "
          "places");
    skips_ = path_skips(scene.needs);
    links_.metal = links_.metal && scene.needs.metallic && scene.needs.glossy;
    posed_ = !scene.lineage.geometry.empty();
    // Lobes are no part of what links of an earlier scene name.
    if (!links_.metal && scene.lineage.earlier_geometry != scene.lineage.geometry)
      earlier_geometry_ = scene.lineage.earlier_geometry;
    triangles_ = static_cast<double>(scene.triangles);
    double diagonal = 0;
    for (std::size_t k = 0; k < 3; ++k)
      diagonal = std::hypot(diagonal, double{scene.rest_bounds.upper[k]} - scene.rest_bounds.lower[k]);
    wave_ = diagonal > 0 ? static_cast<float>(kWavesOfScene / diagonal) : 0.0f;
    // Each vertex of a scattering on a light's way is a bounce, but for the one that the camera sees.
    most_bounces_ = links_.bounces ? links_.bounces : kMostBounces;
    if (settings_.depth) most_bounces_ = std::min(most_bounces_, settings_.depth - 1);
  }

  bool conclude(const std::vector<CutStage>& cut) override {
    // Less than the links' light and the paths' first samples is no picture.
    return (!indirect() || film_.passes() > 0) && paths_.conclude(cut, skips_);
  }
  double predicted_work() const override {
    return paths_.predicted_work() + work_to_come(own_work(), paths_.asked_work());
  }
  double shared_squared_error() const override { return found_ ? found_->upper() : 0; }
  std::vector<std::string> warnings() const override;
  std::string parameters_json() const override;
  std::vector<std::string> outline() const override;

 private:
  std::uint64_t pixels() const { return std::uint64_t{settings_.width} * settings_.height; }
  bool indirect() const { return most_bounces_ > 0; }
  // Whether bounces to come are told by the last ones: where nothing limits them.
  bool adds_tail() const { return !links_.bounces && !settings_.depth; }

  double own_work() const;

  void begin() override;
  void make_links();
  Artifact ask_mesh(const std::string& name, Pose pose, std::uint32_t vertices, std::vector<Graph::Input> inputs);
  void probe(const Artifact& coarse);
  std::string divided_mesh() const { return of_these_links(posed_ ? "rest_mesh" : "mesh"); }
  void pose(const Artifact& divided);
  Artifact ask_probe(const std::string& name, Pose pose, const Artifact& mesh, std::uint32_t directions);
  void link(const LinksMeshFacts& facts);
  void link_elements();
  void make(const LinksParameters& p);
  std::vector<Graph::Input> with_lobes(std::vector<Graph::Input> inputs) const;
  void gather(std::uint32_t bounce);
  void exchange();
  void smooth(const Artifact& gathered, const Artifact& before);
  void audit(const Artifact& irradiance);
  void take_audit(const Artifact& audited, const Artifact& irradiance);
  double wanted_squared_error() const;  // by the samples so far
  std::optional<LinksCounts> better_counts() const;
  void shade(const Artifact& irradiance);
  VplPointParameters point_parameters() const;
  // Whether the links are looked at before paths go on, or so that a denoiser knows what it cannot see.
  bool audits() const { return settings_.target_error > 0 || settings_.denoise != Denoise::off; }
  // Noise bounds what is smoothed, and is not told for nothing.
  std::uint32_t told_directions() const { return links_.smooth_angle > 0 ? links_.directions : 0; }
  std::string of_these_links(const std::string& stage) const {
    return (links_made_ > 1 ? "links.finer_" : "links.") + stage;
  }
  LinksParameters element_parameters() const;
  StageSpec elements(const std::string& name, const char* kind, unsigned scene_parts, const StageOutput& output,
                     double work) const;

  FrameSettings settings_;
  LinksSettings links_;
  PathSampler paths_;
  std::uint32_t most_bounces_ = 0;
  std::uint32_t elements_ = 0, plain_ = 0;  // all, and the mesh's: those behind them are of lobes
  std::uint64_t link_words_ = 0;
  double triangles_ = 0;  // of the scene
  bool posed_ = false;    // other triangles are shown than the base at rest has
  // Digest of the geometry whose links are used, while those of the geometry that is shown are made elsewhere.
  std::optional<std::string> earlier_geometry_;
  bool linked_ = false;  // the mesh is known
  float wave_ = 0;       // 1/m
  LinksMeshFacts mesh_facts_{};
  Artifact divided_, mesh_, probe_, lobes_, albedo_, made_, light_, sent_;
  Artifact before_;  // what the last bounce read
  unsigned links_made_ = 0;
  std::optional<LinksError> found_;  // of the last links
  Artifact errors_known_;            // an event, where a target error is given: paths may go on
  double wanted_squared_error_ = 0;  // of the whole picture, where one is given
  LinksBounces bounces_;
};

void LinksPlan::begin() {
  if (!indirect()) {
    paths_.begin({});
    return;
  }
  // Samples for a target error are as many as the links leave to them.
  if (settings_.target_error > 0) errors_known_ = graph_.event();
  paths_.begin({.classes = links_.metal           ? PATH_CLASS_METAL_RADIOSITY
                           : links_.sample_lights ? PATH_CLASS_SAMPLED_RADIOSITY
                                                  : PATH_CLASS_RADIOSITY,
                .limit = std::numeric_limits<float>::infinity(),
                .known = errors_known_});
  make_links();
}

void LinksPlan::make_links() {
  ++links_made_;
  bounces_ = {};
  linked_ = false;
  bounces_.adds_tail = adds_tail();
  mesh_ = probe_ = lobes_ = albedo_ = made_ = light_ = sent_ = before_ = {};
  if (!links_.refine || links_.vertices == 0) {
    pose(ask_mesh(divided_mesh(), Pose::rest, links_.vertices, {}));
    return;
  }
  // Half of the vertices lie evenly, and show where the others are needed.
  const Artifact coarse = ask_mesh(of_these_links("coarse_mesh"), Pose::rest, std::max(1u, links_.vertices / 2), {});
  graph_.when({coarse}, [this, coarse] { probe(coarse); });
}

// Triangles are divided as they are at rest, so that a vertex of what moves or deforms stays the same from frame to
// frame, and no frame but the first looks for where irradiance bends. `divided`: the mesh at rest.
void LinksPlan::pose(const Artifact& divided) {
  divided_ = divided;
  mesh_ = posed_ ? ask_mesh(of_these_links("mesh"), Pose::shown, 0, {{"divided", divided}}) : divided;
  graph_.when({mesh_}, [this] { link(checked_facts(mesh_)); });
}

// All that the links take. Before the mesh is known it is expected to have the vertices that were asked for, or as many
// as closed surfaces of the scene's triangles.
double LinksPlan::own_work() const {
  if (!indirect()) return 0;
  const double wanted = links_.vertices, own = own_vertices(triangles_);
  const double elements = linked_ ? elements_ : 2 * (links_.beside_own ? wanted + own : std::max(wanted, own));
  const double bounces = std::min(most_bounces_, kUsualBounces);
  const double probes = kInsideDirections + (links_.refine ? kProbeDirections / 2.0 : 0);
  return elements * (probes + links_.directions + links_.light_samples + 1 + bounces) + static_cast<double>(pixels());
}

Artifact LinksPlan::ask_mesh(const std::string& name, Pose pose, std::uint32_t vertices,
                             std::vector<Graph::Input> inputs) {
  StageSpec mesh{.name = name,
                 .kind = "links_mesh",
                 .items = 1,
                 .solo = true,
                 .scene_parts = kGeometry,
                 .pose = pose,
                 .priority = kFirst,
                 .output = reusable(retained_words(0xffffffffu))};
  return graph_.add(std::move(mesh), LinksMeshParameters{vertices, links_.beside_own ? 1u : 0u, {}}, std::move(inputs));
}

void LinksPlan::probe(const Artifact& coarse) {
  const LinksMeshFacts facts = checked_facts(coarse);
  if (facts.divided == 0) {
    // Nothing is measured where no triangle is divided.
    pose(coarse);
    return;
  }
  elements_ = 2 * facts.vertices;
  const Artifact probed = ask_probe(of_these_links("coarse_probe"), Pose::rest, coarse, kProbeDirections);
  pose(ask_mesh(divided_mesh(), Pose::rest, links_.vertices, {{"coarse", coarse}, {"probe", probed}}));
}

Graph::Artifact LinksPlan::ask_probe(const std::string& name, Pose pose, const Artifact& mesh,
                                     std::uint32_t directions) {
  LinksParameters p = element_parameters();
  p.directions = directions;
  p.wave = wave_;
  p.divided = pose == Pose::rest ? 1u : 0u;  // where levels are looked for: of what is not divided nothing is measured
  StageSpec probe = elements(name, "links_probe", kShapes, reusable(retained(PROBE_WORDS * 4)), directions);
  probe.pose = pose;
  return graph_.add(std::move(probe), p, {{"mesh", mesh}});
}

LinksParameters LinksPlan::element_parameters() const {
  LinksParameters p{};
  p.elements = elements_;
  p.directions = 16;  // read by links_make alone
  p.samples = 16;
  p.seed_low = low(settings_.seed);
  p.seed_high = high(settings_.seed);
  return p;
}

// `work`: of an element, in rays.
StageSpec LinksPlan::elements(const std::string& name, const char* kind, unsigned scene_parts,
                              const StageOutput& output, double work) const {
  return {.name = name,
          .kind = kind,
          .items = elements_,
          .tile = 2,
          .scene_parts = scene_parts,
          .priority = kFirst,
          .work = work * elements_,
          .output = output};
}

void LinksPlan::link(const LinksMeshFacts& facts) {
  mesh_facts_ = facts;
  linked_ = true;
  elements_ = plain_ = 2 * facts.vertices;
  if (elements_ == 0) {
    skips_.push_back({"links", "the scene has no surface", 1});
    if (errors_known_) graph_.announce(errors_known_);
    film_.add_pass({});
    return;
  }
  probe_ = ask_probe(of_these_links("probe"), Pose::shown, mesh_, kInsideDirections);
  if (!links_.metal) {
    link_elements();
    return;
  }
  StageSpec lobes{.name = of_these_links("lobes"),
                  .kind = "links_lobes",
                  .items = 1,
                  .solo = true,
                  .scene_parts = kShapes,
                  .priority = kFirst,
                  .output = reusable(retained_words(0xffffffffu))};
  const Artifact found = graph_.add(std::move(lobes), LinksLobesParameters{plain_, {}}, {{"mesh", mesh_}});
  graph_.when({found}, [this, found] {
    const std::uint64_t all = plain_ + std::uint64_t{LOBE_BINS} * found.facts<LinksLobesFacts>().lobes;
    found.check_facts(all <= 0xffffffffu, std::to_string(all) + " elements");
    if (all > plain_) lobes_ = found;
    elements_ = static_cast<std::uint32_t>(all);
    link_elements();
  });
}

std::vector<Graph::Input> LinksPlan::with_lobes(std::vector<Graph::Input> inputs) const {
  if (lobes_) inputs.push_back({"lobes", lobes_});
  return inputs;
}

void LinksPlan::link_elements() {
  LinksParameters p = element_parameters();
  p.samples = kAlbedoSamples;
  albedo_ = graph_.add(
      elements(of_these_links("albedo"), "links_albedo", kShapes | kColors, reusable(retained(ALBEDO_WORDS * 4)), 1), p,
      with_lobes({{"mesh", mesh_}}));
  p = element_parameters();
  p.directions = links_.directions;
  p.compress = links_.compress;
  p.exact = links_.exact;
  p.hidden_directions = hidden_directions(links_.directions);
  make(p);
  p = element_parameters();
  p.samples = links_.light_samples;
  light_ = graph_.add(elements(of_these_links("light"), "links_light", kWholeScene,
                               reusable(retained(RADIOSITY_WORDS * 4)), links_.light_samples),
                      p, with_lobes({{"mesh", mesh_}, {"albedo", albedo_}}));
  sent_ = light_;
  graph_.when({made_}, [this, made = made_] { link_words_ = made.record_count(); });
  if (links_.solo_exchange)
    exchange();
  else
    gather(1);
}

// Vertices are those of the base at rest, so that links of an earlier scene are between the same elements.
void LinksPlan::make(const LinksParameters& p) {
  Artifact mesh = mesh_, probe = probe_;
  std::string name = "make";
  if (earlier_geometry_) {
    name = "earlier_make";
    if (!earlier_geometry_->empty())
      mesh = ask_mesh(of_these_links("earlier_mesh"), Pose::earlier, 0, {{"divided", divided_}});
    else
      mesh = divided_;
    probe = ask_probe(of_these_links("earlier_probe"), Pose::earlier, mesh, kInsideDirections);
  }
  StageSpec links =
      elements(of_these_links(name), "links_make", kShapes,
               reusable(retained_words(std::uint64_t{lobes_ ? 12u : 6u} * links_.directions)), links_.directions);
  if (earlier_geometry_) links.pose = Pose::earlier;
  made_ = graph_.add(std::move(links), p, with_lobes({{"mesh", mesh}, {"probe", probe}}));
}

// All bounces on one worker, which fetches the links that others made.
void LinksPlan::exchange() {
  StageSpec all = elements(of_these_links("exchange"), "links_exchange", kNoScene,
                           reusable(retained(RADIOSITY_WORDS * 4)), std::min(most_bounces_, kUsualBounces));
  all.solo = true;
  const LinksExchangeParameters p{elements_,
                                  links_.exact ? 1u : 0u,
                                  most_bounces_,
                                  links_.bounces ? 0.0f : static_cast<float>(links_.least_share),
                                  told_directions(),
                                  plain_,
                                  adds_tail() ? 1u : 0u,
                                  0};
  const Artifact exchanged = graph_.add(
      std::move(all), p, with_lobes({{"mesh", mesh_}, {"links", made_}, {"light", light_}, {"albedo", albedo_}}));
  graph_.when({exchanged}, [this, exchanged] {
    const auto facts = exchanged.facts<LinksExchangeFacts>();
    bounces_.done = facts.bounces;
    bounces_.left = facts.left;
    smooth(exchanged, {});
  });
}

void LinksPlan::gather(std::uint32_t bounce) {
  const Artifact earlier = std::exchange(before_, sent_);
  sent_ = graph_.add(elements(numbered(of_these_links("gather"), bounce), "links_gather", kNoScene,
                              reusable(retained(RADIOSITY_WORDS * 4)), 1),
                     LinksGatherParameters{elements_, links_.exact ? 1u : 0u, told_directions(), plain_},
                     {{"links", made_, kOwnItems},
                      {"light", light_, kOwnItems},
                      {"albedo", albedo_, kOwnItems},
                      {"radiosity", before_}});
  if (bounce < (links_.bounces ? most_bounces_ : std::min(bounces_.next, most_bounces_))) {
    gather(bounce + 1);
    return;
  }
  if (bounce == most_bounces_) {
    bounces_.done = bounce;
    smooth(sent_, {});
    return;
  }
  StageSpec flux{.name = numbered(of_these_links("flux"), bounce),
                 .kind = "links_flux",
                 .items = 1,
                 .solo = true,
                 .scene_parts = kNoScene,
                 .priority = kFirst,
                 .output = reusable(retained_words(1))};
  const Artifact measured =
      graph_.add(std::move(flux), LinksFluxParameters{elements_, {}},
                 with_lobes({{"mesh", mesh_}, {"radiosity", sent_}, {"before", before_}, {"earlier", earlier}}));
  graph_.when({measured}, [this, bounce, measured] {
    if (bounces_.is_enough(measured.facts<LinksFluxFacts>(), links_.least_share))
      smooth(sent_, before_);
    else
      gather(bounce + 1);
  });
}

// What pixels see is smoothed; what flows over the links is not. `before`: the bounce before the last one, where
// bounces to come are still to be added.
void LinksPlan::smooth(const Artifact& gathered, const Artifact& before) {
  const bool smooths = links_.smooth_angle > 0;
  LinksSmoothParameters smooth{};
  smooth.elements = elements_;
  smooth.least_cosine = smooths ? static_cast<float>(std::cos(links_.smooth_angle * std::numbers::pi / 180)) : 2.0f;
  std::vector<Graph::Input> inputs = {{"mesh", mesh_}, {"probe", probe_}, {"irradiance", gathered}};
  if (before && adds_tail()) {
    std::ranges::copy(bounces_.tail, smooth.tail);
    inputs.push_back({"before", before});
  }
  before_ = {};
  StageSpec smoothing =
      elements(of_these_links("smooth"), "links_smooth", kNoScene, reusable(retained(RADIOSITY_WORDS * 4)), 0);
  smoothing.solo = true;
  const Artifact irradiance = graph_.add(std::move(smoothing), smooth, std::move(inputs));
  if (audits())
    audit(irradiance);
  else
    shade(irradiance);
}

VplPointParameters LinksPlan::point_parameters() const {
  VplPointParameters p{};
  p.camera = settings_.camera;
  p.width = settings_.width;
  p.height = settings_.height;
  p.samples = std::min(std::bit_floor(settings_.planned_spp()), kMostShadeSamples);
  p.seed_low = low(settings_.seed);
  p.seed_high = high(settings_.seed);
  p.items_low = static_cast<std::uint32_t>(pixels());
  p.depth = settings_.depth;
  p.stride = 1;
  p.clamp = std::numeric_limits<float>::infinity();
  return p;
}

// Points of a few pixels are lit by the vertices about it, and by rays of its own.
void LinksPlan::audit(const Artifact& irradiance) {
  VplPointParameters points = point_parameters();
  points.points = points.samples = kAuditedPoints;
  spread_points(points, kAuditedPixels);
  const Artifact shown = graph_.add({.name = of_these_links("audit_points"),
                                     .kind = "vpl_points",
                                     .items = points.items_low,
                                     .tile = 16,
                                     .scene_parts = kSurfaces,
                                     .priority = kFirst,
                                     .output = retained(POINT_WORDS * 4)},
                                    points);
  LinksParameters p = element_parameters();
  p.elements = points.items_low;
  p.directions = audit_directions(links_.directions);
  // Rays of its own, whatever the vertices' are.
  p.seed_high ^= 0x80000000u;
  std::vector<Graph::Input> inputs =
      with_lobes({{"mesh", mesh_}, {"probe", probe_}, {"irradiance", irradiance}, {"points", shown}});
  if (lobes_) inputs.push_back({"albedo", albedo_});
  const Artifact audited = graph_.add({.name = of_these_links("audit"),
                                       .kind = "links_audit",
                                       .items = points.items_low,
                                       .priority = kFirst,
                                       .work = 2.0 * points.items_low * p.directions,
                                       .output = {.record_bytes = AUDIT_WORDS * 4, .floats = true}},
                                      p, std::move(inputs));
  // How much error that is, the picture's mean says, of which the first samples know the rest.
  graph_.when({audited, paths_.first_samples()}, [this, audited, irradiance] { take_audit(audited, irradiance); });
}

void LinksPlan::take_audit(const Artifact& audited, const Artifact& irradiance) {
  found_ = links_error(float_view(audited.records()), kAuditedPoints, links_);
  if (const std::optional<LinksCounts> better = better_counts()) {
    static_cast<LinksCounts&>(links_) = *better;
    make_links();
    return;
  }
  if (errors_known_) {
    paths_.tell(found_->mean, found_->upper());
    graph_.announce(errors_known_);
    wanted_squared_error_ = wanted_squared_error();
  }
  shade(irradiance);
}

double LinksPlan::wanted_squared_error() const {
  return std::pow(settings_.target_error * (film_.mean_radiance() + found_->mean), 2);
}

std::optional<LinksCounts> LinksPlan::better_counts() const {
  if (!(settings_.target_error > 0) || links_made_ == kMostLinks) return std::nullopt;
  // More than there are, which are the scene's own and those that were asked for.
  LinksCounts counts = links_;
  counts.vertices = links_.beside_own ? mesh_facts_.vertices : std::max(counts.vertices, mesh_facts_.vertices);
  counts.beside_own = false;
  std::optional<LinksCounts> better = better_links_counts(counts, *found_, wanted_squared_error(), links_.given);
  if (better && better->vertices <= counts.vertices) {
    better->vertices = links_.vertices;
    better->beside_own = links_.beside_own;
  }
  return better;
}

std::vector<std::string> LinksPlan::warnings() const {
  std::vector<std::string> warnings = paths_.warnings();
  if (found_ && settings_.target_error > 0 && found_->upper() > wanted_squared_error_)
    warnings.push_back("the light between vertices alone is predicted to be off by more than the target error of " +
                       std::to_string(settings_.target_error));
  return warnings;
}

void LinksPlan::shade(const Artifact& irradiance) {
  const VplPointParameters p = point_parameters();
  StageSpec spec{.name = "links.shade",
                 .kind = "links_shade",
                 .items = pixels(),
                 .tile = 16,
                 .priority = kFirst,
                 .output = {.record_bytes = 12, .floats = true}};
  const Artifact shaded = graph_.add(std::move(spec), p, {{"mesh", mesh_}, {"irradiance", irradiance}});
  divided_ = mesh_ = probe_ = lobes_ = albedo_ = made_ = light_ = sent_ = {};
  preview_pass(shaded);
  add_pass(shaded);
  own_stages_asked_ = true;
}

std::string LinksPlan::parameters_json() const {
  nlohmann::json json = paths_.parameters();
  json["links"] = {{"vertices", mesh_facts_.vertices},
                   {"triangles_divided", mesh_facts_.divided},
                   {"directions", links_.directions},
                   {"light_samples", links_.light_samples},
                   {"bounces", bounces_.done},
                   {"left_after_bounces", bounces_.left},
                   {"lobe_elements", elements_ - plain_},
                   {"hidden_directions", hidden_directions(links_.directions)},
                   {"of_earlier_geometry", earlier_geometry_.has_value()},
                   {"bytes", link_words_ * 4}};
  if (found_) {
    nlohmann::json& links = json["links"];
    links["made"] = links_made_;
    links["mean"] = found_->mean;
    links["audited_mean"] = found_->truth;
    if (found_->mean > 0) {
      links["error"] = std::sqrt(std::max(0.0, found_->square)) / found_->mean;
      links["error_upper"] = std::sqrt(found_->upper()) / found_->mean;
      links["error_of_directions"] = std::sqrt(found_->noise) / found_->mean;
      links["error_of_interpolation"] = std::sqrt(found_->interpolation()) / found_->mean;
    }
  }
  return json.dump();
}

std::vector<std::string> LinksPlan::outline() const {
  std::vector<std::string> lines;
  if (indirect()) {
    const std::string own = "the triangles' own", about = "about " + std::to_string(links_.vertices) + " vertices";
    const std::string wanted = !links_.vertices    ? own + " vertices"
                               : links_.beside_own ? about + " beside " + own
                                                   : about;
    if (links_.refine && links_.vertices)
      lines.push_back("links.coarse_mesh and links.coarse_probe: where irradiance bends, solo and split");
    lines.push_back("links.mesh: " + wanted + ", solo");
    lines.push_back("links.probe: which of them lie inside of something, split");
    lines.push_back("links.albedo: what each side of them reflects, split");
    lines.push_back("links.make: " + std::to_string(links_.directions) + " directions of each side, split");
    lines.push_back("links.light: " + std::to_string(links_.light_samples) + " light samples of each side, split");
    const std::string bounces = links_.bounces
                                    ? std::to_string(most_bounces_)
                                    : "until those to come are known, at most " + std::to_string(most_bounces_);
    lines.push_back(links_.solo_exchange ? "links.exchange: bounces, solo: " + bounces
                                         : "links.gather.1 and on: a bounce each, split: " + bounces);
    lines.push_back("links.smooth: " +
                    (links_.smooth_angle > 0 ? "within edges of " + std::to_string(links_.smooth_angle) + " degrees"
                                             : std::string("vertices that hang on edges")) +
                    ", solo");
    if (audits())
      lines.push_back("links.audit_points, links.audit: how far the light between vertices is off, by rays of " +
                      std::to_string(std::min(pixels(), kAuditedPixels)) + " pixels or a few more, split");
    lines.push_back("links.shade: " + std::to_string(pixels()) + " pixels, split");
  }
  for (const std::string& line : paths_.outline()) lines.push_back(line);
  return lines;
}

}  // namespace

Method links_method() {
  using enum SettingType;
  return {
      .name = "links",
      .help =
          "Radiance links between vertices, explained in docs/explanation/links.md: links are made once, and light "
          "flows through them, bounce by bounce. * What is not set is chosen for the scene's triangles, and --spp or "
          "--target-error.",
      .make = make_plan_of<LinksPlan>,
      // Beside the paths: the pass, its square, the preview and the records, all RGB.
      .bytes_a_pixel = kPathBytesAPixel + 4 * 3 * sizeof(float),
      .check = check,
      .takes_instances = false,
      .settings = {
          {"links.vertices", whole, 0, 1u << 24, "*",
           "triangles are divided until there are about so many vertices; 0: the scene's own vertices"},
          {"links.refine", flag, 0, 1, "1", "0: triangles are divided evenly, not where the light bends most"},
          {"links.smooth_angle", real, 0, 180, "0",
           "irradiance is smoothed, as far as its noise allows, over neighbours whose normals differ by less than so "
           "many "
           "degrees; 0: it is not"},
          {"links.directions", whole, 16, LINKS_MOST_DIRECTIONS, "*",
           "rays of each side of a vertex: the square of a multiple of 4"},
          {"links.light_samples", whole, 16, LINKS_MOST_SAMPLES, "*",
           "shadow rays of each side of a vertex, a multiple of 16"},
          {"links.bounces", whole, 0, 1024, "0",
           "bounces of indirect light, and none beyond; 0: until those to come are told to links.least_share"},
          {"links.least_share", real, 1e-6, 0.5, "0.001; of a session's first pictures 0.01",
           "share of the light that what is told of bounces to come may be off by; with --depth, that they may add"},
          {"links.solo_exchange", flag, 0, 1, "0; in a session 1",
           "1: one worker exchanges all bounces, to which the links travel once; 0: each bounce is shared out"},
          {"links.sample_lights", flag, 0, 1, "0; of a session's first pictures 1",
           "1: where every surface is diffuse, direct light comes by light samples alone: fewer rays, more noise "
           "near lamps"},
          {"links.metal", flag, 0, 1, "0",
           "1: vertices of rough metal (half metal or more, of roughness 0.45 or more) send light on by direction; 0: "
           "that "
           "light is left to paths"},
          {"links.compress", flag, 0, 1, "1", "0: links of the same ends are kept apart"},
          {"links.exact_weights", flag, 0, 1, "0", "1: weights are floats instead of 16 bits"},
      }};
}

}  // namespace gleaner::coordinator

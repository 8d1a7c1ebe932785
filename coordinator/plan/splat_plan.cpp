#include "coordinator/plan/splat_plan.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <nlohmann/json.hpp>

#include "coordinator/plan/graph.h"
#include "coordinator/plan/path_sampler.h"
#include "coordinator/plan/pixel_cache.h"
#include "kernels/splat_records.h"
#include "scene/model/error.h"

namespace gleaner::coordinator {
namespace {

using namespace kernels;
using Artifact = Graph::Artifact;

constexpr std::uint32_t kUsualRays = 1024;
constexpr double kUsualAccuracy = 0.15;
constexpr std::uint32_t kMostProbeRays = 256;
// Bounds of R_k, in pixels: with an accuracy of 0.15 a record reaches 1.5 pixels at least, and of a picture of 512
// pixels 38 at most.
constexpr float kLeastRadius = 10, kMostRadiusOfWidth = 0.5f;
// The cache's stages wait for each other, paths for nothing: these fill what the others leave free.
constexpr int kFirst = 1;

struct SplatSettings {
  double accuracy;
  std::uint32_t rays, bounces, records;
};

SplatSettings read_settings(const FrameSettings& settings) {
  SplatSettings s{};
  s.accuracy = real_setting(settings, "splat.accuracy").value_or(kUsualAccuracy);
  s.rays = whole_setting(settings, "splat.gather_rays").value_or(kUsualRays);
  s.bounces = whole_setting(settings, "splat.bounces").value_or(0);
  s.records = whole_setting(settings, "splat.new_records").value_or(0);
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
        cache_(settings),
        paths_(graph_, film_, settings) {
    skips_ = path_skips(scene.needs);
    if (settings.depth == 1)
      skips_.push_back({"the cache", "a depth of 1 is direct light alone", 1});
    else if (!splat_.rays)
      skips_.push_back({"the cache", "splat.gather_rays is 0: paths find all light", 1});
  }

  bool conclude(const std::vector<CutStage>& cut) override {
    // Less than the cache's light and the paths' first samples is no picture.
    return (!caches() || film_.passes() > 0) && paths_.conclude(cut, skips_);
  }
  double predicted_work() const override {
    return paths_.predicted_work() + work_to_come(own_work(), paths_.asked_work());
  }
  std::vector<std::string> warnings() const override;
  std::string parameters_json() const override;
  std::vector<std::string> outline() const override;

 private:
  bool caches() const { return settings_.depth != 1 && splat_.rays > 0; }
  // Most scatterings on the light's way; 0: no limit.
  std::uint32_t depth() const {
    const std::uint32_t most = splat_.bounces ? splat_.bounces + 1 : 0;
    return most && settings_.depth ? std::min(most, settings_.depth) : std::max(most, settings_.depth);
  }

  double own_work() const;

  void begin() override;
  Artifact ask_places(const Artifact& points);
  void gather(const Artifact& points, const Artifact& places);

  FrameSettings settings_;
  SplatSettings splat_;
  Strata strata_;
  PixelCache cache_;
  PathSampler paths_;
  SplatSelectFacts facts_{};
  bool chosen_ = false;  // facts_ are known
};

void SplatPlan::begin() {
  if (!caches()) {
    paths_.begin({});
    return;
  }
  paths_.begin({.classes = PATH_CLASS_IRRADIANCE, .limit = std::numeric_limits<float>::infinity()});
  const Artifact points = cache_.ask_points(graph_, "splat", kFirst), places = ask_places(points);
  graph_.when({places}, [this, points, places] {
    facts_ = places.facts<SplatSelectFacts>();
    chosen_ = true;
    places.check_facts(
        facts_.records == places.record_count() && facts_.accuracy >= 0 && std::isfinite(facts_.accuracy),
        std::to_string(facts_.records) + " records at an accuracy of " + std::to_string(facts_.accuracy) + ", and " +
            std::to_string(places.record_count()) + " places");
    if (facts_.records > 0)
      gather(points, places);
    else
      film_.add_pass({});
    own_stages_asked_ = true;
  });
}

// Records before they are chosen, as two Cornell boxes of 48 to 256 pixels have them.
double usual_records(double pixels, double accuracy) {
  const double usual = 7.4 * std::pow(pixels, 0.674);
  return accuracy > 0 ? std::min(pixels, usual * std::pow(kUsualAccuracy / accuracy, 2)) : pixels;
}

double SplatPlan::own_work() const {
  if (!caches()) return 0;
  const double records = chosen_
                             ? static_cast<double>(facts_.records)
                             : usual_records(static_cast<double>(cache_.points()) / cache_.samples(), splat_.accuracy);
  return cache_.work() + records * strata_.count();
}

Artifact SplatPlan::ask_places(const Artifact& points) {
  SplatSelectParameters p{};
  p.width = settings_.width;
  p.height = settings_.height;
  p.samples = cache_.samples();
  p.accuracy = static_cast<float>(splat_.accuracy);
  p.records = splat_.records;
  p.probe_rays = std::min(kMostProbeRays, (splat_.rays + 15) / 16 * 16);
  p.least_radius = kLeastRadius;
  p.most_radius = std::max(kLeastRadius, kMostRadiusOfWidth * static_cast<float>(settings_.width));
  return graph_.add(cache_.choosing("splat.select", "splat_select", kFirst), p, {{"points", points}});
}

void SplatPlan::gather(const Artifact& points, const Artifact& places) {
  SplatGatherParameters p = cache_.gather_parameters(facts_.records, strata_);
  p.samples.depth = depth();
  p.samples.filter = PATH_CLASS_IRRADIANCE;
  p.samples.clamp = std::numeric_limits<float>::infinity();
  const Artifact cache = graph_.add(
      PixelCache::gathering("splat.gather", "splat_gather", kFirst, facts_.records, strata_), p, {{"places", places}});
  const Artifact shaded = cache_.ask_shading(graph_, "splat", kFirst, points, cache);
  cache_.preview(graph_, film_, shaded);
  graph_.when({shaded}, [this, shaded] { film_.add_pass(cache_.picture_of(shaded.records())); });
}

std::vector<std::string> SplatPlan::warnings() const {
  std::vector<std::string> warnings = paths_.warnings();
  if (splat_.records && facts_.records > splat_.records)
    warnings.push_back("splat.new_records is " + std::to_string(splat_.records) +
                       ", but the coarsest cache that covers the picture has " + std::to_string(facts_.records) +
                       " records");
  return warnings;
}

std::string SplatPlan::parameters_json() const {
  nlohmann::json json = paths_.parameters();
  nlohmann::json splat = {{"accuracy", splat_.accuracy}, {"gather_rays", splat_.rays}, {"bounces", splat_.bounces}};
  if (caches()) {
    splat["gather_rays"] = strata_.count();
    splat["points_a_pixel"] = cache_.samples();
    splat["points"] = facts_.points;
    splat["records"] = facts_.records;
    splat["rounds"] = facts_.rounds;
    splat["probes"] = facts_.probes;
    if (splat_.accuracy > 0) splat["accuracy"] = facts_.accuracy;
  }
  json["splat"] = splat;
  return json.dump();
}

std::vector<std::string> SplatPlan::outline() const {
  std::vector<std::string> lines;
  if (caches()) {
    lines.push_back("splat.points: " + std::to_string(cache_.samples()) + " surface points of each pixel, in " +
                    std::to_string(cache_.tiles()) + " tiles, split");
    lines.push_back("splat.select: where records are needed, solo");
    lines.push_back("splat.gather: light from " + std::to_string(strata_.count()) +
                    " directions at each record, split");
    lines.push_back("splat.shade: " + std::to_string(cache_.tiles()) + " tiles lit by the records near them, split");
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
          "between them; explained in docs/explanation/splat.md.",
      .make = make_plan_of<SplatPlan>,
      // Beside the paths: the pass, its square, the preview and the records twice, all RGB.
      .bytes_a_pixel = kPathBytesAPixel + 5 * 3 * sizeof(float),
      .check = check,
      .settings = {
          {"splat.accuracy", real, 0, 1, "0.15",
           "a: a record reaches that part of the mean distance to the surfaces about it; less: more records; 0: a "
           "record at every point that a pixel shows"},
          {"splat.gather_rays", whole, 0, SPLAT_MOST_RAYS / 2, "1024",
           "rays of each record; 0: no cache, paths find all light"},
          {"splat.bounces", whole, 0, 1024, "0", "bounces of the cache's light; 0: until Russian roulette ends it"},
          {"splat.new_records", whole, 0, 1u << 24, "0",
           "records of a frame, at most: the accuracy is coarsened until they suffice; 0: no limit"},
      }};
}

}  // namespace gleaner::coordinator

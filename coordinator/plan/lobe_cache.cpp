#include "coordinator/plan/lobe_cache.h"

namespace gleaner::coordinator {

using namespace kernels;

void LobeCache::begin(const Settings& settings, std::function<void(std::vector<float>)> picture) {
  settings_ = settings;
  picture_ = std::move(picture);
  const auto find = [&](const char* name, std::uint32_t what) {
    return cache_.ask_points(graph_, name, settings_.priority, settings_.free_scatterings, what);
  };
  const Graph::Artifact points = find("splat.lobe_points", SPLAT_LOBES), lobes = find("splat.lobes", SPLAT_LOBE_ROWS);
  const Graph::Artifact places =
      graph_.add(cache_.choosing("splat.lobe_select", "splat_select", settings_.priority, SPLAT_PLACE_WORDS),
                 settings_.select, {{"points", points}});
  graph_.when({places}, [this, points, lobes, places] {
    const auto facts = places.facts<SplatSelectFacts>();
    records_ = facts.records;
    places.check_facts(records_ == places.record_count(),
                       std::to_string(records_) + " records, and " + std::to_string(places.record_count()) + " places");
    if (records_)
      gather(points, lobes, places);
    else
      picture_({});
  });
}

void LobeCache::gather(const Graph::Artifact& points, const Graph::Artifact& lobes, const Graph::Artifact& places) {
  SplatLobeGatherParameters p{};
  p.records = settings_.gather;
  p.records.records = low(records_);
  p.order = settings_.order;
  const Graph::Artifact cache =
      graph_.add(PixelCache::gathering("splat.lobe_gather", "splat_lobe_gather", settings_.priority, records_,
                                       settings_.strata, RADIANCE_WORDS(settings_.order)),
                 p, {{"places", places}});
  const Graph::Artifact shaded =
      cache_.ask_lobe_shading(graph_, "splat.lobe_shade", settings_.priority, points, lobes, cache, settings_.order);
  graph_.when({shaded}, [this, shaded] { picture_(cache_.picture_of(shaded.records())); });
}

}  // namespace gleaner::coordinator

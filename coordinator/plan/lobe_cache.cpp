#include "coordinator/plan/lobe_cache.h"

#include <algorithm>
#include <utility>

namespace gleaner::coordinator {

using namespace kernels;

bool LobeCache::has_lobes(const SceneSummary& scene, std::uint32_t least_order) {
  const float least = least_order ? std::max(HARMONIC_LEAST_ALPHA(least_order), ROUGH_LOBE_ALPHA) : ROUGH_LOBE_ALPHA;
  return scene.roughest_lobe >= 0.999f * least;  // other roundings
}

void LobeCache::begin(Settings settings, std::function<void(std::vector<float>)> picture) {
  settings_ = std::move(settings);
  picture_ = std::move(picture);
  const auto find = [&](const char* stage, std::uint32_t what) {
    return cache_.ask_points(graph_, settings_.method + stage, settings_.priority, settings_.free_scatterings, what,
                             settings_.least_order);
  };
  const Graph::Artifact points = find(".lobe_points", SPLAT_LOBES), lobes = find(".lobes", SPLAT_LOBE_ROWS);
  const Graph::Artifact places = settings_.choose(points);
  std::vector<Graph::Artifact> until = settings_.until;
  until.push_back(places);
  graph_.when(std::move(until), [this, points, lobes, places] {
    records_ = places.record_count();
    if (!records_) return picture_({});
    const Graph::Artifact shaded = cache_.ask_lobe_shading(graph_, settings_.method + ".lobe_shade", settings_.priority,
                                                           points, lobes, settings_.gather(places), settings_.order);
    graph_.when({shaded}, [this, shaded] { picture_(cache_.picture_of(shaded.records())); });
  });
}

}  // namespace gleaner::coordinator

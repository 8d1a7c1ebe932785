#pragma once
// Light on rough lobes by records of incoming radiance, in hemispherical harmonics: the parts of methods `splat` and
// `photon` that settings `splat.order` and `photon.order` switch on (docs/explanation/splat.md, photon.md).

#include <cstdint>
#include <functional>
#include <string>
#include <vector>

#include "coordinator/plan/pixel_cache.h"

namespace gleaner::coordinator {

class LobeCache {
 public:
  // What is the method's own. Its stages are METHOD.lobe_points, METHOD.lobes and METHOD.lobe_shade, and what the
  // functions ask for.
  struct Settings {
    std::string method;
    std::uint32_t order = 0;             // of the records
    std::uint32_t least_order = 0;       // SplatPointParameters::order of the points
    std::uint32_t free_scatterings = 0;  // of PixelCache::ask_points()
    int priority = 0;
    std::function<Graph::Artifact(const Graph::Artifact& points)> choose;  // places
    std::vector<Graph::Artifact> until;                                    // what gathering waits for beside these
    // Records of incoming radiance at all places, of which there is one at least.
    std::function<Graph::Artifact(const Graph::Artifact& places)> gather;
  };

  // Whether the scene may have lobes that such points (Settings::least_order) are found of.
  static bool has_lobes(const SceneSummary& scene, std::uint32_t least_order);

  // The `picture` is called once, with RGB of each pixel, or with nothing where no pixel shows a lobe.
  LobeCache(Graph& graph, const PixelCache& cache) : graph_(graph), cache_(cache) {}
  void begin(Settings settings, std::function<void(std::vector<float>)> picture);

  std::uint64_t records() const { return records_; }  // 0 as long as they are not known

 private:
  Graph& graph_;
  const PixelCache& cache_;
  Settings settings_;
  std::function<void(std::vector<float>)> picture_;
  std::uint64_t records_ = 0;
};

}  // namespace gleaner::coordinator

#pragma once
// Light on rough lobes by records of incoming radiance, in hemispherical harmonics: the part of method `splat` that
// setting `splat.order` switches on (docs/explanation/splat.md).

#include <cstdint>
#include <functional>
#include <string>
#include <vector>

#include "coordinator/plan/pixel_cache.h"

namespace gleaner::coordinator {

class LobeCache {
 public:
  struct Settings {
    std::uint32_t order = 0;
    std::uint32_t free_scatterings = 0;     // of PixelCache::ask_points()
    kernels::SplatSelectParameters select;  // how places are chosen
    kernels::SplatGatherParameters gather;  // the number of records is not read
    Strata strata;
    int priority = 0;
  };

  // The `picture` is called once, with RGB of each pixel.
  LobeCache(Graph& graph, const PixelCache& cache) : graph_(graph), cache_(cache) {}
  void begin(const Settings& settings, std::function<void(std::vector<float>)> picture);

  std::uint64_t records() const { return records_; }  // 0 as long as they are not known

 private:
  void gather(const Graph::Artifact& points, const Graph::Artifact& lobes, const Graph::Artifact& places);

  Graph& graph_;
  const PixelCache& cache_;
  Settings settings_;
  std::function<void(std::vector<float>)> picture_;
  std::uint64_t records_ = 0;
};

}  // namespace gleaner::coordinator

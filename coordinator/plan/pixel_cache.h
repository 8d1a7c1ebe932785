#pragma once
// What methods share that gather irradiance at a few of the points that pixels show and interpolate it between them
// (kernels/splat_records.h): the points, and the tiles of pixels that are shaded.

#include <cstdint>
#include <string>
#include <utility>
#include <vector>

#include "coordinator/film/accumulator.h"
#include "coordinator/plan/graph.h"
#include "kernels/splat_records.h"

namespace gleaner::coordinator {

// Strata of a hemisphere, about as many as rays were asked for: rings, four times as many strata around as rings, or
// nearly.
struct Strata {
  std::uint32_t polar = 1, azimuthal = 16;
  std::uint32_t count() const { return polar * azimuthal; }
};
Strata strata_of(std::uint32_t rays);

// The light of several caches, RGB of each pixel, which is one pass of the picture.
class CacheLight {
 public:
  // So many parts are to come.
  void expect(unsigned parts) { missing_ = parts; }
  // A part: of each pixel, or nothing where there is none. True: it is the last one.
  bool add(const std::vector<float>& part);
  std::vector<float> take() { return std::move(sum_); }

 private:
  std::vector<float> sum_;
  unsigned missing_ = 0;
};

class PixelCache {
 public:
  // `samples`: points of each pixel, as far as the film allows; a power of two, or the one below.
  PixelCache(const FrameSettings& settings, std::uint32_t samples);

  std::uint32_t samples() const { return samples_; }  // points of a pixel
  std::uint64_t tiles() const;
  std::uint64_t points() const;  // of whole tiles
  double work() const;           // of both stages, as StageSpec::work
  // Whether the stages take a film of this size.
  static bool holds(const FrameSettings& settings);
  static constexpr std::uint64_t most_pixels = 1u << 26;

  // Of the scatterings on the way from the camera to a point, its record's light lacks all but `free_scatterings`.
  kernels::SplatPointParameters point_parameters(std::uint32_t free_scatterings) const;
  // Cameras whose records the picture begins with: of its trajectory, or of the session's pictures up to this one. What
  // is made for them knows nothing of the frame that asks.
  static const std::vector<scene::Camera>& begins_with(const FrameSettings& settings);
  // Samples of a pixel that records are made for: pictures of a session share them, however many each of them has.
  static std::uint32_t samples_of_records(const FrameSettings& settings);
  // Points of camera number `number` of these: a picture with fewer pixels where the film has many.
  kernels::SplatPointParameters camera_point_parameters(const scene::Camera& camera, std::size_t number,
                                                        std::uint32_t free_scatterings) const;
  // Stage "METHOD.points", or that of another word for `what` (kernels/splat_records.h), which has the `order` as well.
  Graph::Artifact ask_points(Graph& graph, const std::string& name, int priority,
                             std::uint32_t free_scatterings = SPLAT_LEVEL, std::uint32_t what = SPLAT_LAYERS,
                             std::uint32_t order = 0) const;
  // Tiles of `points` lit by the records of `cache`.
  Graph::Artifact ask_shading(Graph& graph, const std::string& name, int priority, const Graph::Artifact& points,
                              const Graph::Artifact& cache) const;
  // Their `lobes`, by records of incoming radiance of this order.
  Graph::Artifact ask_lobe_shading(Graph& graph, const std::string& name, int priority, const Graph::Artifact& points,
                                   const Graph::Artifact& lobes, const Graph::Artifact& cache,
                                   std::uint32_t order) const;

  // The solo stage that chooses, among the points, where light is gathered.
  StageSpec choosing(const std::string& name, const char* kind, int priority,
                     std::uint32_t words = SPLAT_POINT_WORDS) const;
  // The stage that gathers at so many places, and its parameters: filter and clamp are the method's.
  static StageSpec gathering(const std::string& name, const char* kind, int priority, std::uint64_t records,
                             const Strata& strata, std::uint32_t words = CACHE_WORDS);
  kernels::SplatGatherParameters gather_parameters(std::uint64_t records, const Strata& strata) const;

  // The live preview shows the tiles while they are shaded.
  void preview(Graph& graph, Accumulator& film, const Graph::Artifact& shaded) const;
  // Of shaded tiles, RGB of each pixel.
  std::vector<float> picture_of(const Bytes& records) const;

 private:
  StageSpec shading(const std::string& name, int priority) const;

  FrameSettings settings_;
  std::uint32_t samples_;
};

}  // namespace gleaner::coordinator

#include "coordinator/plan/pixel_cache.h"

#include <algorithm>
#include <bit>
#include <cmath>

namespace gleaner::coordinator {
namespace {

using namespace kernels;

// Points of a film, at most, and so many of each pixel as that allows.
constexpr std::uint64_t kMostPoints = 1u << 22;
// Points of a camera whose records others begin with, at most: they are looked at by one worker.
constexpr std::uint64_t kMostCameraPoints = std::uint64_t{1} << 17;
// Samples of a pixel that records of a session's pictures are good for.
constexpr std::uint32_t kSharedSamples = 16;
// Work, in samples of paths: of a point that is found, and one that is shaded.
constexpr double kPointWork = 0.2, kShadeWork = 0.1;

std::uint32_t tiles_across(std::uint32_t pixels) { return (pixels + SPLAT_TILE - 1) / SPLAT_TILE; }

// Calls row(pixel, rgb, pixels) for each row of each of the tiles from `first` on.
template <typename Row>
void each_row(std::uint64_t first, std::uint64_t count, const Bytes& records, std::uint32_t width, std::uint32_t height,
              Row row) {
  const std::uint32_t columns = tiles_across(width);
  const auto* rgb = reinterpret_cast<const float*>(records.data());
  for (std::uint64_t k = 0; k < count; ++k) {
    const auto x = static_cast<std::uint32_t>((first + k) % columns) * SPLAT_TILE;
    const auto y = static_cast<std::uint32_t>((first + k) / columns) * SPLAT_TILE;
    const std::uint32_t pixels = std::min(SPLAT_TILE, width - x);
    for (std::uint32_t r = 0; r < SPLAT_TILE && y + r < height; ++r)
      row(std::uint64_t{y + r} * width + x, rgb + 3 * (k * SPLAT_TILE_PIXELS + std::uint64_t{r} * SPLAT_TILE), pixels);
  }
}

}  // namespace

Strata strata_of(std::uint32_t rays) {
  const auto azimuthal =
      static_cast<std::uint32_t>(16 * std::max(1l, std::lround(2 * std::sqrt(static_cast<double>(rays)) / 16)));
  return {std::max(1u, (rays + azimuthal / 2) / azimuthal), azimuthal};
}

bool CacheLight::add(const std::vector<float>& part) {
  if (sum_.size() < part.size()) sum_.resize(part.size());
  for (std::size_t i = 0; i < part.size(); ++i) sum_[i] += part[i];
  return --missing_ == 0;
}

PixelCache::PixelCache(const FrameSettings& settings, std::uint32_t samples) : settings_(settings) {
  const std::uint64_t pixels = std::uint64_t{settings.width} * settings.height;
  const std::uint64_t most =
      std::min<std::uint64_t>(SPLAT_MOST_SAMPLES, kMostPoints / std::max<std::uint64_t>(1, pixels));
  samples_ = static_cast<std::uint32_t>(
      std::bit_floor(std::clamp<std::uint64_t>(samples, 1, std::max<std::uint64_t>(1, most))));
}

std::uint64_t PixelCache::tiles() const {
  return std::uint64_t{tiles_across(settings_.width)} * tiles_across(settings_.height);
}

std::uint64_t PixelCache::points() const { return tiles() * SPLAT_TILE_PIXELS * samples_; }

double PixelCache::work() const { return (kPointWork + kShadeWork) * static_cast<double>(points()); }

bool PixelCache::holds(const FrameSettings& settings) {
  return std::uint64_t{settings.width} * settings.height <= most_pixels;
}

Graph::Artifact PixelCache::ask_points(Graph& graph, const std::string& name, int priority,
                                       std::uint32_t free_scatterings, std::uint32_t what, std::uint32_t order) const {
  SplatPointParameters p = point_parameters(free_scatterings);
  p.what = what;
  p.order = order;
  return graph.add({.name = name,
                    .kind = "splat_points",
                    .items = tiles(),
                    .scene_parts = kSurfaces,
                    .priority = priority,
                    .work = kPointWork * static_cast<double>(points()),
                    .output = {.record_bytes = SPLAT_TILE_PIXELS * samples_ * SPLAT_POINT_WORDS * 4,
                               .placement = Placement::retain}},
                   p);
}

SplatPointParameters PixelCache::point_parameters(std::uint32_t free_scatterings) const {
  SplatPointParameters p{};
  p.camera = settings_.camera;
  p.width = settings_.width;
  p.height = settings_.height;
  p.samples = samples_;
  p.depth = settings_.depth;
  p.seed_low = low(settings_.seed);
  p.seed_high = high(settings_.seed);
  p.free_scatterings = free_scatterings;
  return p;
}

const std::vector<scene::Camera>& PixelCache::begins_with(const FrameSettings& settings) {
  return settings.trajectory.empty() ? settings.looks : settings.trajectory;
}

std::uint32_t PixelCache::samples_of_records(const FrameSettings& settings) {
  return settings.looks.empty() ? settings.method_spp() : kSharedSamples;
}

SplatPointParameters PixelCache::camera_point_parameters(const scene::Camera& camera, std::size_t number,
                                                         std::uint32_t free_scatterings) const {
  const double pixels = static_cast<double>(settings_.width) * settings_.height;
  const double edge = std::min(1.0, std::sqrt(static_cast<double>(kMostCameraPoints) / pixels));
  const auto scaled = [edge](std::uint32_t length) {
    return std::max(1u, static_cast<std::uint32_t>(edge * static_cast<double>(length)));
  };
  SplatPointParameters p = point_parameters(free_scatterings);
  p.camera = camera;
  p.width = scaled(settings_.width);
  p.height = scaled(settings_.height);
  p.samples = static_cast<std::uint32_t>(
      std::bit_floor(std::clamp<std::uint64_t>(kMostCameraPoints / (std::uint64_t{p.width} * p.height), 1, 16)));
  // Points of their own, should two cameras be the same.
  p.seed_high += static_cast<std::uint32_t>(number) + 1;
  return p;
}

StageSpec PixelCache::shading(const std::string& name, int priority) const {
  return {.name = name,
          .kind = "splat_shade",
          .items = tiles(),
          .priority = priority,
          .work = kShadeWork * static_cast<double>(points()),
          .output = {.record_bytes = SPLAT_TILE_PIXELS * 12, .floats = true}};
}

Graph::Artifact PixelCache::ask_shading(Graph& graph, const std::string& name, int priority,
                                        const Graph::Artifact& points, const Graph::Artifact& cache) const {
  SplatShadeParameters p{};
  p.tiles = static_cast<std::uint32_t>(tiles());
  p.samples = samples_;
  return graph.add(shading(name, priority), p, {{"points", points, Extent::own_items}, {"cache", cache}});
}

Graph::Artifact PixelCache::ask_lobe_shading(Graph& graph, const std::string& name, int priority,
                                             const Graph::Artifact& points, const Graph::Artifact& lobes,
                                             const Graph::Artifact& cache, std::uint32_t order) const {
  SplatShadeParameters p{};
  p.tiles = static_cast<std::uint32_t>(tiles());
  p.samples = samples_;
  p.order = order;
  return graph.add(shading(name, priority), p,
                   {{"points", points, Extent::own_items}, {"lobes", lobes, Extent::own_items}, {"cache", cache}});
}

StageSpec PixelCache::choosing(const std::string& name, const char* kind, int priority, std::uint32_t words) const {
  return {.name = name,
          .kind = kind,
          .items = 1,
          .solo = true,
          .scene_parts = kSurfaces,
          .priority = priority,
          .output = {.record_bytes = words * 4,
                     .counted = true,
                     .most_records = low(std::min<std::uint64_t>(points(), 0xffffffffu)),
                     .placement = Placement::retain}};
}

StageSpec PixelCache::gathering(const std::string& name, const char* kind, int priority, std::uint64_t records,
                                const Strata& strata, std::uint32_t words) {
  return {.name = name,
          .kind = kind,
          .items = records,
          .priority = priority,
          .work = static_cast<double>(records) * strata.count(),
          .output = {.record_bytes = words * 4, .placement = Placement::retain}};
}

SplatGatherParameters PixelCache::gather_parameters(std::uint64_t records, const Strata& strata) const {
  SplatGatherParameters p{};
  p.samples.width = p.samples.height = p.samples.samples_per_item = p.samples.last_item_samples = 1;
  p.samples.depth = settings_.depth;
  p.samples.seed_low = low(settings_.seed);
  p.samples.seed_high = high(settings_.seed);
  p.records = low(records);
  p.polar = strata.polar;
  p.azimuthal = strata.azimuthal;
  return p;
}

void PixelCache::preview(Graph& graph, Accumulator& film, const Graph::Artifact& shaded) const {
  graph.on_preview(shaded, [this, &film](auto first, auto count, const Bytes& records) {
    each_row(first, count, records, settings_.width, settings_.height,
             [&film](std::uint64_t pixel, const float* rgb, std::uint32_t pixels) {
               film.draw_pass(pixel, {rgb, std::size_t{3} * pixels});
             });
  });
}

std::vector<float> PixelCache::picture_of(const Bytes& records) const {
  std::vector<float> picture(std::size_t{3} * settings_.width * settings_.height);
  each_row(0, tiles(), records, settings_.width, settings_.height,
           [&](std::uint64_t pixel, const float* rgb, std::uint32_t pixels) {
             std::copy_n(rgb, std::size_t{3} * pixels, picture.begin() + static_cast<std::ptrdiff_t>(3 * pixel));
           });
  return picture;
}

}  // namespace gleaner::coordinator

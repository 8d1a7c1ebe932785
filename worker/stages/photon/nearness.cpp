#include "worker/stages/photon/nearness.h"

#include <bit>
#include <limits>
#include <memory>

#include "kernels/rays.h"
#include "worker/wavefront/host_threads.h"

namespace gleaner::worker {
namespace {

constexpr float kNothing = std::numeric_limits<float>::infinity();

// Rays are few: they are written and read on the host.
class DistanceThread : public HostThread {
 public:
  DistanceThread(const StageRun& run, std::span<const HostRay> rays, std::span<float> distances, WorkQueue& work,
                 unsigned index)
      : HostThread(run.device, run.workspace, run.scene.tracer(), work, index),
        asked_(rays),
        distances_(distances),
        capacity_(run.device.info().cpu ? 1u << 12 : 1u << 16),
        rows_(std::size_t{capacity_} * RAY_HIT_ROWS),
        hits_(take("paths", rows_.size() * sizeof rows_[0])) {}

  void run(BatchResult&) {
    while (const WorkQueue::Block block = work_.claim(capacity_)) {
      const auto count = static_cast<std::uint32_t>(block.count);
      for (std::uint32_t i = 0; i < count; ++i) put_ray(i, asked_[block.first + i]);
      const std::size_t bytes = std::size_t{(count + RAY_BLOCK - 1) / RAY_BLOCK} * RAY_BLOCK * RAY_HIT_ROWS * 4;
      queue_.enqueueWriteBuffer(hits_, CL_TRUE, 0, bytes, rows_.data());
      rays_.closest(hits_, single_rays(RAY_HIT_ROWS, count));
      counters.scatter += count;
      queue_.enqueueReadBuffer(hits_, CL_TRUE, 0, bytes, rows_.data());
      for (std::uint32_t i = 0; i < count; ++i)
        distances_[block.first + i] = word(i, ROW_GEOMETRY) == GLEANER_NONE ? kNothing : real(i, ROW_FAR);
    }
  }

 private:
  std::uint32_t& word(std::uint32_t ray, unsigned row) {
    return rows_[(std::size_t{ray / RAY_BLOCK} * RAY_HIT_ROWS + row) * RAY_BLOCK + ray % RAY_BLOCK];
  }
  float real(std::uint32_t ray, unsigned row) { return std::bit_cast<float>(word(ray, row)); }

  void put_ray(std::uint32_t ray, const HostRay& asked) {
    const auto put = [&](unsigned row, float value) { word(ray, row) = std::bit_cast<std::uint32_t>(value); };
    for (unsigned k = 0; k < 3; ++k) {
      put(ROW_ORIGIN + k, asked.origin[k]);
      put(ROW_DIRECTION + k, asked.direction[k]);
    }
    put(ROW_NEAR, 0);
    put(ROW_TIME, 0);
    put(ROW_FAR, kNothing);
    word(ray, ROW_MASK) = 0xffffffffu;
    word(ray, ROW_SOURCE) = GLEANER_NONE;
    word(ray, ROW_FLAGS) = 0;
    word(ray, ROW_GEOMETRY) = GLEANER_NONE;
    word(ray, ROW_INSTANCE) = GLEANER_NONE;
  }

  std::span<const HostRay> asked_;
  std::span<float> distances_;
  std::uint32_t capacity_;
  std::vector<std::uint32_t> rows_;
  cl::Buffer hits_;
};

}  // namespace

std::vector<float> distances_along(const StageRun& run, std::span<const HostRay> rays, BatchResult& result) {
  std::vector<float> distances(rays.size(), kNothing);
  WorkQueue work(rays.size(), host_threads(run.device));
  if (!rays.empty())
    run_host_threads(work, result, [&](unsigned index) {
      return std::make_unique<DistanceThread>(run, rays, distances, work, index);
    });
  return distances;
}

std::vector<float> distances_ahead(const StageRun& run, std::span<const SplatPoint> places, BatchResult& result) {
  std::vector<HostRay> rays;
  rays.reserve(places.size());
  for (const SplatPoint& place : places) rays.push_back({place.position, place.geometric});
  return distances_along(run, rays, result);
}

}  // namespace gleaner::worker

// Stage kind "splat_shade": records splatted to tiles of pixels (kernels/splat/shade.cl; of incoming radiance, for
// rough lobes: lobe_shade.cl).
//
// The paper draws the rectangle of the image that a record's sphere covers. Points that are seen in mirrors and through
// glass lie elsewhere in the image; so a tile takes the records whose spheres meet the box about its points instead.

#include <algorithm>
#include <cmath>
#include <cstring>

#include "kernels/rays.h"
#include "scene/model/error.h"
#include "worker/stages/splat/lobe_table.h"
#include "worker/stages/splat/points.h"
#include "worker/stages/splat/stages.h"
#include "worker/stages/split_stage.h"
#include "worker/wavefront/input_rows.h"

namespace gleaner::worker {
namespace {

using kernels::SplatShadeParameters;

constexpr std::size_t kTileBytes = std::size_t{SPLAT_TILE_PIXELS} * 12;
// Tiles whose lists of records are made together.
constexpr std::size_t kGroupTiles = 16;

std::uint32_t point_capacity(const Device& device) { return device.info().cpu ? 1u << 14 : 1u << 18; }

// The cache on the host, where tiles choose of it, and on the device. Records of incoming radiance begin as others.
struct Cache {
  std::vector<CacheRecord> rows;
  cl::Buffer buffer;
  std::size_t stride = sizeof(CacheRecord);  // bytes on the device
  std::size_t bytes() const { return rows.size() * (stride + sizeof(CacheRecord)); }
};

Cache read_cache(const StageRun& run, std::uint32_t order) {
  Cache cache;
  cache.stride = 4 * (order ? RADIANCE_WORDS(order) : CACHE_WORDS);
  const InputRows input(run.task, "cache", cache.stride);
  cache.rows.resize(input.rows());
  const InputRows::Check check = [&](std::uint64_t first, std::span<const std::byte> piece) {
    const std::size_t count = piece.size() / cache.stride;
    std::vector<float> words(cache.stride / 4);
    for (std::uint64_t row = first; row < first + count; ++row) {
      std::memcpy(words.data(), piece.data() + (row - first) * cache.stride, cache.stride);
      std::memcpy(&cache.rows[row], words.data(), sizeof(CacheRecord));
      for (const float word : words)
        if (!std::isfinite(word)) input.fail(row, "", "finite numbers", std::to_string(word));
      if (!(cache.rows[row].radius > 0))
        input.fail(row, "radius", "metres above 0", std::to_string(cache.rows[row].radius));
      if (!(cache.rows[row].accuracy > 0))
        input.fail(row, "accuracy", "a number above 0", std::to_string(cache.rows[row].accuracy));
    }
  };
  cl::CommandQueue queue = run.device.make_queue();
  cache.buffer = input.to_device(run.device, queue, check);
  return cache;
}

// The points' lobes, and lobes in hemispherical harmonics.
struct Lobes {
  const InputRows& rows;
  const cl::Buffer& table;
};

class SplatThread : public HostThread {
 public:
  SplatThread(const StageRun& run, const Program& program, const SplatShadeParameters& p, const Cache& cache,
              const InputRows& points, const Lobes* lobes, WorkQueue& work, unsigned index)
      : HostThread(run.device, run.workspace, run.scene.tracer(), work, index),
        cache_(cache),
        input_(points),
        lobes_(lobes),
        first_item_(run.first),
        first_row_(points.first_row_of(run.first, run.count, p.tiles)),
        samples_(p.samples),
        tile_points_(SPLAT_TILE_PIXELS * p.samples),
        capacity_(point_capacity(run.device)),
        points_(take("splat.points", std::size_t{capacity_} * sizeof(SplatPoint))),
        offsets_buffer_(take("splat.offsets", (capacity_ / tile_points_ + 1) * 4)),
        radiance_buffer_(take("splat.radiance", std::size_t{capacity_ + RAY_BLOCK} * 16)),
        host_points_(capacity_),
        radiance_(std::size_t{capacity_} * 4),
        accumulate_(run.device, program, lobes ? "splat_accumulate_lobes" : "splat_accumulate") {
    accumulate_.set("points", points_)
        .set("cache", cache.buffer)
        .set("offsets", offsets_buffer_)
        .set("tile_points", tile_points_)
        .set("radiance", radiance_buffer_);
    if (!lobes) return;
    lobe_buffer_ = take("splat.lobes", std::size_t{capacity_} * LOBE_WORDS * 4);
    accumulate_.set("lobes", lobe_buffer_).set("table", lobes->table);
  }

  void run(BatchResult& result) {
    while (const WorkQueue::Block block = work_.claim(capacity_ / tile_points_)) {
      const auto count = static_cast<std::uint32_t>(block.count) * tile_points_;
      read_points(block);
      choose_records(block.count);
      queue_.enqueueWriteBuffer(offsets_buffer_, CL_TRUE, 0, offsets_.size() * 4, offsets_.data());
      const cl::Buffer list = take("splat.list", (list_.size() + 1) * 4);
      if (!list_.empty()) queue_.enqueueWriteBuffer(list, CL_TRUE, 0, list_.size() * 4, list_.data());
      accumulate_.set("list", list).set("count", count);
      launch(accumulate_, count, capacity_);
      queue_.enqueueReadBuffer(radiance_buffer_, CL_TRUE, 0, std::size_t{count} * 16, radiance_.data());
      for (std::uint64_t tile = 0; tile < block.count; ++tile)
        resolve(tile, first_item_ + block.first + tile, result.records.data() + (block.first + tile) * kTileBytes);
    }
  }

 private:
  void read_points(const WorkQueue::Block& block) {
    const std::uint64_t first = first_row_ + block.first;
    input_.visit(first, block.count, [&](std::uint64_t row, std::span<const std::byte> piece) {
      std::memcpy(&host_points_[(row - first) * tile_points_], piece.data(), piece.size());
    });
    queue_.enqueueWriteBuffer(points_, CL_TRUE, 0, block.count * tile_points_ * sizeof(SplatPoint),
                              host_points_.data());
    if (!lobes_) return;
    const std::size_t stride = std::size_t{tile_points_} * LOBE_WORDS * 4;
    lobes_->rows.visit(first, block.count, [&](std::uint64_t row, std::span<const std::byte> piece) {
      queue_.enqueueWriteBuffer(lobe_buffer_, CL_TRUE, (row - first) * stride, piece.size(), piece.data());
    });
  }

  // Each tile's records, in the cache's order.
  void choose_records(std::uint64_t tiles) {
    offsets_.assign(1, 0);
    list_.clear();
    for (std::uint64_t first = 0; first < tiles; first += kGroupTiles) {
      const std::uint64_t last = std::min(tiles, first + kGroupTiles);
      std::vector<PointBox> boxes(last - first);
      PointBox all;
      for (std::uint64_t tile = first; tile < last; ++tile) {
        PointBox& box = boxes[tile - first];
        for (std::uint32_t i = 0; i < tile_points_; ++i)
          if (const SplatPoint& point = host_points_[tile * tile_points_ + i]; point.exists()) box.add(point.position);
        all.add(box);
      }
      near_.clear();
      for (std::uint32_t k = 0; k < cache_.rows.size(); ++k)
        if (meets(all, k)) near_.push_back(k);
      for (const PointBox& box : boxes) {
        for (const std::uint32_t k : near_)
          if (meets(box, k)) list_.push_back(k);
        offsets_.push_back(static_cast<std::uint32_t>(list_.size()));
      }
    }
  }

  bool meets(const PointBox& box, std::uint32_t k) const {
    return box.meets(cache_.rows[k].position, cache_.rows[k].accuracy * cache_.rows[k].radius * 1.01f);
  }

  // A tile's pixels: the means over their points, in the points' order. Radiance that is not finite is left out and
  // counted.
  void resolve(std::uint64_t tile, std::uint64_t item, std::byte* to) {
    float rgb[SPLAT_TILE_PIXELS][3] = {};
    std::uint64_t lost = 0;
    for (std::uint32_t i = 0; i < tile_points_; ++i) {
      const std::size_t at = tile * tile_points_ + i;
      const float* light = &radiance_[4 * at];
      if (host_points_[at].exists() && !(light[3] > 0))
        throw Error::failed("stage splat_shade, item " + std::to_string(item) + ": a point that no record covers");
      if (!std::isfinite(light[0]) || !std::isfinite(light[1]) || !std::isfinite(light[2])) {
        ++lost;
        continue;
      }
      for (std::size_t k = 0; k < 3; ++k) rgb[i / samples_][k] += light[k];
    }
    for (auto& pixel : rgb)
      for (float& value : pixel) value /= static_cast<float>(samples_);
    std::memcpy(to, rgb, sizeof rgb);
    counters.nonfinite += lost;
    if (lost && counters.nonfinite_items.size() < REPORTED_ITEMS) counters.nonfinite_items.push_back(item);
  }

  const Cache& cache_;
  const InputRows& input_;
  const Lobes* lobes_;  // null: records are of irradiance
  std::uint64_t first_item_, first_row_;
  std::uint32_t samples_, tile_points_, capacity_;
  cl::Buffer points_, offsets_buffer_, radiance_buffer_, lobe_buffer_;
  std::vector<SplatPoint> host_points_;
  std::vector<float> radiance_;
  std::vector<std::uint32_t> offsets_, list_, near_;
  Kernel accumulate_;
};

struct LobeTable {
  cl::Buffer buffer;
  std::size_t size = 0;
  std::size_t bytes() const { return size; }
};

std::shared_ptr<const LobeTable> lobe_table(const StageRun& run, std::uint32_t order) {
  StageTask key;
  key.kind = "lobes in harmonics of order " + std::to_string(order);
  return run.tables.get<LobeTable>(key, [&] {
    const std::vector<float> table = make_lobe_table(order);
    LobeTable made;
    made.size = table.size() * 4;
    made.buffer = run.device.make_buffer(made.size);
    run.device.make_queue().enqueueWriteBuffer(made.buffer, CL_TRUE, 0, made.size, table.data());
    return made;
  });
}

}  // namespace

BatchResult run_splat_shade_stage(const StageRun& run) {
  const auto p = run.parameters<SplatShadeParameters>();
  check_splat_samples(run, p.samples);
  if (p.order) check_splat_order(run, p.order);
  run.check_range(p.tiles);
  const double start = seconds_now();
  StageTask key;  // by the cache alone: batches share its table
  key.kind = "splat cache of order " + std::to_string(p.order);
  key.scene = run.task.scene;
  if (const auto found = run.task.inputs.find("cache"); found != run.task.inputs.end())
    key.inputs["cache"] = found->second;
  const auto cache = run.tables.get<Cache>(key, [&] { return read_cache(run, p.order); });
  const InputRows points(run.task, "points", SPLAT_TILE_PIXELS * p.samples * sizeof(SplatPoint));
  BatchResult result;
  result.records.resize(run.count * kTileBytes);
  WorkQueue work(run.count, host_threads(run.device));
  const auto shade = [&](const Program& program, const Lobes* lobes) {
    run_host_threads(work, result, [&](unsigned index) {
      return std::make_unique<SplatThread>(run, program, p, *cache, points, lobes, work, index);
    });
  };
  if (p.order) {
    const InputRows rows(run.task, "lobes", std::size_t{SPLAT_TILE_PIXELS} * p.samples * LOBE_WORDS * 4);
    const auto table = lobe_table(run, p.order);
    const Lobes lobes{rows, table->buffer};
    shade(run.build("lobe_shade.cl", " -D SPLAT_ORDER=" + std::to_string(p.order)), &lobes);
  } else {
    shade(run.build("shade.cl"), nullptr);
  }
  result.counters.seconds = seconds_now() - start;
  return result;
}

}  // namespace gleaner::worker

// Stage kind "splat_points": surface points that pixels show (kernels/splat/points.cl).

#include <bit>
#include <cmath>
#include <cstring>

#include "kernels/path_layout.h"
#include "scene/model/error.h"
#include "worker/stages/splat/points.h"
#include "worker/stages/splat/stages.h"
#include "worker/stages/split_stage.h"
#include "worker/wavefront/input_rows.h"
#include "worker/wavefront/path_wave.h"

namespace gleaner::worker {

void check_splat_samples(const StageRun& run, std::uint32_t samples) {
  if (!std::has_single_bit(samples) || samples > SPLAT_MOST_SAMPLES)
    throw Error::bad_input(run.where(), "samples", "a power of two up to " + std::to_string(SPLAT_MOST_SAMPLES),
                           std::to_string(samples));
}

namespace {

constexpr std::uint64_t kMostPoints = std::uint64_t{1} << 26;

std::uint64_t points_of(std::uint32_t width, std::uint32_t height, std::uint32_t samples) {
  return std::uint64_t{splat_tiles(width)} * splat_tiles(height) * SPLAT_TILE_PIXELS * samples;
}

}  // namespace

void check_splat_points(const StageRun& run, std::uint32_t width, std::uint32_t height, std::uint32_t samples) {
  check_splat_samples(run, samples);
  if (width == 0 || height == 0 || points_of(width, height, samples) > kMostPoints)
    throw Error::bad_input(run.where(), "size", "1 to " + std::to_string(kMostPoints) + " points",
                           std::to_string(width) + " x " + std::to_string(height));
}

std::vector<SplatPoint> read_splat_points(const StageRun& run, std::uint32_t width, std::uint32_t height,
                                          std::uint32_t samples) {
  const InputRows input(run.task, "points", sizeof(SplatPoint));
  input.expect_rows(points_of(width, height, samples));
  std::vector<SplatPoint> points(input.rows());
  input.visit(0, input.rows(), [&](std::uint64_t row, std::span<const std::byte> piece) {
    std::memcpy(&points[row], piece.data(), piece.size());
  });
  for (std::size_t i = 0; i < points.size(); ++i)
    for (std::size_t k = 0; k < 3 && points[i].exists(); ++k)
      if (!std::isfinite(points[i].position[k]) || !std::isfinite(points[i].normal[k]) ||
          !std::isfinite(points[i].footprint))
        input.fail(i, "position", "finite numbers", "others");
  return points;
}

namespace {

using kernels::SplatPointParameters;

std::uint32_t wave_capacity(const Device& device) { return device.info().cpu ? 1u << 12 : 1u << 17; }

class PixelThread : public HostThread {
 public:
  PixelThread(const StageRun& run, const Program& program, const SplatPointParameters& p, const cl::Buffer& parameters,
              std::uint64_t first_tile, WorkQueue& work, unsigned index)
      : HostThread(run.device, run.workspace, run.scene.tracer(), work, index),
        first_tile_(static_cast<std::uint32_t>(first_tile)),
        tile_points_(SPLAT_TILE_PIXELS * p.samples),
        capacity_(wave_capacity(run.device)),
        path_rows_(run.scene.path_rows()),
        paths_(take("paths", PathWave::bytes(capacity_, path_rows_))),
        // Lanes that found nothing write behind the others.
        points_(take("splat.points", std::size_t{capacity_ + 1} * sizeof(SplatPoint))),
        camera_rays_(run.device, program, "splat_camera_rays"),
        step_(run.device, program, "splat_point_step") {
    const auto media = run.scene.media_of(p.camera);
    camera_rays_.set("parameters", parameters)
        .set("paths", paths_)
        .set("points", points_)
        .set("media_high", media[0])
        .set("media_low", media[1]);
    run.scene.set_arguments(step_);
    step_.set("parameters", parameters).set("paths", paths_).set("points", points_).set("counters", device_counters());
  }

  void run(BatchResult& result) {
    const std::size_t stride = tile_points_ * sizeof(SplatPoint);
    while (const WorkQueue::Block block = work_.claim(capacity_ / tile_points_)) {
      const auto paths = static_cast<std::uint32_t>(block.count) * tile_points_;
      camera_rays_.set("first", static_cast<cl_uint>(first_tile_ + block.first)).set("count", paths);
      launch(camera_rays_, paths, capacity_);
      counters.camera += paths;
      step_in_place(step_, paths_, path_rows_, paths, capacity_);
      queue_.enqueueReadBuffer(points_, CL_TRUE, 0, block.count * stride, result.records.data() + block.first * stride);
    }
  }

 private:
  std::uint32_t first_tile_, tile_points_, capacity_;
  unsigned path_rows_;
  cl::Buffer paths_, points_;
  Kernel camera_rays_, step_;
};

}  // namespace

BatchResult find_splat_points(const StageRun& run, const SplatPointParameters& p, std::uint64_t first_tile,
                              std::uint64_t tiles) {
  run.check_film(p.camera, p.width, p.height);
  check_splat_samples(run, p.samples);
  if (p.what > SPLAT_LOBE_ROWS)
    throw Error::bad_input(run.where(), "what", "0 to " + std::to_string(SPLAT_LOBE_ROWS), std::to_string(p.what));
  BatchResult result;
  result.records.resize(tiles * SPLAT_TILE_PIXELS * p.samples * sizeof(SplatPoint));
  cl::CommandQueue queue = run.device.make_queue();
  const cl::Buffer parameters = run.parameter_buffer(queue);
  const Program program = run.build("points.cl");
  WorkQueue work(tiles, host_threads(run.device));
  run_host_threads(work, result, [&](unsigned index) {
    return std::make_unique<PixelThread>(run, program, p, parameters, first_tile, work, index);
  });
  return result;
}

std::vector<SplatPoint> find_camera_points(const StageRun& run, const SplatPointParameters& p, std::uint32_t width,
                                           std::uint32_t height, std::uint32_t samples, BatchResult& counters) {
  if (p.width != width || p.height != height || p.samples != samples)
    throw Error::bad_input(run.where(), "width", "the same in both parts", std::to_string(p.width));
  counters = find_splat_points(run, p, 0, std::uint64_t{splat_tiles(width)} * splat_tiles(height));
  std::vector<SplatPoint> points(counters.records.size() / sizeof(SplatPoint));
  std::memcpy(points.data(), counters.records.data(), counters.records.size());
  counters.records = {};
  return points;
}

BatchResult run_splat_points_stage(const StageRun& run) {
  const auto p = run.parameters<SplatPointParameters>();
  run.check_range(std::uint64_t{splat_tiles(p.width)} * splat_tiles(p.height));
  const double start = seconds_now();
  BatchResult result = find_splat_points(run, p, run.first, run.count);
  result.counters.seconds = seconds_now() - start;
  return result;
}

}  // namespace gleaner::worker

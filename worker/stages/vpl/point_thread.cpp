#include "worker/stages/vpl/point_thread.h"

#include <algorithm>
#include <bit>

#include "kernels/path_layout.h"
#include "scene/model/error.h"
#include "worker/stages/vpl/stages.h"
#include "worker/stages/vpl/waves.h"
#include "worker/wavefront/path_wave.h"

namespace gleaner::worker {

using kernels::VplPointParameters;

VplPointParameters read_point_parameters(const StageRun& run) {
  const auto p = run.parameters<VplPointParameters>();
  run.check_film(p.camera, p.width, p.height);
  if (!std::has_single_bit(p.samples) || p.samples > 64)
    throw Error::bad_input(run.where(), "samples", "a power of two up to 64", std::to_string(p.samples));
  if (p.points > 1 && p.points != p.samples)
    throw Error::bad_input(run.where(), "points", "1 or " + std::to_string(p.samples), std::to_string(p.points));
  if (p.items_high || p.items_low > std::uint64_t{p.width} * p.height * std::max(1u, p.points))
    throw Error::bad_input(run.where(), "items", "at most a pixel each", std::to_string(p.items_low));
  if (!(p.clamp > 0)) throw Error::bad_input(run.where(), "clamp", "a number above 0", std::to_string(p.clamp));
  run.check_range(p.items_low);
  return p;
}

PointThread::PointThread(const StageRun& run, const cl::Buffer& parameters, WorkQueue& work, unsigned index,
                         bool by_point)
    : HostThread(run.device, run.workspace, run.scene.tracer(), work, index),
      first_item_(run.first),
      capacity_(path_capacity(run.device)),
      path_rows_(run.scene.path_rows()),
      paths_(take("paths", PathWave::bytes(capacity_, run.scene.path_rows()))),
      points_(take("points", std::size_t{capacity_ + RAY_BLOCK} * POINT_WORDS * 4)),
      lobes_(take("lobes", std::size_t{by_point ? 1 : capacity_ + RAY_BLOCK} * LOBE_WORDS * 4)),
      camera_rays_(run.device, run.build("points.cl"), "vpl_camera_rays"),
      step_(run.device, run.build("points.cl"), "vpl_point_step") {
  const auto media = run.scene.media_of(run.parameters<VplPointParameters>().camera);
  camera_rays_.set("parameters", parameters)
      .set("by_point", static_cast<cl_uint>(by_point))
      .set("paths", paths_)
      .set("points", points_)
      .set("media_high", media[0])
      .set("media_low", media[1]);
  run.scene.set_arguments(step_);
  step_.set("parameters", parameters)
      .set("paths", paths_)
      .set("points", points_)
      .set("counters", device_counters())
      .set("lobed", static_cast<cl_uint>(!by_point))
      .set("lobes", lobes_);
}

void PointThread::run(BatchResult& result) {
  const std::size_t stride = POINT_WORDS * 4;
  while (const WorkQueue::Block block = work_.claim(capacity_)) {
    find_points(block.first, static_cast<std::uint32_t>(block.count));
    queue_.enqueueReadBuffer(points_, CL_TRUE, 0, block.count * stride, result.records.data() + block.first * stride);
  }
}

void PointThread::find_points(std::uint64_t first, std::uint32_t count) {
  camera_rays_.set_words("first", first_item_ + first).set("count", count);
  launch(camera_rays_, count, capacity_);
  counters.camera += count;
  step_in_place(step_, paths_, path_rows_, count, capacity_);
}

// Stage kind "vpl_points".
BatchResult run_vpl_points_stage(const StageRun& run) {
  const VplPointParameters p = read_point_parameters(run);
  if (p.stride == 0 ||
      (std::uint64_t{p.items_low} - 1) / std::max(1u, p.points) * p.stride >= std::uint64_t{p.width} * p.height)
    throw Error::bad_input(run.where(), "stride", "pixels within the picture", std::to_string(p.stride));
  const double start = seconds_now();
  BatchResult result;
  result.records.resize(run.count * POINT_WORDS * 4);
  cl::CommandQueue queue = run.device.make_queue();
  const cl::Buffer parameters = run.parameter_buffer(queue);
  WorkQueue work(run.count, host_threads(run.device));
  run_host_threads(work, result,
                   [&](unsigned index) { return std::make_unique<PointThread>(run, parameters, work, index, true); });
  result.counters.seconds = seconds_now() - start;
  return result;
}

}  // namespace gleaner::worker

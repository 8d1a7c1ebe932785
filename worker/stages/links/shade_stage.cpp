// Stage kind "links_shade": pixels lit by their vertices (kernels/links/shade.cl).

#include "kernels/path_layout.h"
#include "scene/model/error.h"
#include "worker/stages/links/mesh.h"
#include "worker/stages/links/stages.h"
#include "worker/stages/split_stage.h"
#include "worker/stages/vpl/point_thread.h"

namespace gleaner::worker {
namespace {

using kernels::VplPointParameters;

class ShadeThread : public PointThread {
 public:
  ShadeThread(const StageRun& run, const MeshTables& tables, const VplPointParameters& p, const cl::Buffer& parameters,
              const Program& program, WorkQueue& work, unsigned index)
      : PointThread(run, parameters, work, index, false),
        samples_(p.samples),
        radiance_(take("radiance", std::size_t{capacity_ + RAY_BLOCK} * 12)),
        records_(take("records", std::size_t{capacity_ + RAY_BLOCK} * 12)),
        report_(take("report", FiniteReport::kWords * 4)),
        interpolate_(run.device, program, "links_interpolate"),
        resolve_(run.device, program, "links_resolve") {
    run.scene.set_arguments(interpolate_);
    interpolate_.set("mesh", tables.mesh)
        .set("irradiance", tables.rows)
        .set("points", points_)
        .set("radiance", radiance_);
    resolve_.set("samples", samples_)
        .set("radiance", radiance_)
        .set("records", records_)
        .set("report", report_.buffer());
  }

  void run(BatchResult& result) {
    while (const WorkQueue::Block block = work_.claim(capacity_ / samples_)) {
      // Whole rows of sixteen pixels: those beyond the block are the next one's, and dropped.
      const auto rows = static_cast<std::uint32_t>((block.count + RAY_BLOCK - 1) / RAY_BLOCK);
      const std::uint32_t paths = rows * RAY_BLOCK * samples_;
      find_points(block.first, paths);
      counters.camera -= paths - block.count * samples_;
      interpolate_.set("count", paths);
      launch(interpolate_, paths, capacity_);
      report_.clear(queue_);
      resolve_.set("count", static_cast<cl_uint>(block.count));
      launch(resolve_, block.count, capacity_, 1);
      report_.add_to(counters, queue_, first_item_ + block.first);
      queue_.enqueueReadBuffer(records_, CL_TRUE, 0, block.count * 12, result.records.data() + block.first * 12);
    }
  }

 private:
  std::uint32_t samples_;
  cl::Buffer radiance_, records_;
  FiniteReport report_;
  Kernel interpolate_, resolve_;
};

}  // namespace

BatchResult run_links_shade_stage(const StageRun& run) {
  const VplPointParameters p = read_point_parameters(run);
  if (run.first % RAY_BLOCK != 0)
    throw Error::bad_input(run.where(), "items", "a range that begins at a multiple of 16", std::to_string(run.first));
  const double start = seconds_now();
  const MeshTables tables = mesh_tables(run, "irradiance", RADIOSITY_WORDS);
  BatchResult result;
  result.records.resize(run.count * 12);
  run_split(run, "shade.cl", result,
            [&](const Program& program, const cl::Buffer& parameters, WorkQueue& work, unsigned index) {
              return std::make_unique<ShadeThread>(run, tables, p, parameters, program, work, index);
            });
  result.counters.seconds = seconds_now() - start;
  return result;
}

}  // namespace gleaner::worker

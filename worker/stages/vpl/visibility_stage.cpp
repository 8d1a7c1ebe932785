// Stage kind "vpl_visibility": which clusters of lights each point cluster sees (kernels/vpl/visibility.cl).

#include <algorithm>

#include "kernels/path_layout.h"
#include "kernels/vpl_records.h"
#include "scene/model/error.h"
#include "worker/stages/vpl/records.h"
#include "worker/stages/vpl/stages.h"
#include "worker/stages/vpl/visibility_queries.h"
#include "worker/stages/vpl/waves.h"

namespace gleaner::worker {
namespace {

using kernels::VisibilityParameters;

struct VisibilityTables {
  cl::Buffer lights, points;
  std::size_t bytes() const { return lights.getInfo<CL_MEM_SIZE>() + points.getInfo<CL_MEM_SIZE>(); }
};

VisibilityTables make_tables(const StageRun& run, const VisibilityParameters& p) {
  const InputRows lights(run.task, "lights", VPL_WORDS * 4), points(run.task, "points", POINT_WORDS * 4);
  // Behind the lights may lie clusters' members.
  if (lights.rows() < p.clusters)
    throw Error::bad_input(run.where(), "input lights", std::to_string(p.clusters) + " rows or more",
                           std::to_string(lights.rows()));
  points.expect_rows(p.point_clusters);
  cl::CommandQueue queue = run.device.make_queue();
  const cl::Buffer table = run.device.make_buffer(std::size_t{p.clusters} * VPL_WORDS * 4 + 64);
  lights.upload(queue, table, 0, 0, p.clusters, check_light_rows(lights, run.scene));
  return {table, points.to_device(run.device, queue, check_point_rows(points, run.scene))};
}

class VisibilityThread : public HostThread {
 public:
  VisibilityThread(const StageRun& run, const VisibilityTables& tables, const VisibilityParameters& parameters,
                   WorkQueue& work, unsigned index)
      : HostThread(run.device, run.workspace, run.scene.tracer(), work, index),
        p_(parameters),
        first_item_(run.first),
        points_(tables.points),
        queries_(run, queue_, rays_, take("rays", std::size_t{ray_capacity(run.device)} * VISIBILITY_ROWS * 4),
                 device_counters(), tables.lights, parameters.clusters, 1),
        find_cutoff_(run.device, run.build_plain("visibility.cl"), "vpl_visibility_cutoff"),
        rows_(std::max<std::uint32_t>(1, 4 * ray_capacity(run.device) / p_.clusters)),
        bits_(take("bits", std::size_t{rows_} * p_.clusters / 8)),
        left_out_(take("left_out", std::size_t{rows_} * VISIBILITY_COUNTS * 4)),
        cutoff_(take("cutoff", std::size_t{rows_ + RAY_BLOCK} * 4)) {
    find_cutoff_.set("points", points_)
        .set("lights", tables.lights)
        .set("width", p_.clusters)
        .set("clamp_to", p_.clamp)
        .set("share", p_.cutoff)
        .set("cutoff", cutoff_);
  }

  void run(BatchResult& result) {
    const std::size_t words = p_.clusters / 32, stride = (words + VISIBILITY_COUNTS) * 4;
    std::vector<std::uint32_t> bits(rows_ * words), left_out(std::size_t{rows_} * VISIBILITY_COUNTS);
    while (const WorkQueue::Block block = work_.claim(rows_)) {
      const auto rows = static_cast<std::uint32_t>(block.count);
      const auto base = static_cast<std::uint32_t>(first_item_ + block.first);
      find_cutoffs(base, rows);
      counters.shadow += queries_.run({.points = points_,
                                       .chosen = nullptr,
                                       .point_base = base,
                                       .rows = rows,
                                       .cutoff = cutoff_,
                                       .clamp = p_.clamp,
                                       .bits = bits_,
                                       .left_out = left_out_});
      queue_.enqueueReadBuffer(bits_, CL_TRUE, 0, rows * words * 4, bits.data());
      queue_.enqueueReadBuffer(left_out_, CL_TRUE, 0, std::size_t{rows} * VISIBILITY_COUNTS * 4, left_out.data());
      std::byte* out = result.records.data() + block.first * stride;
      for (std::uint32_t r = 0; r < rows; ++r, out += stride) {
        std::memcpy(out, &bits[r * words], words * 4);
        std::memcpy(out + words * 4, &left_out[std::size_t{r} * VISIBILITY_COUNTS], VISIBILITY_COUNTS * 4);
      }
    }
  }

 private:
  void find_cutoffs(std::uint32_t base, std::uint32_t rows) {
    if (!(p_.cutoff > 0)) {
      queue_.enqueueFillBuffer(cutoff_, cl_float{0}, 0, std::size_t{rows} * 4);
      return;
    }
    find_cutoff_.set("point_base", base).set("count", rows);
    launch(find_cutoff_, rows, (rows_ + RAY_BLOCK - 1) / RAY_BLOCK * RAY_BLOCK);
  }

  VisibilityParameters p_;
  std::uint64_t first_item_;
  cl::Buffer points_;
  VisibilityQueries queries_;
  Kernel find_cutoff_;
  std::uint32_t rows_;  // points that query at a time
  cl::Buffer bits_, left_out_, cutoff_;
};

}  // namespace

BatchResult run_vpl_visibility_stage(const StageRun& run) {
  const auto p = run.parameters<VisibilityParameters>();
  if (p.clusters == 0 || p.clusters % 32 != 0 || p.clusters > (1u << 24))
    throw Error::bad_input(run.where(), "clusters", "a multiple of 32 up to 2^24", std::to_string(p.clusters));
  if (!(p.clamp > 0) || !(p.cutoff >= 0))
    throw Error::bad_input(run.where(), "clamp, cutoff", "a number above 0, and one that is not below", "others");
  run.check_range(p.point_clusters);
  const double start = seconds_now();
  BatchResult result;
  result.records.resize(run.count * (p.clusters / 32 + VISIBILITY_COUNTS) * 4);
  const auto tables = run.tables.get<VisibilityTables>(run.task, [&] { return make_tables(run, p); });
  WorkQueue work(run.count, host_threads(run.device));
  run_host_threads(work, result,
                   [&](unsigned index) { return std::make_unique<VisibilityThread>(run, *tables, p, work, index); });
  result.counters.seconds = seconds_now() - start;
  return result;
}

}  // namespace gleaner::worker

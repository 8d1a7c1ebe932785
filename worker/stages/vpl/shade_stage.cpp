// Stage kind "vpl_shade": pixels lit by virtual point lights (kernels/vpl/gather.cl).

#include <algorithm>
#include <optional>

#include "kernels/cluster_records.h"
#include "kernels/path_layout.h"
#include "scene/model/error.h"
#include "worker/stages/vpl/point_thread.h"
#include "worker/stages/vpl/residual.h"
#include "worker/stages/vpl/stages.h"
#include "worker/stages/vpl/waves.h"

namespace gleaner::worker {
namespace {

using kernels::VplPointParameters;

class ShadeThread : public PointThread {
 public:
  ShadeThread(const ShadeBatch& batch, WorkQueue& work, unsigned index)
      : PointThread(batch.run, batch.parameters, work, index, false),
        p_(batch.p),
        tables_(*batch.tables),
        shaded_{.points = points_,
                .lobes = lobes_,
                .rows = take("rows", room() * MAX_FUZZINESS * 4),
                .weights = take("weights", room() * MAX_FUZZINESS * 4),
                .level = take("level", room() * 4),
                .radiance = take("radiance", (room() + 1) * 3 * 4),
                .sampled = take("sampled", room() * 16)},
        unclustered_(take("unclustered", room() * 4)),
        records_(take("records", room() * 3 * 4)),
        report_(take("report", FiniteReport::kWords * 4)),
        chosen_(take("chosen", (std::size_t{own_rows()} + RAY_BLOCK) * 4)),
        memberships_(batch.run.device, program(batch), "vpl_memberships"),
        gather_(batch.run.device, program(batch), "vpl_gather"),
        resolve_(batch.run.device, program(batch), "vpl_resolve") {
    set_arguments(batch);
    if (p_.point_clusters && p_.residual_threshold > 0)
      residual_.emplace(batch, shaded_, queue_, rays_, capacity_,
                        [this](const std::string& name, std::size_t bytes) { return take(name, bytes); });
    else
      prepare_own_queries(batch);
  }

  void run(BatchResult& result) {
    while (const WorkQueue::Block block = work_.claim(capacity_ / p_.samples)) {
      // Whole rows of sixteen pixels: those beyond the block are the next one's, and dropped.
      const auto rows = static_cast<std::uint32_t>((block.count + RAY_BLOCK - 1) / RAY_BLOCK);
      const std::uint32_t paths = rows * RAY_BLOCK * p_.samples;
      find_points(block.first, paths);
      counters.camera -= paths - block.count * p_.samples;
      queue_.enqueueFillBuffer(shaded_.sampled, cl_float{0}, 0, std::size_t{paths} * 16);
      if (p_.point_clusters)
        gather_by_clusters(paths);
      else  // Points that are none stay as they are.
        queue_.enqueueFillBuffer(shaded_.radiance, cl_float{0}, 0, std::size_t{paths} * 12);
      if (residual_)
        counters.shadow += residual_->correct(paths);
      else
        gather_own_queries(paths);
      resolve(block, result);
    }
  }

 private:
  static Program program(const ShadeBatch& batch) { return batch.run.build("gather.cl", batch.fuzziness()); }

  std::size_t room() const { return capacity_ + RAY_BLOCK; }
  // Points that query every light at a time.
  std::uint32_t own_rows() const {
    const std::uint32_t rows = std::clamp<std::uint32_t>(ray_capacity(device_) / tables_.width, 1, 4096) + 15;
    return rows - rows % RAY_BLOCK;
  }

  void set_arguments(const ShadeBatch& batch) {
    memberships_.set("parameters", batch.parameters)
        .set("points", points_)
        .set("grid", tables_.grid)
        .set("cells", tables_.cells)
        .set("seeds", tables_.seeds)
        .set("least_cosine", CLUSTER_LEAST_COSINE)
        .set("rows", shaded_.rows)
        .set("weights", shaded_.weights)
        .set("unclustered", unclustered_);
    batch.run.scene.set_arguments(gather_);
    gather_.set("parameters", batch.parameters)
        .set("points", points_)
        .set("chosen", chosen_)
        .set("lights", tables_.lights)
        .set("width", tables_.width)
        .set("slices", p_.samples)
        .set("row_words", tables_.row_words)
        .set("rows", shaded_.rows)
        .set("weights", shaded_.weights)
        .set("behind", capacity_)
        .set("radiance", shaded_.radiance)
        .set("level", shaded_.level)
        .set("lobes", lobes_);
    resolve_.set("parameters", batch.parameters)
        .set("radiance", shaded_.radiance)
        .set("sampled", shaded_.sampled)
        .set("records", records_)
        .set("report", report_.buffer());
  }

  void gather_by_clusters(std::uint32_t paths) {
    memberships_.set("count", paths);
    launch(memberships_, paths, capacity_);
    gather_.set("own", cl_uint{0}).set("count", paths).set("bits", tables_.bits);
    launch(gather_, paths, capacity_);
  }

  void prepare_own_queries(const ShadeBatch& batch) {
    own_bits_ = take("own_bits", std::size_t{own_rows()} * tables_.width / 8);
    left_out_ = take("left_out", std::size_t{own_rows()} * VISIBILITY_COUNTS * 4);
    cutoff_ = take("cutoff", std::size_t{own_rows()} * 4);
    queue_.enqueueFillBuffer(cutoff_, cl_float{0}, 0, std::size_t{own_rows()} * 4);
    queries_.emplace(batch.run, queue_, rays_, take("rays", std::size_t{ray_capacity(device_)} * VISIBILITY_ROWS * 4),
                     device_counters(), tables_.lights, tables_.width, p_.samples);
  }

  // Points that belong to no cluster query every light, sixteen of one slice at a time.
  void gather_own_queries(std::uint32_t paths) {
    std::vector<std::uint32_t> unclustered(paths, 1u), list;
    if (p_.point_clusters)
      queue_.enqueueReadBuffer(unclustered_, CL_TRUE, 0, std::size_t{paths} * 4, unclustered.data());
    for (std::uint32_t slice = 0; slice < p_.samples; ++slice) {
      for (std::uint32_t block = slice; block < paths / RAY_BLOCK; block += p_.samples)
        for (std::uint32_t i = RAY_BLOCK * block; i < RAY_BLOCK * (block + 1); ++i)
          if (unclustered[i]) list.push_back(i);
      list.resize((list.size() + RAY_BLOCK - 1) / RAY_BLOCK * RAY_BLOCK, GLEANER_NONE);
    }
    for (std::size_t at = 0; at < list.size(); at += own_rows()) {
      const auto rows = static_cast<std::uint32_t>(std::min<std::size_t>(own_rows(), list.size() - at));
      queue_.enqueueWriteBuffer(chosen_, CL_TRUE, 0, std::size_t{rows} * 4, &list[at]);
      counters.shadow += queries_->run({.points = points_,
                                        .chosen = &chosen_,
                                        .rows = rows,
                                        .cutoff = cutoff_,
                                        .clamp = p_.clamp,
                                        .bits = own_bits_,
                                        .left_out = left_out_});
      gather_.set("own", cl_uint{1}).set("count", rows).set("bits", own_bits_);
      launch(gather_, rows, capacity_);
    }
  }

  // Sums the samples to the block's records.
  void resolve(const WorkQueue::Block& block, BatchResult& result) {
    report_.clear(queue_);
    resolve_.set("count", static_cast<cl_uint>(block.count));
    launch(resolve_, block.count, capacity_, 1);
    report_.add_to(counters, queue_, first_item_ + block.first);
    queue_.enqueueReadBuffer(records_, CL_TRUE, 0, block.count * 12, result.records.data() + block.first * 12);
  }

  VplPointParameters p_;
  const ShadeTables& tables_;
  ShadedPoints shaded_;
  cl::Buffer unclustered_, records_;
  FiniteReport report_;
  cl::Buffer chosen_;
  Kernel memberships_, gather_, resolve_;
  std::optional<ResidualSamples> residual_;
  // Where points query every light themselves.
  std::optional<VisibilityQueries> queries_;
  cl::Buffer own_bits_{}, left_out_{}, cutoff_{};
};

VplPointParameters read_shade_parameters(const StageRun& run) {
  const VplPointParameters p = read_point_parameters(run);
  if (run.first % RAY_BLOCK != 0)
    throw Error::bad_input(run.where(), "items", "a range that begins at a multiple of 16", std::to_string(run.first));
  if (p.clusters == 0 || p.clusters % (32 * p.samples) != 0 || p.clusters > (1u << 24))
    throw Error::bad_input(run.where(), "clusters", "a multiple of 32 times the samples", std::to_string(p.clusters));
  if (p.fuzziness == 0 || p.fuzziness > MAX_FUZZINESS)
    throw Error::bad_input(run.where(), "fuzziness", "1 to " + std::to_string(MAX_FUZZINESS),
                           std::to_string(p.fuzziness));
  return p;
}

}  // namespace

BatchResult run_vpl_shade_stage(const StageRun& run) {
  const VplPointParameters p = read_shade_parameters(run);
  const double start = seconds_now();
  BatchResult result;
  result.records.resize(run.count * 12);
  ShadeBatch batch{run, p, run.tables.get<ShadeTables>(run.task, [&] { return make_shade_tables(run, p); })};
  cl::CommandQueue queue = run.device.make_queue();
  batch.parameters = run.parameter_buffer(queue);
  WorkQueue work(run.count, host_threads(run.device));
  run_host_threads(work, result, [&](unsigned index) { return std::make_unique<ShadeThread>(batch, work, index); });
  result.counters.seconds = seconds_now() - start;
  return result;
}

}  // namespace gleaner::worker

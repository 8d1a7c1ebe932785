// Stage kind "links_albedo": what elements' diffuse layers reflect (kernels/links/albedo.cl).

#include "worker/stages/links/mesh.h"
#include "worker/stages/links/stages.h"
#include "worker/stages/links/waves.h"
#include "worker/stages/split_stage.h"

namespace gleaner::worker {
namespace {

class AlbedoThread : public HostThread {
 public:
  AlbedoThread(const StageRun& run, const MeshTables& tables, const LobeTables& lobes,
               const kernels::LinksParameters& p, const cl::Buffer& parameters, const Program& program, WorkQueue& work,
               unsigned index)
      : HostThread(run.device, run.workspace, run.scene.tracer(), work, index),
        first_item_(run.first),
        samples_(p.samples),
        capacity_(elements_of_wave(run.device, p.samples)),
        colors_(take("links.colors", std::size_t{capacity_} * samples_ * ALBEDO_WORDS * 4)),
        records_(take("links.records", std::size_t{capacity_} * ALBEDO_WORDS * 4)),
        sample_(run.device, program, "links_albedo_samples"),
        mean_(run.device, program, "links_albedo_mean") {
    run.scene.set_arguments(sample_);
    sample_.set("parameters", parameters).set("mesh", tables.mesh).set("lobes", lobes.lobes).set("colors", colors_);
    mean_.set("parameters", parameters).set("colors", colors_).set("records", records_);
  }

  void run(BatchResult& result) {
    while (const WorkQueue::Block block = work_.claim(capacity_)) {
      const auto count = static_cast<std::uint32_t>(block.count), samples = count * samples_;
      sample_.set("first", static_cast<cl_uint>(first_item_ + block.first)).set("count", samples);
      launch(sample_, samples, std::size_t{capacity_} * samples_);
      mean_.set("count", count);
      launch(mean_, count, capacity_, 1);
      constexpr std::size_t stride = ALBEDO_WORDS * 4;
      queue_.enqueueReadBuffer(records_, CL_TRUE, 0, count * stride, result.records.data() + block.first * stride);
    }
  }

 private:
  std::uint64_t first_item_;
  std::uint32_t samples_, capacity_;
  cl::Buffer colors_, records_;
  Kernel sample_, mean_;
};

}  // namespace

BatchResult run_links_albedo_stage(const StageRun& run) {
  const kernels::LinksParameters p = read_links_parameters(run);
  const double start = seconds_now();
  const MeshTables tables = mesh_tables(run, nullptr, 0);
  const LobeTables lobes = lobe_tables(run, tables);
  check_elements(run, p.elements, tables.layout.elements() + lobes.elements);
  BatchResult result;
  result.records.resize(run.count * ALBEDO_WORDS * 4);
  run_split(
      run, "albedo.cl", result,
      [&](const Program& program, const cl::Buffer& parameters, WorkQueue& work, unsigned index) {
        return std::make_unique<AlbedoThread>(run, tables, lobes, p, parameters, program, work, index);
      },
      lobes.options());
  result.counters.seconds = seconds_now() - start;
  return result;
}

}  // namespace gleaner::worker

// Stage kind "links_light": direct light of elements (kernels/links/light.cl).

#include "worker/stages/links/connecting_thread.h"
#include "worker/stages/links/mesh.h"
#include "worker/stages/links/stages.h"
#include "worker/stages/links/waves.h"
#include "worker/stages/split_stage.h"

namespace gleaner::worker {
namespace {

class LightThread : public ConnectingThread {
 public:
  LightThread(const StageRun& run, const MeshTables& tables, const LobeTables& lobes, const kernels::LinksParameters& p,
              const cl::Buffer& parameters, const Program& program, WorkQueue& work, unsigned index)
      : ConnectingThread(run, program, elements_of_wave(run.device, p.samples) * p.samples, work, index),
        first_item_(run.first),
        samples_(p.samples),
        capacity_(elements_of_wave(run.device, p.samples)),
        albedo_(tables.rows),
        own_albedo_(take("links.albedo", std::size_t{capacity_} * ALBEDO_WORDS * 4)),
        records_(take("links.records", std::size_t{capacity_} * RADIOSITY_WORDS * 4)),
        report_(take("report", FiniteReport::kWords * 4)),
        make_rays_(run.device, program, "links_light_rays"),
        sum_(run.device, program, "links_light_sum") {
    run.scene.set_arguments(make_rays_);
    make_rays_.set("parameters", parameters)
        .set("mesh", tables.mesh)
        .set("lobes", lobes.lobes)
        .set("shadows", shadows())
        .set("slots", slots())
        .set("slot_count", rays())
        .set("counters", device_counters());
    sum_.set("parameters", parameters)
        .set("slots", slots())
        .set("albedo", own_albedo_)
        .set("records", records_)
        .set("report", report_.buffer());
  }

  void run(BatchResult& result) {
    constexpr std::size_t stride = RADIOSITY_WORDS * 4, albedo_stride = ALBEDO_WORDS * 4;
    while (const WorkQueue::Block block = work_.claim(capacity_)) {
      const auto count = static_cast<std::uint32_t>(block.count);
      clear_device_counters();
      make_rays_.set("first", static_cast<cl_uint>(first_item_ + block.first)).set("count", count * samples_);
      launch(make_rays_, count * samples_, rays());
      connect(count * samples_);
      queue_.enqueueCopyBuffer(albedo_, own_albedo_, (first_item_ + block.first) * albedo_stride, 0,
                               count * albedo_stride);
      report_.clear(queue_);
      sum_.set("count", count);
      launch(sum_, count, capacity_, 1);
      report_.add_to(counters, queue_, first_item_ + block.first);
      queue_.enqueueReadBuffer(records_, CL_TRUE, 0, count * stride, result.records.data() + block.first * stride);
    }
  }

 private:
  std::uint32_t rays() const { return capacity_ * samples_; }

  std::uint64_t first_item_;
  std::uint32_t samples_, capacity_;
  cl::Buffer albedo_, own_albedo_, records_;
  FiniteReport report_;
  Kernel make_rays_, sum_;
};

}  // namespace

BatchResult run_links_light_stage(const StageRun& run) {
  const kernels::LinksParameters p = read_links_parameters(run);
  const double start = seconds_now();
  const MeshTables tables = mesh_tables(run, "albedo", ALBEDO_WORDS);
  const LobeTables lobes = lobe_tables(run, tables);
  InputRows(run.task, "albedo", ALBEDO_WORDS * 4).expect_rows(p.elements);
  check_elements(run, p.elements, tables.layout.elements() + lobes.elements);
  BatchResult result;
  result.records.resize(run.count * RADIOSITY_WORDS * 4);
  run_split(
      run, "light.cl", result,
      [&](const Program& program, const cl::Buffer& parameters, WorkQueue& work, unsigned index) {
        return std::make_unique<LightThread>(run, tables, lobes, p, parameters, program, work, index);
      },
      lobes.options());
  result.counters.seconds = seconds_now() - start;
  return result;
}

}  // namespace gleaner::worker

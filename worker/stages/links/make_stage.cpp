// Stage kind "links_make": links between elements (kernels/links/make.cl).

#include <bit>

#include "worker/stages/links/link_rays.h"
#include "worker/stages/links/stages.h"
#include "worker/wavefront/joined_records.h"

namespace gleaner::worker {
namespace {

class MakeThread : public LinkRayThread {
 public:
  MakeThread(const LinkRayBatch& batch, WorkQueue& work, JoinedRecords& records, unsigned index)
      : LinkRayThread(batch, work, index),
        joined_(records),
        row_bytes_(std::size_t{directions_} * (batch.lobes.elements ? 6 : 3) * 8),
        slots_(static_cast<std::uint32_t>(std::bit_ceil(row_bytes_ / 4))),
        ends_(take("links.ends", capacity_ * row_bytes_ / 2)),
        weights_(take("links.weights", capacity_ * row_bytes_ / 2)),
        table_(take("links.table", batch.p.compress ? std::size_t{capacity_} * slots_ * 4 : 4)),
        packed_(take("links.packed", capacity_ * row_bytes_)),
        words_(take("links.words", std::size_t{capacity_} * 4)),
        link_(batch.run.device, batch.program, "links_hits"),
        compress_(batch.run.device, batch.program, "links_compress") {
    batch.run.scene.set_arguments(link_);
    link_.set("mesh", batch.tables.mesh)
        .set("lobes", batch.lobes.lobes)
        .set("sides", batch.sides)
        .set("rays", hits_)
        .set("ends", ends_)
        .set("weights", weights_);
    compress_.set("parameters", batch.parameters)
        .set("plain", static_cast<cl_uint>(batch.tables.layout.elements()))
        .set("slots", slots_)
        .set("ends", ends_)
        .set("weights", weights_)
        .set("table", table_)
        .set("packed", packed_)
        .set("words", words_);
  }

  void run(BatchResult& result) {
    while (const WorkQueue::Block block = work_.claim(capacity_)) {
      const auto count = static_cast<std::uint32_t>(block.count);
      const std::uint32_t traced = trace(block.first, count);
      link_.set("count", traced);
      launch(link_, traced, rays());
      compress_.set("count", count);
      compress_.launch(queue_, {.work = count, .capacity = capacity_, .group = device_.info().cpu ? 1u : 0u});
      collect(block, result);
    }
  }

 private:
  void collect(const WorkQueue::Block& block, BatchResult& result) {
    std::uint32_t* counts = &result.counts[block.first];
    queue_.enqueueReadBuffer(words_, CL_TRUE, 0, block.count * 4, counts);
    std::size_t all = 0;
    for (std::uint64_t k = 0; k < block.count; ++k) all += counts[k];
    links_.resize(all * 4);
    std::byte* to = links_.data();
    for (std::uint64_t k = 0; k < block.count; ++k) {
      if (counts[k]) queue_.enqueueReadBuffer(packed_, CL_FALSE, k * row_bytes_, std::size_t{counts[k]} * 4, to);
      to += std::size_t{counts[k]} * 4;
    }
    queue_.finish();
    joined_.add(block.first, block.count, links_);
  }

  JoinedRecords& joined_;
  std::size_t row_bytes_;  // of an element's links: ends and weights
  std::uint32_t slots_;
  cl::Buffer ends_, weights_, table_, packed_, words_;
  Kernel link_, compress_;
  scene::Bytes links_;
};

}  // namespace

BatchResult run_links_make_stage(const StageRun& run) {
  const MeshTables tables = mesh_tables(run, nullptr, 0);
  const LobeTables lobes = lobe_tables(run, tables);
  LinkRayBatch batch{run, read_links_parameters(run), tables, lobes, run.build("make.cl", lobes.options())};
  check_elements(run, batch.p.elements, tables.layout.elements() + lobes.elements);
  batch.sides = element_sides(run, tables.layout.elements());
  const double start = seconds_now();
  BatchResult result;
  result.counts.resize(run.count);
  cl::CommandQueue queue = run.device.make_queue();
  batch.parameters = run.parameter_buffer(queue);
  WorkQueue work(run.count, host_threads(run.device));
  JoinedRecords records(run.count);
  run_host_threads(work, result,
                   [&](unsigned index) { return std::make_unique<MakeThread>(batch, work, records, index); });
  result.records = records.take();
  result.counters.seconds = seconds_now() - start;
  return result;
}

}  // namespace gleaner::worker

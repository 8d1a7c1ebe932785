// Stage kind "links_make": links between elements (kernels/links/make.cl).

#include <algorithm>
#include <bit>
#include <cmath>
#include <mutex>

#include "kernels/rays.h"
#include "worker/stages/links/mesh.h"
#include "worker/stages/links/stages.h"
#include "worker/stages/links/waves.h"
#include "worker/wavefront/host_threads.h"
#include "worker/wavefront/path_wave.h"

namespace gleaner::worker {
namespace {

// A block of elements, done: its links, one element's behind the other's.
struct MadeLinks {
  std::uint64_t first = 0;
  scene::Bytes words;
};

// Puts the threads' blocks together in the order of their elements.
class Collected {
 public:
  void add(MadeLinks&& made) {
    std::lock_guard lock(mutex_);
    all_.push_back(std::move(made));
  }
  scene::Bytes records() {
    std::ranges::sort(all_, {}, &MadeLinks::first);
    std::size_t bytes = 0;
    for (const MadeLinks& one : all_) bytes += one.words.size();
    scene::Bytes records;
    records.reserve(bytes);
    for (MadeLinks& one : all_) {
      records.insert(records.end(), one.words.begin(), one.words.end());
      one.words = {};
    }
    return records;
  }

 private:
  std::mutex mutex_;
  std::vector<MadeLinks> all_;
};

class MakeThread : public HostThread {
 public:
  MakeThread(const StageRun& run, const MeshTables& tables, const kernels::LinksParameters& p,
             const cl::Buffer& parameters, const Program& program, WorkQueue& work, Collected& collected,
             unsigned index)
      : HostThread(run.device, run.workspace, run.scene.tracer(), work, index),
        collected_(collected),
        first_item_(run.first),
        directions_(p.directions),
        capacity_(elements_of_wave(run.device, p.directions)),
        slots_(std::bit_ceil(6 * p.directions)),
        paths_(take("paths", PathWave::bytes(rays(), RAY_HIT_ROWS + 1))),
        ends_(take("links.ends", std::size_t{rays()} * 12)),
        weights_(take("links.weights", std::size_t{rays()} * 12)),
        table_(take("links.table", p.compress ? std::size_t{capacity_} * slots_ * 4 : 4)),
        packed_(take("links.packed", std::size_t{rays()} * 24)),
        words_(take("links.words", std::size_t{capacity_} * 4)),
        make_rays_(run.device, program, "links_rays"),
        hits_(run.device, program, "links_hits"),
        compress_(run.device, program, "links_compress") {
    run.scene.set_arguments(make_rays_);
    make_rays_.set("parameters", parameters)
        .set("mesh", tables.mesh)
        .set("side", static_cast<cl_uint>(std::lround(std::sqrt(p.directions))))
        .set("rays", paths_);
    run.scene.set_arguments(hits_);
    hits_.set("mesh", tables.mesh).set("rays", paths_).set("ends", ends_).set("weights", weights_);
    compress_.set("parameters", parameters)
        .set("slots", slots_)
        .set("ends", ends_)
        .set("weights", weights_)
        .set("table", table_)
        .set("packed", packed_)
        .set("words", words_);
  }

  void run(BatchResult& result) {
    while (const WorkQueue::Block block = work_.claim(capacity_)) {
      const auto count = static_cast<std::uint32_t>(block.count), rays_here = count * directions_;
      make_rays_.set("first", static_cast<cl_uint>(first_item_ + block.first)).set("count", rays_here);
      launch(make_rays_, rays_here, rays());
      counters.scatter += rays_here;
      rays_.closest(paths_, single_rays(RAY_HIT_ROWS + 1, rays_here));
      hits_.set("count", rays_here);
      launch(hits_, rays_here, rays());
      compress_.set("count", count);
      launch(compress_, count, capacity_, 1);
      collect(block, result);
    }
  }

 private:
  std::uint32_t rays() const { return capacity_ * directions_; }

  void collect(const WorkQueue::Block& block, BatchResult& result) {
    std::uint32_t* counts = &result.counts[block.first];
    queue_.enqueueReadBuffer(words_, CL_TRUE, 0, block.count * 4, counts);
    std::size_t all = 0;
    for (std::uint64_t k = 0; k < block.count; ++k) all += counts[k];
    MadeLinks links{block.first, scene::Bytes(all * 4)};
    std::byte* to = links.words.data();
    for (std::uint64_t k = 0; k < block.count; ++k) {
      if (counts[k]) queue_.enqueueReadBuffer(packed_, CL_FALSE, k * directions_ * 24, std::size_t{counts[k]} * 4, to);
      to += std::size_t{counts[k]} * 4;
    }
    queue_.finish();
    collected_.add(std::move(links));
  }

  Collected& collected_;
  std::uint64_t first_item_;
  std::uint32_t directions_, capacity_, slots_;
  cl::Buffer paths_, ends_, weights_, table_, packed_, words_;
  Kernel make_rays_, hits_, compress_;
};

}  // namespace

BatchResult run_links_make_stage(const StageRun& run) {
  const kernels::LinksParameters p = read_links_parameters(run);
  const double start = seconds_now();
  const auto tables = mesh_tables(run, nullptr, 0);
  check_elements(run, p.elements, tables->layout.elements());
  BatchResult result;
  result.counts.resize(run.count);
  cl::CommandQueue queue = run.device.make_queue();
  const cl::Buffer parameters = run.parameter_buffer(queue);
  const Program program = run.build("make.cl");
  WorkQueue work(run.count, host_threads(run.device));
  Collected collected;
  run_host_threads(work, result, [&](unsigned index) {
    return std::make_unique<MakeThread>(run, *tables, p, parameters, program, work, collected, index);
  });
  result.records = collected.records();
  result.counters.seconds = seconds_now() - start;
  return result;
}

}  // namespace gleaner::worker

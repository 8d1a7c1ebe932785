// Stage kind "links_audit": how far the light between vertices is off (kernels/links/audit.cl).

#include <cmath>

#include "kernels/path_layout.h"
#include "kernels/vpl_records.h"
#include "worker/stages/links/connecting_thread.h"
#include "worker/stages/links/mesh.h"
#include "worker/stages/links/stages.h"
#include "worker/stages/links/waves.h"
#include "worker/stages/split_stage.h"
#include "worker/stages/vpl/records.h"
#include "worker/wavefront/path_wave.h"

namespace gleaner::worker {
namespace {

// The ray and its hit, and one row more.
constexpr unsigned kRows = RAY_HIT_ROWS + 1;
// What a ray sees: SEEN_WORDS of the program.
constexpr std::size_t kSeenBytes = 6 * 4;

// What a batch's threads share.
struct AuditBatch {
  const StageRun& run;
  kernels::LinksParameters p;
  cl::Buffer mesh{}, sides{}, radiosity{}, albedo{};
  LobeTables lobes{};
  cl::Buffer points{};  // of all items
  Program shading;      // has links_interpolate
};

class AuditThread : public ConnectingThread {
 public:
  AuditThread(const AuditBatch& batch, const cl::Buffer& parameters, const Program& program, WorkQueue& work,
              unsigned index)
      : ConnectingThread(batch.run, program, rays_of(batch), work, index),
        first_item_(batch.run.first),
        directions_(batch.p.directions),
        capacity_(elements_of_wave(batch.run.device, 2 * batch.p.directions)),
        all_points_(batch.points),
        hits_(take("paths", PathWave::bytes(rays(), kRows))),
        points_(take("points", std::size_t{capacity_ + RAY_BLOCK} * POINT_WORDS * 4)),
        shown_(take("radiance", std::size_t{capacity_ + RAY_BLOCK} * 12)),
        seen_(take("links.seen", std::size_t{rays()} * kSeenBytes)),
        records_(take("links.records", std::size_t{capacity_} * AUDIT_WORDS * 4)),
        report_(take("report", FiniteReport::kWords * 4)),
        make_rays_(batch.run.device, program, "links_audit_rays"),
        look_(batch.run.device, program, "links_audit_hits"),
        sum_(batch.run.device, program, "links_audit_sum"),
        interpolate_(batch.run.device, batch.shading, "links_interpolate") {
    for (Kernel* kernel : {&make_rays_, &look_, &interpolate_}) batch.run.scene.set_arguments(*kernel);
    make_rays_.set("parameters", parameters)
        .set("points", points_)
        .set("side", static_cast<cl_uint>(std::lround(std::sqrt(directions_))))
        .set("rays", hits_);
    look_.set("parameters", parameters)
        .set("mesh", batch.mesh)
        .set("lobes", batch.lobes.lobes)
        .set("sides", batch.sides)
        .set("albedos", batch.albedo)
        .set("radiosity", batch.radiosity)
        .set("rays", hits_)
        .set("seen", seen_)
        .set("shadows", shadows())
        .set("slots", slots())
        .set("slot_count", rays())
        .set("counters", device_counters());
    interpolate_.set("mesh", batch.mesh)
        .set("irradiance", batch.radiosity)
        .set("points", points_)
        .set("radiance", shown_);
    sum_.set("parameters", parameters)
        .set("points", points_)
        .set("shown", shown_)
        .set("seen", seen_)
        .set("slots", slots())
        .set("records", records_)
        .set("report", report_.buffer());
  }

  void run(BatchResult& result) {
    constexpr std::size_t stride = AUDIT_WORDS * 4, point_stride = POINT_WORDS * 4;
    while (const WorkQueue::Block block = work_.claim(capacity_)) {
      const auto count = static_cast<std::uint32_t>(block.count);
      const std::uint32_t here = 2 * count * directions_;
      const std::uint64_t first = first_item_ + block.first;
      queue_.enqueueCopyBuffer(all_points_, points_, first * point_stride, 0, count * point_stride);
      make_rays_.set("first", static_cast<cl_uint>(first)).set("count", here);
      launch(make_rays_, here, rays());
      counters.scatter += here;
      rays_.closest(hits_, single_rays(kRows, here));
      clear_device_counters();
      look_.set("first", static_cast<cl_uint>(first)).set("count", here);
      launch(look_, here, rays());
      connect(here);
      interpolate_.set("count", count);
      launch(interpolate_, count, capacity_);
      report_.clear(queue_);
      sum_.set("count", count);
      launch(sum_, count, capacity_, 1);
      report_.add_to(counters, queue_, first);
      queue_.enqueueReadBuffer(records_, CL_TRUE, 0, count * stride, result.records.data() + block.first * stride);
    }
  }

 private:
  static std::uint32_t rays_of(const AuditBatch& batch) {
    return elements_of_wave(batch.run.device, 2 * batch.p.directions) * 2 * batch.p.directions;
  }
  std::uint32_t rays() const { return 2 * capacity_ * directions_; }  // of a wave

  std::uint64_t first_item_;
  std::uint32_t directions_, capacity_;  // points of a wave
  cl::Buffer all_points_, hits_, points_, shown_, seen_, records_;
  FiniteReport report_;
  Kernel make_rays_, look_, sum_, interpolate_;
};

}  // namespace

BatchResult run_links_audit_stage(const StageRun& run) {
  AuditBatch batch{.run = run, .p = read_links_parameters(run), .shading = run.build("shade.cl")};
  const double start = seconds_now();
  const MeshTables tables = mesh_tables(run, nullptr, 0);
  batch.mesh = tables.mesh;
  batch.sides = element_sides(run, tables.layout.elements());
  batch.lobes = lobe_tables(run, tables);
  batch.albedo = tables.mesh;  // read for lobes alone
  if (batch.lobes.elements) batch.albedo = mesh_tables(run, "albedo", ALBEDO_WORDS).rows;
  InputRows(run.task, "irradiance", RADIOSITY_WORDS * 4).expect_rows(tables.layout.elements() + batch.lobes.elements);
  batch.radiosity = mesh_tables(run, "irradiance", RADIOSITY_WORDS).rows;
  const InputRows points(run.task, "points", POINT_WORDS * 4);
  points.expect_rows(batch.p.elements);
  cl::CommandQueue queue = run.device.make_queue();
  batch.points = points.to_device(run.device, queue, check_point_rows(points, run.scene));
  BatchResult result;
  result.records.resize(run.count * AUDIT_WORDS * 4);
  run_split(
      run, "audit.cl", result,
      [&](const Program& program, const cl::Buffer& parameters, WorkQueue& work, unsigned index) {
        return std::make_unique<AuditThread>(batch, parameters, program, work, index);
      },
      batch.lobes.options());
  result.counters.seconds = seconds_now() - start;
  return result;
}

}  // namespace gleaner::worker

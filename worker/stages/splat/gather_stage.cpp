// Stage kind "splat_gather": the light that arrives at records (kernels/splat/gather.cl).

#include <algorithm>
#include <cmath>
#include <cstring>

#include "scene/model/error.h"
#include "worker/stages/path_stage.h"
#include "worker/stages/splat/irradiance.h"
#include "worker/stages/splat/stages.h"
#include "worker/wavefront/input_rows.h"

namespace gleaner::worker {
namespace {

using kernels::SplatGatherParameters;

// Slots of paths in flight; a batch beyond this runs in parts.
constexpr std::uint32_t kMostPaths = 1u << 19;
constexpr std::size_t kSlotBytes = FILTERED_SLOT_WORDS * 4;

SplatGatherParameters read_parameters(const StageRun& run) {
  const auto p = run.parameters<SplatGatherParameters>();
  if (p.samples.filter != PATH_CLASS_IRRADIANCE)
    throw Error::bad_input(run.where(), "filter", std::to_string(PATH_CLASS_IRRADIANCE),
                           std::to_string(p.samples.filter));
  if (p.samples.features) throw Error::bad_input(run.where(), "features", "0", std::to_string(p.samples.features));
  const std::uint64_t strata = std::uint64_t{p.polar} * p.azimuthal;
  if (strata == 0 || strata > SPLAT_MOST_RAYS || p.azimuthal % RAY_BLOCK != 0)
    throw Error::bad_input(run.where(), "strata", "rings of a multiple of 16, up to " + std::to_string(SPLAT_MOST_RAYS),
                           std::to_string(p.polar) + " x " + std::to_string(p.azimuthal));
  run.check_range(p.records);
  return p;
}

// The batch's places, on the host and behind each other on the device.
struct Places {
  std::vector<SplatPoint> rows;
  cl::Buffer buffer;
};

Places read_places(const StageRun& run, const SplatGatherParameters& p, cl::CommandQueue& queue) {
  const InputRows input(run.task, "places", sizeof(SplatPoint));
  input.expect_rows(p.records);
  Places places;
  places.rows.resize(run.count);
  input.visit(run.first, run.count, [&](std::uint64_t first, std::span<const std::byte> piece) {
    std::memcpy(&places.rows[first - run.first], piece.data(), piece.size());
  });
  for (std::size_t i = 0; i < places.rows.size(); ++i) {
    const SplatPoint& place = places.rows[i];
    const std::uint64_t row = run.first + i;
    for (std::size_t k = 0; k < 3; ++k)
      if (!std::isfinite(place.position[k]) || !(std::abs(place.normal[k]) <= 1.001f))
        input.fail(row, "position", "a place and a unit vector", "others");
    if (!(place.factor[0] > 0) || !std::isfinite(place.factor[0]))
      input.fail(row, "radius", "metres above 0", std::to_string(place.factor[0]));
    if (place.table != GLEANER_NONE && !run.scene.has_albedo_row(place.table, place.row))
      input.fail(row, "table", "an albedo table of the scene", std::to_string(place.table));
  }
  places.buffer = run.workspace.take("splat.places", (places.rows.size() + 1) * sizeof(SplatPoint));
  queue.enqueueWriteBuffer(places.buffer, CL_TRUE, 0, places.rows.size() * sizeof(SplatPoint), places.rows.data());
  return places;
}

class GatherThread : public PathThread {
 public:
  GatherThread(const SamplePart& part, Workspace& workspace, WorkQueue& work, unsigned index, const cl::Buffer& places,
               std::uint32_t first_record)
      : PathThread(part, workspace, work, index), first_hits_(part.device, part.program, "splat_first_hits") {
    part.scene.set_arguments(generate_);
    generate_.set("places", places).set("first_record", first_record);
    first_hits_.set("slots", part.slots).set("slot_count", part.slot_count());
  }

 private:
  std::uint32_t step(const RayRange& range, std::uint32_t fresh) override {
    // No camera sent these.
    counters.camera -= fresh;
    counters.scatter += fresh;
    first_hits_.set("paths", wave_.paths()).set("base", wave_.fresh_base()).set("count", fresh);
    if (fresh) launch(first_hits_, fresh);
    return PathThread::step(range, fresh);
  }

  Kernel first_hits_;
};

// One record of its rays' slots. Light that is not finite is left out and counted.
CacheRecord record_of(const SplatPoint& place, const HemisphereGrid& grid, const float* slots, ThreadCounters& counters,
                      std::uint64_t item) {
  std::vector<HemisphereSample> samples(grid.strata());
  std::uint64_t lost = 0;
  for (HemisphereSample& sample : samples) {
    const float* light = slots + SLOT_INDIRECT;
    sample = {{light[0], light[1], light[2]}, slots[9], slots[10], slots[11]};
    if (!std::isfinite(light[0]) || !std::isfinite(light[1]) || !std::isfinite(light[2])) {
      sample.radiance = {};
      ++lost;
    }
    slots += FILTERED_SLOT_WORDS;
  }
  counters.nonfinite += lost;
  if (lost && counters.nonfinite_items.size() < REPORTED_ITEMS) counters.nonfinite_items.push_back(item);
  return cache_record(place, grid, samples);
}

// Makes the records of a part's places, by all host threads.
void make_records(const StageRun& run, const SamplePart& part, std::span<const SplatPoint> places,
                  const HemisphereGrid& grid, std::byte* records, BatchResult& result, cl::CommandQueue& queue) {
  std::vector<float> slots(std::size_t{part.paths} * FILTERED_SLOT_WORDS);
  queue.enqueueReadBuffer(part.slots, CL_TRUE, 0, part.paths * kSlotBytes, slots.data());
  const unsigned threads = host_threads(run.device);
  std::vector<ThreadCounters> counters(threads);
  run_threads(threads, [&](unsigned thread) {
    const double start = seconds_now();
    for (std::size_t i = thread; i < places.size(); i += threads) {
      const CacheRecord record = record_of(places[i], grid, &slots[i * grid.strata() * FILTERED_SLOT_WORDS],
                                           counters[thread], part.first_item + i);
      std::memcpy(records + i * sizeof record, &record, sizeof record);
    }
    counters[thread].all = seconds_now() - start;
  });
  for (const ThreadCounters& one : counters) one.add_to(result.counters, threads);
}

}  // namespace

BatchResult run_splat_gather_stage(const StageRun& run) {
  const SplatGatherParameters p = read_parameters(run);
  const double start = seconds_now();
  const HemisphereGrid grid{p.polar, p.azimuthal};
  cl::CommandQueue queue = run.device.make_queue();
  const Places places = read_places(run, p, queue);
  BatchResult result;
  result.records.resize(run.count * sizeof(CacheRecord));
  SamplePart part{.device = run.device, .scene = run.scene, .program = run.build("gather.cl")};
  part.parameters = run.parameter_buffer(queue);
  part.generator = "splat_gather_rays";
  part.features = run.workspace.take("path.features", 64);
  const std::uint64_t part_items = std::max(1u, kMostPaths / grid.strata());
  for (std::uint64_t done = 0; done < run.count; done += part_items) {
    part.first_item = run.first + done;
    part.item_count = static_cast<std::uint32_t>(std::min(part_items, run.count - done));
    part.paths = part.item_count * grid.strata();
    part.slots = run.workspace.take("path.slots", (std::size_t{part.slot_count()} + 1) * kSlotBytes);
    WorkQueue work(part.paths, host_threads(run.device), 1024);
    run_host_threads(work, result, [&](unsigned index) {
      return std::make_unique<GatherThread>(part, run.workspace, work, index, places.buffer,
                                            static_cast<std::uint32_t>(done));
    });
    make_records(run, part, std::span(places.rows).subspan(done, part.item_count), grid,
                 result.records.data() + done * sizeof(CacheRecord), result, queue);
  }
  result.counters.seconds = seconds_now() - start;
  return result;
}

}  // namespace gleaner::worker

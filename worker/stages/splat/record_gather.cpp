#include "worker/stages/splat/record_gather.h"

#include <algorithm>
#include <cmath>
#include <cstring>

#include "scene/model/error.h"
#include "worker/wavefront/input_rows.h"

namespace gleaner::worker {
namespace {

using kernels::SplatGatherParameters;

// Slots of paths in flight; a batch beyond this runs in parts.
constexpr std::uint32_t kMostPaths = 1u << 19;
constexpr std::size_t kSlotBytes = FILTERED_SLOT_WORDS * 4;

struct Places {
  std::vector<SplatPoint> points;
  std::vector<Clearance> clearances;  // of rows that have them
};

Places read_places(const StageRun& run, const SplatGatherParameters& p, std::size_t row_bytes) {
  const InputRows input(run.task, "places", row_bytes);
  const std::uint64_t stride = std::max(1u, p.place_stride);
  const std::uint64_t needed = p.records ? p.first_place + (p.records - 1) * stride + 1 : p.first_place;
  if (!p.place_stride || input.rows() < needed) input.expect_rows(needed);
  Places places{.points = std::vector<SplatPoint>(run.count), .clearances = {}};
  if (row_bytes == sizeof(SplatPlace)) places.clearances.resize(run.count);
  std::vector<SplatPoint>& rows = places.points;
  const std::uint64_t first_row = p.first_place + run.first * stride;
  const std::uint64_t span = run.count ? (run.count - 1) * stride + 1 : 0;
  input.visit(first_row, span, [&](std::uint64_t first, std::span<const std::byte> piece) {
    for (std::size_t at = 0; at < piece.size(); at += row_bytes) {
      const std::uint64_t row = first - first_row + at / row_bytes;
      if (row % stride) continue;
      const std::size_t i = row / stride;
      std::memcpy(&rows[i], piece.data() + at, sizeof(SplatPoint));
      if (!places.clearances.empty())
        std::memcpy(&places.clearances[i], piece.data() + at + SPLAT_CLEARANCE * 4, sizeof(Clearance));
    }
  });
  for (std::size_t i = 0; i < rows.size(); ++i) {
    const SplatPoint& place = rows[i];
    const std::uint64_t row = first_row + i * stride;
    for (std::size_t k = 0; k < 3; ++k)
      if (!std::isfinite(place.position[k]) || !(std::abs(place.normal[k]) <= 1.001f))
        input.fail(row, "position", "a place and a unit vector", "others");
    if (!(place.factor[0] > 0) || !std::isfinite(place.factor[0]))
      input.fail(row, "radius", "metres above 0", std::to_string(place.factor[0]));
    if (!(place.factor[1] > 0) || !std::isfinite(place.factor[1]))
      input.fail(row, "accuracy", "a number above 0", std::to_string(place.factor[1]));
    if (!(place.factor[2] >= 0) || !std::isfinite(place.factor[2]))
      input.fail(row, "spacing", "metres, not negative", std::to_string(place.factor[2]));
    if (const std::uint32_t table = place.albedo_table();
        table != GLEANER_NONE && !run.scene.has_albedo_row(table, place.row))
      input.fail(row, "table", "an albedo table of the scene", std::to_string(table));
  }
  for (std::size_t i = 0; i < places.clearances.size(); ++i)
    for (const float one_over : places.clearances[i])
      if (!(one_over >= 0) || !std::isfinite(one_over))
        input.fail(first_row + i * stride, "clearance", "1/m, not negative", std::to_string(one_over));
  return places;
}

// A record of its rays' slots. Light that is not finite is left out and counted.
void make_record(const SplatPoint& place, const HemisphereGrid& grid, const float* slots, const RecordMaker& maker,
                 ThreadCounters& counters, std::uint64_t item, std::byte* record) {
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
  maker.make(place, grid, samples, record);
}

void set_clearance(std::byte* record, const Clearance& clearance) {
  const float least = least_clear(clearance);
  std::memcpy(record + CACHE_LEAST_CLEAR * 4, &least, sizeof least);
  std::memcpy(record + CACHE_CLEARANCE * 4, &clearance, sizeof clearance);
}

// Makes the records of the places of a part, which begins with place `done` of the batch, by all host threads.
void make_records(const StageRun& run, const SamplePart& part, const Places& places, std::uint64_t done,
                  const HemisphereGrid& grid, const RecordMaker& maker, BatchResult& result, cl::CommandQueue& queue) {
  std::vector<float> slots(std::size_t{part.paths} * FILTERED_SLOT_WORDS);
  queue.enqueueReadBuffer(part.slots, CL_TRUE, 0, part.paths * kSlotBytes, slots.data());
  const unsigned threads = host_threads(run.device);
  std::vector<ThreadCounters> counters(threads);
  run_threads(threads, [&](unsigned thread) {
    const double start = seconds_now();
    for (std::size_t i = thread; i < part.item_count; i += threads) {
      std::byte* record = result.records.data() + (done + i) * maker.bytes;
      make_record(places.points[done + i], grid, &slots[i * grid.strata() * FILTERED_SLOT_WORDS], maker,
                  counters[thread], part.first_item + i, record);
      if (!places.clearances.empty()) set_clearance(record, places.clearances[done + i]);
    }
    counters[thread].all = seconds_now() - start;
  });
  for (const ThreadCounters& one : counters) one.add_to(result.counters, threads);
}

}  // namespace

void check_record_parameters(const StageRun& run, const SplatGatherParameters& p) {
  if (p.samples.features) throw Error::bad_input(run.where(), "features", "0", std::to_string(p.samples.features));
  if (p.samples.seen) throw Error::bad_input(run.where(), "seen", "0", std::to_string(p.samples.seen));
  const std::uint64_t strata = std::uint64_t{p.polar} * p.azimuthal;
  if (strata == 0 || strata > SPLAT_MOST_RAYS || p.azimuthal % RAY_BLOCK != 0)
    throw Error::bad_input(run.where(), "strata", "rings of a multiple of 16, up to " + std::to_string(SPLAT_MOST_RAYS),
                           std::to_string(p.polar) + " x " + std::to_string(p.azimuthal));
  run.check_range(p.records);
}

BatchResult gather_records(const StageRun& run, const SplatGatherParameters& p, const Program& program,
                           const MakeRecordThread& make_thread, const RecordMaker& maker) {
  const double start = seconds_now();
  const HemisphereGrid grid{p.polar, p.azimuthal};
  cl::CommandQueue queue = run.device.make_queue();
  const Places read = read_places(run, p, maker.place_bytes);
  const std::vector<SplatPoint>& rows = read.points;
  PlaceTable places{.buffer = run.workspace.take("splat.places", (rows.size() + 1) * sizeof(SplatPoint))};
  queue.enqueueWriteBuffer(places.buffer, CL_TRUE, 0, rows.size() * sizeof(SplatPoint), rows.data());
  BatchResult result;
  result.records.resize(run.count * maker.bytes);
  SamplePart part{.device = run.device, .scene = run.scene, .program = program};
  part.parameters = run.parameter_buffer(queue);
  part.generator = "splat_gather_rays";
  part.features = run.workspace.take("path.features", 64);
  const std::uint64_t part_items = std::max(1u, kMostPaths / grid.strata());
  for (std::uint64_t done = 0; done < run.count; done += part_items) {
    places.first = static_cast<std::uint32_t>(done);
    part.first_item = run.first + done;
    part.item_count = static_cast<std::uint32_t>(std::min(part_items, run.count - done));
    part.paths = part.item_count * grid.strata();
    part.slots = run.workspace.take("path.slots", (std::size_t{part.slot_count()} + 1) * kSlotBytes);
    WorkQueue work(part.paths, host_threads(run.device), 1024);
    run_host_threads(work, result, [&](unsigned index) { return make_thread(places, part, work, index); });
    make_records(run, part, read, done, grid, maker, result, queue);
  }
  result.counters.seconds = seconds_now() - start;
  return result;
}

}  // namespace gleaner::worker

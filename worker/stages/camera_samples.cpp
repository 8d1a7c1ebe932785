#include "worker/stages/camera_samples.h"

#include <algorithm>
#include <bit>
#include <optional>

#include "scene/model/error.h"
#include "worker/wavefront/input_rows.h"

namespace gleaner::worker {
namespace {

using kernels::PathFeatureRecord;
using kernels::PathItem;
using kernels::PathParameters;
using kernels::PathRecord;

// Slots of paths in flight take 32 bytes each; a batch beyond this runs in parts.
constexpr std::uint64_t kMostPaths = std::uint64_t{1} << 19;

// Items summed by one launch of camera_resolve.
constexpr std::uint32_t kResolveItems = 1u << 14;

// The fewest paths that a host thread claims: fewer cost more in launches than they save in waiting at the end.
constexpr std::uint64_t kLeastPaths = 1024;

// Paths that move in step. CPU: small enough for a core's own cache, large enough that a kernel's launch does not show.
std::uint32_t wave_size(const Device& device) { return device.info().cpu ? 1u << 12 : 1u << 20; }

// The list of items, where the stage has one.
struct ItemList {
  InputRows rows;
  std::uint64_t first_row = 0;  // of the batch's first item
};

std::optional<ItemList> find_list(const StageRun& run, const PathParameters& p) {
  if (!run.task.inputs.contains("items")) return {};
  ItemList list{InputRows(run.task, "items", sizeof(PathItem))};
  list.first_row = list.rows.first_row_of(run.first, run.count, wide(p.items_high, p.items_low));
  return list;
}

void upload_list(const ItemList& list, cl::CommandQueue& queue, const cl::Buffer& to, std::uint64_t first,
                 std::uint64_t count, std::uint64_t pixels) {
  list.rows.upload(queue, to, 0, list.first_row + first, count,
                   [&](std::uint64_t row, std::span<const std::byte> piece) {
                     for (std::size_t at = 0; at < piece.size(); at += sizeof(PathItem), ++row) {
                       const auto pixel = row_word<std::uint32_t>(&piece[at], 0);
                       if (pixel >= pixels)
                         list.rows.fail(row, "pixel", "below " + std::to_string(pixels), std::to_string(pixel));
                     }
                   });
}

// The program of camera rays, in the variant that lays paths and slots out as the stage's own program does.
Program camera_program(const StageRun& run, bool filtered) {
  return run.build_plain("camera_samples.cl", run.scene.layout_options() + (filtered ? " -D PATH_FILTER=1" : ""));
}

// Sums the paths' slots to the items' records, at `out`.
void resolve(const StageRun& run, cl::CommandQueue& queue, const SamplePart& part, std::size_t record_bytes,
             std::byte* out, BatchCounters& counters) {
  const double start = seconds_now();
  cl::Buffer records = run.workspace.take("records", part.item_count * record_bytes);
  FiniteReport report(run.workspace.take("report", FiniteReport::kWords * 4));
  report.clear(queue);
  Kernel kernel(run.device, part.camera, "camera_resolve");
  kernel.set("parameters", part.parameters)
      .set_words("first_item", part.first_item)
      .set("count", part.item_count)
      .set("slots", part.slots)
      .set("features", part.features)
      .set("records", records)
      .set("report", report.buffer());
  // In pieces of one size (Kernel::launch says why).
  for (std::uint32_t base = 0; base < part.item_count; base += kResolveItems) {
    kernel.set("base", base);
    kernel.launch(queue, {.work = kResolveItems, .capacity = kResolveItems});
  }
  ThreadCounters own;
  report.add_to(own, queue, part.first_item);
  queue.enqueueReadBuffer(records, CL_TRUE, 0, part.item_count * record_bytes, out);
  own.all = seconds_now() - start;
  own.add_to(counters, 1);
}

}  // namespace

void check_sample_parameters(const StageRun& run, const PathParameters& p, std::uint32_t classes) {
  run.check_film(p.camera, p.width, p.height);
  if (!std::has_single_bit(p.samples_per_item) || p.samples_per_item > GLEANER_PATH_MAX_ITEM_SAMPLES)
    throw Error::bad_input(run.where(), "samples_per_item",
                           "a power of two up to " + std::to_string(GLEANER_PATH_MAX_ITEM_SAMPLES),
                           std::to_string(p.samples_per_item));
  if (p.last_item_samples == 0 || p.last_item_samples > p.samples_per_item)
    throw Error::bad_input(run.where(), "last_item_samples", "1 to samples_per_item",
                           std::to_string(p.last_item_samples));
  if (p.filter & ~classes && p.filter != PATH_CLASS_RADIOSITY && p.filter != PATH_CLASS_SAMPLED_RADIOSITY &&
      p.filter != PATH_CLASS_METAL_RADIOSITY && p.filter != PATH_CLASS_IRRADIANCE && p.filter != PATH_CLASS_RADIANCE)
    throw Error::bad_input(run.where(), "filter",
                           "classes of light within " + std::to_string(classes) + ", or " +
                               std::to_string(PATH_CLASS_RADIOSITY) + ", " + std::to_string(PATH_CLASS_IRRADIANCE) +
                               ", " + std::to_string(PATH_CLASS_RADIANCE) + " or " +
                               std::to_string(PATH_CLASS_SAMPLED_RADIOSITY),
                           std::to_string(p.filter));
  if (p.seen > PATH_SEEN_ALONE) throw Error::bad_input(run.where(), "seen", "0, 1 or 2", std::to_string(p.seen));
  if (p.filter && !(p.clamp > 0))
    throw Error::bad_input(run.where(), "clamp", "a number above 0", std::to_string(p.clamp));
  run.check_range(wide(p.items_high, p.items_low));
}

SampleThread::SampleThread(const SamplePart& part, Workspace& workspace, WorkQueue& work, unsigned index)
    : HostThread(part.device, workspace, part.scene.tracer(), work, index),
      part_(part),
      wave_(take("paths", PathWave::bytes(wave_size(part.device), part.scene.path_rows())),
            take("next_paths", PathWave::bytes(wave_size(part.device), part.scene.path_rows())), wave_size(part.device),
            part.scene.path_rows()),
      shadows_(take("shadows", PathWave::bytes(wave_.capacity(), part.scene.shadow_rows()))),
      generate_(part.device, part.generator.empty() ? part.camera : part.program,
                part.generator.empty() ? "camera_generate" : part.generator),
      shadow_rows_(part.scene.shadow_rows()),
      transparent_(part.scene.transparent_shadows()),
      connect_(part.device, part.program, transparent_ ? "shadow_pass" : "shadow_connect") {
  generate_.set("parameters", part.parameters).set("slots", part.slots);
  if (part.generator.empty()) set_camera_arguments();
  connect_.set("shadows", shadows_).set("slots", part.slots).set("slot_count", part.slot_count());
  if (transparent_) {
    connect_.set("counters", device_counters());
    part.scene.set_arguments(connect_);
  }
}

void SampleThread::set_camera_arguments() {
  generate_.set("items", part_.items)
      .set("listed", static_cast<cl_uint>(part_.listed))
      .set_words("first_item", part_.first_item)
      .set("features", part_.features)
      .set("media_high", part_.media[0])
      .set("media_low", part_.media[1]);
}

void SampleThread::set_arguments(Kernel& kernel) {
  part_.scene.set_arguments(kernel);
  kernel.set("parameters", part_.parameters).set("slot_count", part_.slot_count()).set("counters", device_counters());
}

void SampleThread::set_wave(Kernel& kernel, std::uint32_t fresh) {
  kernel.set("survivors", wave_.survivors())
      .set("fresh_base", wave_.fresh_base())
      .set("fresh_count", fresh)
      .set("paths", wave_.paths());
}

void SampleThread::run(BatchResult&) {
  while (!work_.stopped()) {
    const std::uint32_t fresh = generate();
    if (fresh == 0 && wave_.survivors() == 0) break;
    const RayRange range = wave_.rays(fresh);
    rays_.closest(wave_.paths(), range);
    wave_.advance(step(range, fresh));
  }
}

// New camera paths behind the survivors; returns how many.
std::uint32_t SampleThread::generate() {
  // Topping up a nearly full wave would cost a launch for a handful of paths.
  if (wave_.room() < wave_.capacity() / 4) return 0;
  const WorkQueue::Block block = work_.claim(wave_.room());
  const auto fresh = static_cast<std::uint32_t>(block.count);
  if (!block) return 0;
  generate_.set("first_path", static_cast<cl_uint>(block.first))
      .set("base", wave_.fresh_base())
      .set("count", fresh)
      .set("paths", wave_.paths());
  launch(generate_, fresh);
  counters.camera += fresh;
  return fresh;
}

void SampleThread::connect(RayRange range) {
  range.rows = shadow_rows_;
  connect_.set("count", range.end());
  if (transparent_) return pass(range.end());
  rays_.any(shadows_, range);
  launch(connect_, range.end());
  queue_.finish();
}

// Shadow rays through what light passes straight, one surface a turn. Rays that went on stand beside others that
// ended: traced as single rays, so that an answer does not depend on its neighbours.
void SampleThread::pass(std::uint32_t rays) {
  cl_uint left = rays;
  // As many surfaces as a path may meet.
  for (unsigned turn = 0; left && turn <= META_BOUNCE_MASK; ++turn) {
    rays_.closest(shadows_, single_rays(shadow_rows_, rays));
    clear_device_counters();
    launch(connect_, rays);
    left = read_device_counters()[COUNTER_SHADOW];
    counters.shadow += left;
  }
}

BatchResult run_samples(const StageRun& run, const PathParameters& p, const Program& program,
                        const MakeSampleThread& make) {
  const std::uint64_t total = wide(p.items_high, p.items_low), pixels = std::uint64_t{p.width} * p.height;
  const std::optional<ItemList> list = find_list(run, p);
  const double start = seconds_now();
  const bool apart = p.seen == PATH_SEEN_APART;
  const std::size_t record_bytes =
      (p.features ? sizeof(PathFeatureRecord) : sizeof(PathRecord)) + (apart ? 12 : 0) + (p.filter ? 12 : 0);
  BatchResult result;
  result.records.resize(run.count * record_bytes);
  cl::CommandQueue queue = run.device.make_queue();
  SamplePart part{
      .device = run.device, .scene = run.scene, .program = program, .camera = camera_program(run, p.filter != 0)};
  part.parameters = run.parameter_buffer(queue);
  part.media = run.scene.media_of(p.camera);
  part.listed = list.has_value();

  const std::uint64_t part_items = std::max<std::uint64_t>(1, kMostPaths / p.samples_per_item);
  for (std::uint64_t done = 0; done < run.count; done += part_items) {
    part.first_item = run.first + done;
    part.item_count = static_cast<std::uint32_t>(std::min(part_items, run.count - done));
    part.paths = part.item_count * p.samples_per_item;
    const std::size_t slots = part.slot_count() + 1;
    part.slots = run.workspace.take("path.slots", slots * (p.filter ? FILTERED_SLOT_WORDS : PLAIN_SLOT_WORDS) * 4);
    part.features = run.workspace.take("path.features", p.features || apart ? slots * FEATURE_WORDS * 4 : 4);
    part.items = run.workspace.take("path.items", list ? (part.item_count + RAY_BLOCK) * sizeof(PathItem) : 4);
    if (list) upload_list(*list, queue, part.items, done, part.item_count, pixels);

    WorkQueue work(part.paths, host_threads(run.device), kLeastPaths);
    run_host_threads(work, result, [&](unsigned index) { return make(part, work, index); });
    // The stage's last item may have fewer samples: the paths that pad it sent no ray.
    if (part.first_item + part.item_count == total)
      result.counters.camera_rays -= p.samples_per_item - p.last_item_samples;
    resolve(run, queue, part, record_bytes, result.records.data() + done * record_bytes, result.counters);
  }
  result.counters.seconds = seconds_now() - start;
  return result;
}

}  // namespace gleaner::worker

#include "worker/stages/path_stage.h"

#include <algorithm>
#include <atomic>
#include <bit>
#include <cstring>

#include "kernels/path_layout.h"
#include "kernels/path_records.h"
#include "scene/model/error.h"
#include "worker/stages/lane_threads.h"
#include "worker/stages/launch.h"

namespace gleaner::worker {
namespace {

using kernels::PathFeatureRecord;
using kernels::PathItem;
using kernels::PathParameters;
using kernels::PathRecord;

// Slots of paths in flight take 32 bytes each; a batch beyond this runs in parts.
constexpr std::uint64_t kMostPaths = std::uint64_t{1} << 19;

// Items summed by one launch of path_resolve.
constexpr std::uint32_t kResolveItems = 1u << 14;

// Paths that move in step. CPU: small enough for a core's own cache, large enough that a kernel's launch does not show.
std::uint32_t wave_size(const Device& device) { return device.info().cpu ? 1u << 12 : 1u << 20; }

PathParameters read_path_parameters(const StageTask& task) {
  const auto p = read_parameters<PathParameters>(task);
  check_film(task, p.camera, p.width, p.height);
  if (!std::has_single_bit(p.samples_per_item) || p.samples_per_item > GLEANER_PATH_MAX_ITEM_SAMPLES)
    throw Error::bad_input("stage path", "samples_per_item",
                           "a power of two up to " + std::to_string(GLEANER_PATH_MAX_ITEM_SAMPLES),
                           std::to_string(p.samples_per_item));
  if (p.last_item_samples == 0 || p.last_item_samples > p.samples_per_item)
    throw Error::bad_input("stage path", "last_item_samples", "1 to samples_per_item",
                           std::to_string(p.last_item_samples));
  if (p.covered && !(p.clamp > 0))
    throw Error::bad_input("stage path", "clamp", "a number above 0", std::to_string(p.clamp));
  return p;
}

// Sizes and buffers that all lanes of a batch share.
struct Shared {
  const Device& device;
  DeviceScene& scene;
  const PathParameters& parameters;
  cl::Program program;
  cl::Buffer parameter_buffer{}, items{}, slots{}, features{};
  bool listed = false;
  std::uint64_t first_item = 0;
  std::uint32_t paths = 0;     // of this part
  std::uint32_t capacity = 0;  // of a wave
  unsigned lanes = 1;
  std::atomic<std::uint32_t> next_path{0};
  std::atomic<bool> failed{false};
};

struct LaneCounters {
  std::uint64_t camera = 0, scatter = 0, shadow = 0;
  double trace = 0, kernel = 0;
};

// Camera paths for a lane that has room: fewer near the end, so that the lanes end together. A multiple of 16 (a block
// is one packet), and of whole waves' quarters before that.
std::uint32_t claim(Shared& shared, std::uint32_t room, std::uint32_t& first) {
  std::uint32_t next = shared.next_path.load();
  for (;;) {
    const std::uint32_t left = shared.paths - next;
    if (left == 0) return 0;
    const std::uint32_t share = std::max(1024u, (left / (2 * shared.lanes) + 15) / 16 * 16);
    const std::uint32_t take = std::min({room, share, left});
    if (shared.next_path.compare_exchange_weak(next, next + take)) {
      first = next;
      return take;
    }
  }
}

class Lane {
 public:
  Lane(Shared& shared, Workspace& workspace, unsigned index)
      : shared_(shared),
        queue_(shared.device.make_queue()),
        generate_(shared.program, "path_generate"),
        shade_(shared.program, "path_shade"),
        transparent_(shared.scene.transparent_shadows()),
        connect_(shared.program, transparent_ ? "path_pass" : "path_connect"),
        counters_(workspace.take("path.counters." + std::to_string(index), COUNTERS * 4)) {
    // One block more: ended lanes write behind the wave.
    const std::size_t blocks = shared.capacity / RAY_BLOCK + 1;
    for (int k = 0; k < 2; ++k)
      paths_[k] = workspace.take("path.paths." + std::to_string(2 * index + static_cast<unsigned>(k)),
                                 blocks * RAY_BLOCK * PATH_ROWS * 4);
    shadows_ = workspace.take("path.shadows." + std::to_string(index), blocks * RAY_BLOCK * shadow_rows() * 4);
    generate_.setArg(0, shared.parameter_buffer);
    generate_.setArg(1, shared.items);
    generate_.setArg(2, static_cast<cl_uint>(shared.listed));
    generate_.setArg(3, static_cast<cl_uint>(shared.first_item));
    generate_.setArg(4, static_cast<cl_uint>(shared.first_item >> 32));
    generate_.setArg(9, shared.slots);
    generate_.setArg(10, shared.features);
    shade_.setArg(0, shared.parameter_buffer);
    unsigned at = shared.scene.set_arguments(shade_, 1);
    shade_arguments_ = at;
    shade_.setArg(at + 5, shadows_);
    shade_.setArg(at + 6, shared.slots);
    shade_.setArg(at + 7, shared.features);
    shade_.setArg(at + 8, static_cast<cl_uint>(slot_count()));
    shade_.setArg(at + 9, static_cast<cl_uint>(shared.capacity));
    shade_.setArg(at + 10, counters_);
    connect_.setArg(0, shadows_);
    connect_.setArg(1, shared.slots);
    connect_.setArg(2, static_cast<cl_uint>(slot_count()));
    if (transparent_) {
      connect_.setArg(4, counters_);
      shared.scene.set_arguments(connect_, 5);
    }
  }
  Lane(const Lane&) = delete;
  Lane& operator=(const Lane&) = delete;
  // Where a call failed, what was enqueued before it still writes to buffers that the next batch takes.
  ~Lane() {
    if (shared_.failed) clFinish(queue_());
  }

  void run() {
    std::uint32_t survivors = 0;
    int current = 0;
    while (!shared_.failed.load(std::memory_order_relaxed)) {
      const std::uint32_t base = (survivors + RAY_BLOCK - 1) / RAY_BLOCK * RAY_BLOCK;
      const std::uint32_t room = shared_.capacity - base;
      std::uint32_t first = 0, fresh = 0;
      const double start = seconds_now();
      // Topping up a nearly full wave would cost a launch for a handful of paths.
      if (room >= shared_.capacity / 4) fresh = claim(shared_, room, first);
      if (fresh == 0 && survivors == 0) break;
      if (fresh) {
        generate_.setArg(5, first);
        generate_.setArg(6, base);
        generate_.setArg(7, fresh);
        generate_.setArg(8, paths_[current]);
        launch(generate_, fresh);
        counters.camera += fresh;
      }
      RayRange range;
      range.rows = PATH_ROWS;
      range.incoherent = survivors;
      range.coherent_base = base;
      range.coherent_count = fresh;
      queue_.finish();
      const double generated = seconds_now();
      shared_.scene.tracer().closest(queue_, paths_[current], range);
      const double hit = seconds_now();
      static constexpr cl_uint zero[2] = {0, 0};  // read after the call, also where a later one throws
      queue_.enqueueWriteBuffer(counters_, CL_FALSE, 0, sizeof zero, zero);
      shade_.setArg(shade_arguments_, survivors);
      shade_.setArg(shade_arguments_ + 1, base);
      shade_.setArg(shade_arguments_ + 2, fresh);
      shade_.setArg(shade_arguments_ + 3, paths_[current]);
      shade_.setArg(shade_arguments_ + 4, paths_[1 - current]);
      launch(shade_, range.end());
      cl_uint counted[2];
      queue_.enqueueReadBuffer(counters_, CL_TRUE, 0, sizeof counted, counted);
      const double shaded = seconds_now();
      counters.scatter += counted[COUNTER_ALIVE];
      counters.shadow += counted[COUNTER_SHADOW];
      double shadowed = shaded;
      if (counted[COUNTER_SHADOW]) {
        range.rows = shadow_rows();
        connect_.setArg(3, range.end());
        if (transparent_) {
          shadowed += pass(range.end());
        } else {
          shared_.scene.tracer().any(queue_, shadows_, range);
          shadowed = seconds_now();
          launch(connect_, range.end());
          queue_.finish();
        }
      }
      survivors = counted[COUNTER_ALIVE];
      current = 1 - current;
      counters.trace += (hit - generated) + (shadowed - shaded);
      counters.kernel += (generated - start) + (shaded - hit) + (seconds_now() - shadowed);
    }
  }

  LaneCounters counters;

 private:
  std::uint32_t shadow_rows() const { return transparent_ ? TRANSPARENT_SHADOW_ROWS : SHADOW_ROWS; }

  // Shadow rays through what is not opaque, one surface a turn. Rays that went on stand beside others that ended:
  // traced as single rays, so that an answer does not depend on its neighbours. Returns the tracer's seconds.
  double pass(std::uint32_t rays) {
    RayRange range;
    range.rows = shadow_rows();
    range.incoherent = rays;
    cl_uint left = rays;
    double traced = 0;
    // As many surfaces as a path may meet.
    for (unsigned turn = 0; left && turn <= META_BOUNCE_MASK; ++turn) {
      const double start = seconds_now();
      shared_.scene.tracer().closest(queue_, shadows_, range);
      traced += seconds_now() - start;
      static constexpr cl_uint zero[2] = {0, 0};
      queue_.enqueueWriteBuffer(counters_, CL_FALSE, 0, sizeof zero, zero);
      launch(connect_, rays);
      cl_uint counted[2];
      queue_.enqueueReadBuffer(counters_, CL_TRUE, 0, sizeof counted, counted);
      left = counted[COUNTER_SHADOW];
      counters.shadow += left;
    }
    return traced;
  }

  std::uint32_t slot_count() const { return (shared_.paths + RAY_BLOCK - 1) / RAY_BLOCK * RAY_BLOCK; }

  void launch(cl::Kernel& kernel, std::uint32_t rays) {
    worker::launch(shared_.device, queue_, kernel, rays, shared_.capacity, shared_.device.lanes());
  }

  Shared& shared_;
  cl::CommandQueue queue_;
  cl::Kernel generate_, shade_;
  bool transparent_;
  cl::Kernel connect_;
  cl::Buffer counters_, paths_[2], shadows_;
  unsigned shade_arguments_ = 0;
};

}  // namespace

BatchResult run_path_stage(const Device& device, Workspace& workspace, DeviceScene& scene, const StageTask& task,
                           std::uint64_t first, std::uint64_t count) {
  const PathParameters parameters = read_path_parameters(task);
  const std::uint64_t total = (std::uint64_t{parameters.items_high} << 32) | parameters.items_low;
  check_range(task, total, first, count);
  const std::byte* list = nullptr;
  if (auto items = task.inputs.find("items"); items != task.inputs.end()) {
    if (items->second.bytes() != total * sizeof(PathItem))
      throw Error::bad_input("stage path", "input items", std::to_string(total * sizeof(PathItem)) + " bytes",
                             std::to_string(items->second.bytes()));
    list = items->second.in_memory().data();
    const auto* entries = reinterpret_cast<const PathItem*>(list);
    for (std::uint64_t i = first; i < first + count; ++i)
      if (entries[i].pixel >= std::uint64_t{parameters.width} * parameters.height)
        throw Error::bad_input("stage path", "input items[" + std::to_string(i) + "].pixel",
                               "below " + std::to_string(std::uint64_t{parameters.width} * parameters.height),
                               std::to_string(entries[i].pixel));
  }

  const double start = seconds_now();
  const std::size_t record_bytes =
      (parameters.features ? sizeof(PathFeatureRecord) : sizeof(PathRecord)) + (parameters.covered ? 12 : 0);
  BatchResult result;
  result.records.resize(count * record_bytes);
  cl::CommandQueue queue = device.make_queue();
  cl::Program program =
      device.build("kernels/path.cl", scene.kernel_options() + (parameters.covered ? " -D COVERED" : ""));
  cl::Buffer parameter_buffer = workspace.take("path.parameters", sizeof parameters);
  queue.enqueueWriteBuffer(parameter_buffer, CL_TRUE, 0, sizeof parameters, &parameters);

  const std::uint64_t part_items = std::max<std::uint64_t>(1, kMostPaths / parameters.samples_per_item);
  for (std::uint64_t done = 0; done < count; done += part_items) {
    const std::uint64_t part = std::min(part_items, count - done);
    const unsigned lanes = device.info().cpu ? device.info().threads : 1;
    Shared shared{.device = device, .scene = scene, .parameters = parameters, .program = program};
    shared.parameter_buffer = parameter_buffer;
    shared.listed = list != nullptr;
    shared.first_item = first + done;
    shared.paths = static_cast<std::uint32_t>(part * parameters.samples_per_item);
    shared.lanes = lanes;
    shared.capacity = wave_size(device);
    const std::uint64_t slots = (shared.paths + RAY_BLOCK - 1) / RAY_BLOCK * RAY_BLOCK + 1;
    shared.slots =
        workspace.take("path.slots", slots * (parameters.covered ? COVERED_SLOT_WORDS : PLAIN_SLOT_WORDS) * 4);
    shared.features = workspace.take("path.features", parameters.features ? slots * FEATURE_WORDS * 4 : 4);
    shared.items = workspace.take("path.items", list ? (part + RAY_BLOCK) * sizeof(PathItem) : 4);
    if (list)
      queue.enqueueWriteBuffer(shared.items, CL_TRUE, 0, part * sizeof(PathItem),
                               list + (first + done) * sizeof(PathItem));

    std::vector<std::unique_ptr<Lane>> all;
    for (unsigned k = 0; k < lanes; ++k) all.push_back(std::make_unique<Lane>(shared, workspace, k));
    run_lanes(lanes, [&](unsigned k) {
      try {
        all[k]->run();
      } catch (...) {
        shared.failed = true;
        throw;
      }
    });
    // The stage's last item may have fewer samples: the paths that pad it sent no ray.
    if (shared.first_item + part == total)
      result.counters.camera_rays -= parameters.samples_per_item - parameters.last_item_samples;
    for (auto& lane : all) {
      result.counters.camera_rays += lane->counters.camera;
      result.counters.scatter_rays += lane->counters.scatter;
      result.counters.shadow_rays += lane->counters.shadow;
      result.counters.trace_seconds += lane->counters.trace / lanes;
      result.counters.kernel_seconds += lane->counters.kernel / lanes;
    }

    const double resolve_start = seconds_now();
    cl::Buffer records = workspace.take("path.records", part * record_bytes);
    cl::Buffer report = workspace.take("path.report", (2 + REPORTED_ITEMS) * 4);
    std::uint32_t reported[2 + REPORTED_ITEMS] = {};
    queue.enqueueWriteBuffer(report, CL_TRUE, 0, sizeof reported, reported);
    cl::Kernel resolve(program, "path_resolve");
    resolve.setArg(0, parameter_buffer);
    resolve.setArg(1, static_cast<cl_uint>(shared.first_item));
    resolve.setArg(2, static_cast<cl_uint>(shared.first_item >> 32));
    resolve.setArg(3, static_cast<cl_uint>(part));
    resolve.setArg(4, shared.slots);
    resolve.setArg(5, shared.features);
    resolve.setArg(6, records);
    resolve.setArg(7, report);
    // Pieces of one size, for the reason that launch() gives.
    for (std::uint32_t base = 0; base < part; base += kResolveItems) {
      resolve.setArg(8, base);
      queue.enqueueNDRangeKernel(resolve, cl::NullRange, cl::NDRange(kResolveItems), cl::NDRange(64));
    }
    queue.enqueueReadBuffer(report, CL_TRUE, 0, sizeof reported, reported);
    queue.enqueueReadBuffer(records, CL_TRUE, 0, part * record_bytes, result.records.data() + done * record_bytes);
    result.counters.kernel_seconds += seconds_now() - resolve_start;
    result.counters.nonfinite += reported[0];
    for (std::uint32_t k = 0; k < std::min(reported[1], REPORTED_ITEMS); ++k)
      result.counters.nonfinite_items.push_back(shared.first_item + reported[2 + k]);
  }
  result.counters.seconds = seconds_now() - start;
  return result;
}

}  // namespace gleaner::worker

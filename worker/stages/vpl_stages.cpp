#include "worker/stages/vpl_stages.h"

#include <algorithm>
#include <any>
#include <atomic>
#include <bit>
#include <cmath>
#include <cstring>

#include "kernels/cluster_grid.h"
#include "kernels/cluster_records.h"
#include "kernels/path_layout.h"
#include "kernels/vpl_records.h"
#include "scene/model/error.h"
#include "worker/stages/cluster_grid.h"
#include "worker/stages/lane_threads.h"
#include "worker/stages/launch.h"

namespace gleaner::worker {
namespace {

using kernels::VisibilityParameters;
using kernels::VplPointParameters;
using kernels::VplTraceParameters;

// Paths, and rays between points and lights, that move in step. A kernel always runs on one grid of this size on CPU
// devices (launch() says why).
std::uint32_t path_capacity(const Device& device) { return device.info().cpu ? 1u << 12 : 1u << 17; }
std::uint32_t ray_capacity(const Device& device) { return device.info().cpu ? 1u << 14 : 1u << 21; }

// A table that is the stage's input: rows of `words` words, as many as the parameters say.
std::span<const std::byte> read_table(const StageTask& task, const std::string& name, std::uint64_t rows,
                                      std::size_t words) {
  const auto input = task.inputs.find(name);
  if (input == task.inputs.end() || input->second.bytes() != rows * words * 4)
    throw Error::bad_input("stage " + task.kind, "input " + name, std::to_string(rows * words * 4) + " bytes",
                           input == task.inputs.end() ? "none" : std::to_string(input->second.bytes()));
  return input->second.in_memory();
}

// Triangles that a table names must be there: a kernel looks them up.
void check_triangles(const StageTask& task, const std::string& name, std::span<const std::byte> table,
                     std::size_t words, unsigned word, std::uint64_t triangles) {
  for (std::size_t at = 0; at < table.size(); at += words * 4) {
    std::uint32_t triangle = 0;
    std::memcpy(&triangle, table.data() + at + word * 4, 4);
    if (triangle != GLEANER_NONE && triangle >= triangles)
      throw Error::bad_input("stage " + task.kind, "input " + name + "[" + std::to_string(at / (words * 4)) + "]",
                             "a triangle below " + std::to_string(triangles), std::to_string(triangle));
  }
}

VplPointParameters read_point_parameters(const StageTask& task) {
  const auto p = read_parameters<VplPointParameters>(task);
  check_film(task, p.camera, p.width, p.height);
  const std::string where = "stage " + task.kind;
  if (!std::has_single_bit(p.samples) || p.samples > 64)
    throw Error::bad_input(where, "samples", "a power of two up to 64", std::to_string(p.samples));
  if (p.items_high || p.items_low > std::uint64_t{p.width} * p.height)
    throw Error::bad_input(where, "items", "at most a pixel each", std::to_string(p.items_low));
  if (!(p.clamp > 0)) throw Error::bad_input(where, "clamp", "a number above 0", std::to_string(p.clamp));
  return p;
}

// What the stages' lanes (host threads of a CPU device) have in common.
struct Batch {
  const Device& device;
  Workspace& workspace;
  DeviceScene& scene;
  const StageTask& task;
  std::uint64_t first = 0, count = 0;
  unsigned fuzziness = 1;
  cl::Buffer parameters{};
  unsigned lanes = 1;
  std::atomic<std::uint64_t> next{0};
  std::atomic<bool> failed{false};

  Batch(const Device& d, Workspace& w, DeviceScene& s, const StageTask& t, std::uint64_t f, std::uint64_t c,
        unsigned f6)
      : device(d),
        workspace(w),
        scene(s),
        task(t),
        first(f),
        count(c),
        fuzziness(f6),
        lanes(d.info().cpu ? d.info().threads : 1) {
    cl::CommandQueue queue = device.make_queue();
    parameters = put(queue, "vpl.parameters", task.parameters.data(), task.parameters.size());
  }

  // A kernel of kernels/vpl/`file`. Each file is a program of its own, built for what it reads alone, so that a stage
  // compiles nothing that it does not run, and two stages share what both run.
  cl::Kernel kernel(const std::string& file, const char* name) const {
    std::string options = "-D LANES=" + std::to_string(device.lanes());
    if (file != "visibility.cl") options = scene.kernel_options();
    if (file == "gather.cl" || file == "residual.cl") options += " -D FUZZINESS=" + std::to_string(fuzziness);
    return cl::Kernel(device.build("kernels/vpl/" + file, options), name);
  }

  // Room for the last row's load of a whole line.
  cl::Buffer put(cl::CommandQueue& queue, const std::string& name, const void* data, std::size_t bytes) {
    cl::Buffer buffer = workspace.take(name, bytes + 64);
    if (bytes) queue.enqueueWriteBuffer(buffer, CL_TRUE, 0, bytes, data);
    return buffer;
  }

  // The next part of the batch, of at most `most` items: fewer where lanes share a small batch, but whole blocks of 16.
  bool claim(std::uint64_t most, std::uint64_t& begin, std::uint64_t& part) {
    if (lanes > 1) most = std::min(most, std::max<std::uint64_t>(16, (count / (3 * lanes) + 15) / 16 * 16));
    begin = next.fetch_add(most);
    if (begin >= count || failed.load(std::memory_order_relaxed)) return false;
    part = std::min(most, count - begin);
    return true;
  }
};

// What a stage made of its inputs.
template <typename Tables>
struct KeptTables {
  Tables tables;
  // Held, so that another input cannot come to lie at the same place.
  std::string scene;
  std::map<std::string, TaskInput> inputs;
  std::vector<std::byte> parameters;
};

bool same_inputs(const std::map<std::string, TaskInput>& a, const std::map<std::string, TaskInput>& b) {
  return std::ranges::equal(a, b, [](const auto& x, const auto& y) {
    if (x.first != y.first) return false;
    return x.second.artifact.empty() ? x.second.source == y.second.source : x.second.artifact == y.second.artifact;
  });
}

// Made once for a stage: its batches read the same tables.
template <typename Tables, typename Make>
const Tables& kept_tables(Batch& batch, const std::string& name, Make make) {
  using Kept = KeptTables<Tables>;
  const StageTask& task = batch.task;
  std::any& place = batch.workspace.keep(name);
  if (const auto* held = std::any_cast<Kept>(&place))
    if (held->scene == task.scene && same_inputs(held->inputs, task.inputs) && held->parameters == task.parameters)
      return held->tables;
  place.reset();  // its buffers are about to hold something else
  place = Kept{make(), task.scene, task.inputs, task.parameters};
  return std::any_cast<Kept>(&place)->tables;
}

struct LaneCounters {
  std::uint64_t camera = 0, scatter = 0, shadow = 0, nonfinite = 0;
  std::vector<std::uint64_t> nonfinite_items{};
  double trace = 0, all = 0;
};

// One lane's queue and kernels.
class Lane {
 public:
  Lane(Batch& batch, unsigned index)
      : batch_(batch), index_(index), queue_(batch.device.make_queue()), counters_buffer_(take("counters", 64)) {}

  Lane(const Lane&) = delete;
  Lane& operator=(const Lane&) = delete;
  // Where a call failed, what was enqueued before it still writes to buffers that the next batch takes.
  ~Lane() {
    if (batch_.failed) clFinish(queue_());
  }

  LaneCounters counters;

 protected:
  cl::Buffer take(const std::string& name, std::size_t bytes) {
    return batch_.workspace.take("vpl." + name + "." + std::to_string(index_), bytes + 64);
  }
  cl::Kernel kernel(const std::string& file, const char* name) const { return batch_.kernel(file, name); }

  // `capacity` on CPU devices, whatever there is to do.
  void launch(cl::Kernel& kernel, std::uint32_t work, std::uint32_t capacity, unsigned lanes) {
    worker::launch(batch_.device, queue_, kernel, work, capacity, lanes);
  }
  void launch(cl::Kernel& kernel, std::uint32_t work) {
    launch(kernel, work, path_capacity(batch_.device), batch_.device.lanes());
  }

  // Moves the wave until no path is left; `walk` has the counter as an argument.
  void walk(cl::Kernel& walk, cl::Buffer& paths, std::uint32_t count) {
    RayRange range;
    range.rows = PATH_ROWS;
    range.incoherent = count;
    for (;;) {
      queue_.finish();
      const double start = seconds_now();
      batch_.scene.tracer().closest(queue_, paths, range);
      counters.trace += seconds_now() - start;
      static constexpr cl_uint zero = 0;  // read after the call, also where a later one throws
      queue_.enqueueWriteBuffer(counters_buffer_, CL_FALSE, 0, sizeof zero, &zero);
      launch(walk, count);
      cl_uint alive = 0;
      queue_.enqueueReadBuffer(counters_buffer_, CL_TRUE, 0, sizeof alive, &alive);
      counters.scatter += alive;
      if (alive == 0) return;
    }
  }

  Batch& batch_;
  unsigned index_;
  cl::CommandQueue queue_;
  cl::Buffer counters_buffer_;
};

template <typename LaneType, typename... Arguments>
void run(Batch& batch, BatchResult& result, double start, Arguments&&... arguments) {
  std::vector<std::unique_ptr<LaneType>> all;
  for (unsigned k = 0; k < batch.lanes; ++k) all.push_back(std::make_unique<LaneType>(batch, k, arguments...));
  run_lanes(batch.lanes, [&](unsigned k) {
    const double begun = seconds_now();
    try {
      all[k]->run(result);
    } catch (...) {
      batch.failed = true;
      throw;
    }
    all[k]->counters.all = seconds_now() - begun;
  });
  for (auto& lane : all) {
    result.counters.camera_rays += lane->counters.camera;
    result.counters.scatter_rays += lane->counters.scatter;
    result.counters.shadow_rays += lane->counters.shadow;
    result.counters.nonfinite += lane->counters.nonfinite;
    for (auto item : lane->counters.nonfinite_items) result.counters.nonfinite_items.push_back(item);
    result.counters.trace_seconds += lane->counters.trace / batch.lanes;
    result.counters.kernel_seconds += (lane->counters.all - lane->counters.trace) / batch.lanes;
  }
  result.counters.seconds = seconds_now() - start;
}

// --- Light paths ---

class TraceLane : public Lane {
 public:
  TraceLane(Batch& batch, unsigned index)
      : Lane(batch, index),
        capacity_(path_capacity(batch.device)),
        emit_(kernel("trace.cl", "vpl_emit")),
        walk_(kernel("trace.cl", "vpl_trace_step")) {
    const std::size_t blocks = capacity_ / RAY_BLOCK + 1;
    paths_ = take("paths", blocks * RAY_BLOCK * PATH_ROWS * 4);
    // A path's slots more: lanes with nothing to write do so behind the records.
    record_words_ = (capacity_ + 1) * VPL_PATH_SLOTS * VPL_WORDS;
    records_ = take("lights", record_words_ * 4);
    emit_.setArg(0, batch.parameters);
    unsigned at = batch.scene.set_arguments(emit_, 1);
    emit_.setArg(at, batch.scene.emission());
    emit_first_ = at + 1;
    emit_.setArg(at + 4, paths_);
    walk_.setArg(0, batch.parameters);
    walk_first_ = batch.scene.set_arguments(walk_, 1);
    walk_.setArg(walk_first_ + 1, paths_);
    walk_.setArg(walk_first_ + 2, records_);
    walk_.setArg(walk_first_ + 3, counters_buffer_);
  }

  void run(BatchResult& result) {
    std::uint64_t begin = 0, part = 0;
    while (batch_.claim(capacity_, begin, part)) {
      const auto count = static_cast<std::uint32_t>(part);
      const std::uint64_t item = batch_.first + begin;
      queue_.enqueueFillBuffer(records_, cl_uint{0}, 0, record_words_ * 4);
      emit_.setArg(emit_first_, static_cast<cl_uint>(item));
      emit_.setArg(emit_first_ + 1, static_cast<cl_uint>(item >> 32));
      emit_.setArg(emit_first_ + 2, count);
      launch(emit_, count);
      counters.scatter += count;
      walk_.setArg(walk_first_, count);
      walk(walk_, paths_, count);
      const std::size_t stride = VPL_PATH_SLOTS * VPL_WORDS * 4;
      queue_.enqueueReadBuffer(records_, CL_TRUE, 0, part * stride, result.records.data() + begin * stride);
    }
  }

 private:
  std::uint32_t capacity_;
  cl::Kernel emit_, walk_;
  cl::Buffer paths_, records_;
  std::size_t record_words_ = 0;
  unsigned emit_first_ = 0, walk_first_ = 0;
};

// --- Points ---

class PointLane : public Lane {
 public:
  PointLane(Batch& batch, unsigned index, bool by_point)
      : Lane(batch, index),
        capacity_(path_capacity(batch.device)),
        generate_(kernel("points.cl", "vpl_camera_rays")),
        walk_(kernel("points.cl", "vpl_point_step")) {
    const std::size_t blocks = capacity_ / RAY_BLOCK + 1;
    paths_ = take("paths", blocks * RAY_BLOCK * PATH_ROWS * 4);
    points_ = take("points", (capacity_ + RAY_BLOCK) * POINT_WORDS * 4);
    generate_.setArg(0, batch.parameters);
    generate_.setArg(4, static_cast<cl_uint>(by_point));
    generate_.setArg(5, paths_);
    generate_.setArg(6, points_);
    walk_.setArg(0, batch.parameters);
    walk_first_ = batch.scene.set_arguments(walk_, 1);
    walk_.setArg(walk_first_ + 1, paths_);
    walk_.setArg(walk_first_ + 2, points_);
    walk_.setArg(walk_first_ + 3, counters_buffer_);
    lobes_ = take("lobes", (by_point ? 1 : capacity_ + RAY_BLOCK) * LOBE_WORDS * 4);
    walk_.setArg(walk_first_ + 4, static_cast<cl_uint>(!by_point));
    walk_.setArg(walk_first_ + 5, lobes_);
  }

  void run(BatchResult& result) {
    std::uint64_t begin = 0, part = 0;
    while (batch_.claim(capacity_, begin, part)) {
      find_points(begin, static_cast<std::uint32_t>(part));
      const std::size_t stride = POINT_WORDS * 4;
      queue_.enqueueReadBuffer(points_, CL_TRUE, 0, part * stride, result.records.data() + begin * stride);
    }
  }

 protected:
  // The points of `count` paths; the first is that of item batch.first + begin.
  void find_points(std::uint64_t begin, std::uint32_t count) {
    const std::uint64_t item = batch_.first + begin;
    generate_.setArg(1, static_cast<cl_uint>(item));
    generate_.setArg(2, static_cast<cl_uint>(item >> 32));
    generate_.setArg(3, count);
    launch(generate_, count);
    counters.camera += count;
    walk_.setArg(walk_first_, count);
    walk(walk_, paths_, count);
  }

  std::uint32_t capacity_;
  cl::Kernel generate_, walk_;
  cl::Buffer paths_, points_, lobes_;
  unsigned walk_first_ = 0;
};

// --- Visibility ---

const std::string kVisibilityFile = "visibility.cl", kResidualFile = "residual.cl";

// Asks rows of lights for points, some at a time. Held by the lanes of the stages that need answers. `file`: whose
// queries these are; ask() is visibility.cl's.
class Asker {
 public:
  Asker(Batch& batch, cl::CommandQueue& queue, cl::Buffer rays, cl::Buffer counters, cl::Buffer lights,
        std::uint32_t width, std::uint32_t slices, const std::string& file)
      : batch_(batch),
        queue_(queue),
        width_(width),
        rays_(std::move(rays)),
        counters_(std::move(counters)),
        pack_(batch.kernel(file, "visibility_pack")) {
    pack_.setArg(0, rays_);
    if (file != kVisibilityFile) return;
    ask_ = batch.kernel(file, "vpl_visibility_rays");
    ask_.setArg(0, batch.scene.triangle_rows());
    ask_.setArg(4, lights);
    ask_.setArg(5, width);
    ask_.setArg(6, slices);
    ask_.setArg(10, rays_);
    ask_.setArg(11, counters_);
  }

  // Bits of `rows` points' slices (width / 32 words each) into `bits`; how many pairs of each row were left out into
  // `left_out` (VISIBILITY_COUNTS words a row). chosen: a list of points, `listed`, or unused. cutoff: what a light
  // must be able to bring to each row's point.
  void ask(const cl::Buffer& points, const cl::Buffer& chosen, bool listed, std::uint32_t point_base,
           std::uint32_t rows, cl::Buffer& bits, cl::Buffer& left_out, const cl::Buffer& cutoff, float clamp,
           LaneCounters& counters) {
    queue_.enqueueFillBuffer(left_out, cl_uint{0}, 0, std::size_t{rows} * VISIBILITY_COUNTS * 4);
    static constexpr cl_uint zero = 0;  // read after the call, also where a later one throws
    queue_.enqueueWriteBuffer(counters_, CL_FALSE, 0, sizeof zero, &zero);
    const std::uint64_t all = std::uint64_t{rows} * width_;
    const std::uint32_t capacity = ray_capacity(batch_.device);
    ask_.setArg(1, points);
    ask_.setArg(2, chosen);
    ask_.setArg(3, static_cast<cl_uint>(listed));
    ask_.setArg(7, point_base);
    ask_.setArg(12, left_out);
    ask_.setArg(13, cutoff);
    ask_.setArg(14, clamp);
    for (std::uint64_t base = 0; base < all; base += capacity) {
      const auto count = static_cast<std::uint32_t>(std::min<std::uint64_t>(capacity, all - base));
      ask_.setArg(8, static_cast<cl_uint>(base));
      ask_.setArg(9, count);
      launch(batch_.device, queue_, ask_, count, capacity, batch_.device.lanes());
      RayRange range;
      // Sixteen lights as one point sees them, always the same sixteen.
      range.coherent_count = count;
      answer(range, count, base, bits, counters);
    }
    cl_uint asked = 0;
    queue_.enqueueReadBuffer(counters_, CL_TRUE, 0, sizeof asked, &asked);
    counters.shadow += asked;
  }

  // Where rays are written that `answer` traces: ray_capacity() of them.
  const cl::Buffer& rays() const { return rays_; }

  // Traces `count` rays, and writes their answers into `bits` from bit `base` (a multiple of 32) on.
  void answer(RayRange range, std::uint32_t count, std::uint64_t base, const cl::Buffer& bits, LaneCounters& counters) {
    queue_.finish();
    const double start = seconds_now();
    range.rows = VISIBILITY_ROWS;
    batch_.scene.tracer().any(queue_, rays_, range);
    counters.trace += seconds_now() - start;
    pack_.setArg(1, (count + 31) / 32);
    pack_.setArg(2, static_cast<cl_uint>(base / 32));
    pack_.setArg(3, bits);
    launch(batch_.device, queue_, pack_, count, ray_capacity(batch_.device), 32);
  }

 private:
  Batch& batch_;
  cl::CommandQueue& queue_;
  std::uint32_t width_;
  cl::Buffer rays_, counters_;
  cl::Kernel ask_{}, pack_;
};

struct VisibilityTables {
  cl::Buffer lights, points;
};

class VisibilityLane : public Lane {
 public:
  VisibilityLane(Batch& batch, unsigned index, const VisibilityTables& tables, const VisibilityParameters& parameters)
      : Lane(batch, index),
        p_(parameters),
        points_(tables.points),
        asker_(batch, queue_, take("rays", std::size_t{ray_capacity(batch.device)} * VISIBILITY_ROWS * 4),
               counters_buffer_, tables.lights, parameters.clusters, 1, kVisibilityFile),
        cutoff_of_(kernel("visibility.cl", "vpl_visibility_cutoff")) {
    rows_ = std::max<std::uint32_t>(1, 4 * ray_capacity(batch.device) / p_.clusters);
    bits_ = take("bits", std::size_t{rows_} * p_.clusters / 8);
    left_out_ = take("left_out", std::size_t{rows_} * VISIBILITY_COUNTS * 4);
    cutoff_ = take("cutoff", (std::size_t{rows_} + RAY_BLOCK) * 4);
    cutoff_of_.setArg(0, points_);
    cutoff_of_.setArg(3, tables.lights);
    cutoff_of_.setArg(4, p_.clusters);
    cutoff_of_.setArg(5, p_.clamp);
    cutoff_of_.setArg(6, p_.cutoff);
    cutoff_of_.setArg(7, cutoff_);
  }

  void run(BatchResult& result) {
    std::uint64_t begin = 0, part = 0;
    const std::size_t words = p_.clusters / 32, stride = (words + VISIBILITY_COUNTS) * 4;
    std::vector<std::uint32_t> bits(rows_ * words), left_out(rows_ * VISIBILITY_COUNTS);
    while (batch_.claim(rows_, begin, part)) {
      const auto rows = static_cast<std::uint32_t>(part);
      const auto base = static_cast<std::uint32_t>(batch_.first + begin);
      if (p_.cutoff > 0) {
        cutoff_of_.setArg(1, base);
        cutoff_of_.setArg(2, rows);
        launch(cutoff_of_, rows, (rows_ + RAY_BLOCK - 1) / RAY_BLOCK * RAY_BLOCK, batch_.device.lanes());
      } else {
        queue_.enqueueFillBuffer(cutoff_, cl_float{0}, 0, std::size_t{rows} * 4);
      }
      asker_.ask(points_, points_, false, base, rows, bits_, left_out_, cutoff_, p_.clamp, counters);
      queue_.enqueueReadBuffer(bits_, CL_TRUE, 0, rows * words * 4, bits.data());
      queue_.enqueueReadBuffer(left_out_, CL_TRUE, 0, std::size_t{rows} * VISIBILITY_COUNTS * 4, left_out.data());
      std::byte* out = result.records.data() + begin * stride;
      for (std::uint32_t r = 0; r < rows; ++r, out += stride) {
        std::memcpy(out, &bits[r * words], words * 4);
        std::memcpy(out + words * 4, &left_out[r * VISIBILITY_COUNTS], VISIBILITY_COUNTS * 4);
      }
    }
  }

 private:
  VisibilityParameters p_;
  cl::Buffer points_;
  std::uint32_t rows_ = 0;
  Asker asker_;
  cl::Kernel cutoff_of_;
  cl::Buffer bits_, left_out_, cutoff_;
};

// --- Shading ---

// What all lanes of a shading batch read.
struct ShadeTables {
  cl::Buffer lights, boxes, grid, cells, seeds, bits;
  std::uint32_t width = 0;      // lights of a slice
  std::uint32_t row_words = 0;  // of a point cluster's bits
};

// LIGHT_BOX_WORDS for each 32 lights.
std::vector<float> light_boxes(std::span<const std::byte> lights) {
  std::vector<float> rows(lights.size() / 4);
  std::memcpy(rows.data(), lights.data(), rows.size() * 4);
  const std::size_t boxes = rows.size() / VPL_WORDS / 32;
  std::vector<float> out(std::max<std::size_t>(boxes, 1) * LIGHT_BOX_WORDS);
  for (std::size_t box = 0; box < boxes; ++box) {
    float lower[3], upper[3], brightest = 0;
    std::fill(lower, lower + 3, std::numeric_limits<float>::infinity());
    std::fill(upper, upper + 3, -std::numeric_limits<float>::infinity());
    for (const float *row = &rows[box * 32 * VPL_WORDS], *end = row + 32 * VPL_WORDS; row < end; row += VPL_WORDS) {
      const float* flux = row + VPL_FLUX;
      const float bright = 0.2126f * flux[0] + 0.7152f * flux[1] + 0.0722f * flux[2];
      if (!(bright > 0)) continue;
      brightest = std::max(brightest, bright);
      for (unsigned k = 0; k < 3; ++k) {
        lower[k] = std::min(lower[k], row[VPL_POSITION + k]);
        upper[k] = std::max(upper[k], row[VPL_POSITION + k]);
      }
    }
    float* to = &out[box * LIGHT_BOX_WORDS];
    to[LIGHT_BOX_BRIGHTEST] = brightest;
    // Nothing shines there: the box may lie anywhere.
    for (unsigned k = 0; k < 3 && brightest > 0; ++k) {
      to[k] = 0.5f * (lower[k] + upper[k]);
      to[3 + k] = 0.5f * (upper[k] - lower[k]);
    }
  }
  return out;
}

// The lights and, behind them, their members.
cl::Buffer put_lights(Batch& batch, cl::CommandQueue& queue, std::span<const std::byte> lights,
                      std::uint32_t clusters) {
  const StageTask& task = batch.task;
  const std::size_t stride = VPL_WORDS * 4;
  const auto found = task.inputs.find("members");
  scene::Bytes rows(lights.begin(), lights.end());
  if (found != task.inputs.end())
    rows.insert(rows.end(), found->second.in_memory().begin(), found->second.in_memory().end());
  const std::size_t all = rows.size() / stride;
  if (rows.size() % stride != 0 || all > RESIDUAL_LIGHT)
    throw Error::bad_input("stage " + task.kind, "input members", "rows of " + std::to_string(stride) + " bytes",
                           std::to_string(rows.size() - lights.size()) + " bytes");
  for (std::size_t row = 0; row < all; ++row) {
    float radius = 0, count = 0;
    std::uint32_t first = 0;
    std::memcpy(&radius, &rows[row * stride + VPL_RADIUS * 4], 4);
    std::memcpy(&count, &rows[row * stride + VPL_COUNT * 4], 4);
    std::memcpy(&first, &rows[row * stride + VPL_FIRST * 4], 4);
    const bool member = row >= clusters;
    if (member ? first >= clusters || radius > 0
               : radius > 0 && !(first >= clusters && count >= 0 && first + static_cast<double>(count) <= all))
      throw Error::bad_input("stage " + task.kind, (member ? "member " : "light ") + std::to_string(row),
                             member ? "one of a light above it" : "members that follow the lights", "others");
  }
  return batch.put(queue, "vpl.shade.lights", rows.data(), rows.size());
}

ShadeTables make_shade_tables(Batch& batch, const VplPointParameters& p) {
  const StageTask& task = batch.task;
  const std::span<const std::byte> lights = read_table(task, "lights", p.clusters, VPL_WORDS);
  ShadeTables tables;
  cl::CommandQueue queue = batch.device.make_queue();
  tables.width = p.clusters / p.samples;
  tables.lights = put_lights(batch, queue, lights, p.clusters);
  const std::vector<float> boxes = light_boxes(lights);
  tables.boxes = batch.put(queue, "vpl.shade.boxes", boxes.data(), boxes.size() * 4);
  std::vector<float> points;
  ClusterGrid grid;
  if (p.point_clusters) {
    const std::span<const std::byte> table = read_table(task, "points", p.point_clusters, POINT_WORDS);
    tables.row_words = p.clusters / 32 + VISIBILITY_COUNTS;
    const std::span<const std::byte> bits = read_table(task, "visibility", p.point_clusters, tables.row_words);
    points.resize(table.size() / 4);
    std::memcpy(points.data(), table.data(), table.size());
    std::vector<bool> used(p.point_clusters);
    for (std::uint32_t k = 0; k < p.point_clusters; ++k) {
      std::uint32_t triangle = 0;
      std::memcpy(&triangle, &points[k * POINT_WORDS + POINT_TRIANGLE], 4);
      used[k] = triangle != GLEANER_NONE;
      for (std::size_t c = 0; used[k] && c < 6; ++c)
        if (!std::isfinite(points[k * POINT_WORDS + c]))
          throw Error::bad_input("stage vpl_shade", "input points[" + std::to_string(k) + "]", "finite numbers",
                                 "others");
    }
    grid = make_cluster_grid(points, POINT_WORDS, used);
    tables.bits = batch.put(queue, "vpl.shade.bits", bits.data(), bits.size());
  } else {
    grid = make_cluster_grid(points, POINT_WORDS, {});
    tables.bits = batch.put(queue, "vpl.shade.bits", nullptr, 0);
  }
  tables.grid = batch.put(queue, "vpl.shade.grid", grid.header.data(), grid.header.size() * 4);
  tables.cells = batch.put(queue, "vpl.shade.cells", grid.cells.data(), grid.cells.size() * 4);
  tables.seeds = batch.put(queue, "vpl.shade.seeds", grid.seeds.data(), grid.seeds.size() * 4);
  return tables;
}

class ShadeLane : public PointLane {
 public:
  ShadeLane(Batch& batch, unsigned index, const VplPointParameters& parameters, const ShadeTables& tables)
      : PointLane(batch, index, false),
        p_(parameters),
        tables_(tables),
        asker_(batch, queue_, take("rays", std::size_t{ray_capacity(batch.device)} * VISIBILITY_ROWS * 4),
               counters_buffer_, tables.lights, tables.width, parameters.samples,
               asks_alone_ ? kVisibilityFile : kResidualFile),
        members_(kernel("gather.cl", "vpl_memberships")),
        gather_(kernel("gather.cl", "vpl_gather")),
        resolve_(kernel("gather.cl", "vpl_resolve")) {
    const std::size_t room = capacity_ + RAY_BLOCK;
    rows_ = take("rows", room * MAX_FUZZINESS * 4);
    weights_ = take("weights", room * MAX_FUZZINESS * 4);
    unclustered_ = take("unclustered", room * 4);
    radiance_ = take("radiance", (room + 1) * 3 * 4);
    records_ = take("records", room * 3 * 4);
    report_ = take("report", (2 + REPORTED_ITEMS) * 4);
    own_rows_ = std::clamp<std::uint32_t>(ray_capacity(batch.device) / tables.width, 1, 4096) + 15;
    own_rows_ -= own_rows_ % 16;
    own_bits_ = take("own_bits", std::size_t{own_rows_} * tables.width / 8);
    left_out_ = take("left_out", std::size_t{own_rows_} * VISIBILITY_COUNTS * 4);
    cutoff_ = take("cutoff", std::size_t{own_rows_} * 4);
    queue_.enqueueFillBuffer(cutoff_, cl_float{0}, 0, std::size_t{own_rows_} * 4);
    chosen_ = take("chosen", (std::size_t{own_rows_} + 16) * 4);
    members_.setArg(0, batch.parameters);
    members_.setArg(1, points_);
    members_.setArg(3, tables.grid);
    members_.setArg(4, tables.cells);
    members_.setArg(5, tables.seeds);
    members_.setArg(6, CLUSTER_LEAST_COSINE);
    members_.setArg(7, rows_);
    members_.setArg(8, weights_);
    members_.setArg(9, unclustered_);
    gather_.setArg(0, batch.parameters);
    const unsigned at = gather_first_ = batch.scene.set_arguments(gather_, 1);
    gather_.setArg(at, points_);
    gather_.setArg(at + 1, chosen_);
    gather_.setArg(at + 4, tables.lights);
    gather_.setArg(at + 5, tables.width);
    gather_.setArg(at + 6, p_.samples);
    gather_.setArg(at + 8, tables.row_words);
    gather_.setArg(at + 9, rows_);
    gather_.setArg(at + 10, weights_);
    gather_.setArg(at + 11, capacity_);
    gather_.setArg(at + 12, radiance_);
    level_ = take("level", room * 4);
    gather_.setArg(at + 13, level_);
    gather_.setArg(at + 14, lobes_);
    sampled_ = take("sampled", room * 16);
    if (!asks_alone_) prepare_residual(room);
    resolve_.setArg(0, batch.parameters);
    resolve_.setArg(2, radiance_);
    resolve_.setArg(3, sampled_);
    resolve_.setArg(4, records_);
    resolve_.setArg(5, report_);
  }

  void run(BatchResult& result) {
    std::uint64_t begin = 0, part = 0;
    const std::uint32_t most = capacity_ / p_.samples;
    std::vector<std::uint32_t> unclustered(capacity_ + RAY_BLOCK);
    while (batch_.claim(most, begin, part)) {
      // Whole rows of sixteen pixels: those beyond the part are the next one's, and dropped.
      const std::uint32_t blocks = (static_cast<std::uint32_t>(part) + 15) / 16;
      const std::uint32_t paths = blocks * 16 * p_.samples;
      find_points(begin, paths);
      counters.camera -= paths - part * p_.samples;
      queue_.enqueueFillBuffer(sampled_, cl_float{0}, 0, std::size_t{paths} * 16);
      if (p_.point_clusters) {
        members_.setArg(2, paths);
        launch(members_, paths);
        gather_.setArg(gather_first_ + 2, cl_uint{0});
        gather_.setArg(gather_first_ + 3, paths);
        gather_.setArg(gather_first_ + 7, tables_.bits);
        launch(gather_, paths);
        if (asks_alone_)
          queue_.enqueueReadBuffer(unclustered_, CL_TRUE, 0, std::size_t{paths} * 4, unclustered.data());
        else
          ask_residual(paths);
      } else {
        // Points that are none stay as they are.
        queue_.enqueueFillBuffer(radiance_, cl_float{0}, 0, std::size_t{paths} * 12);
        std::fill(unclustered.begin(), unclustered.begin() + paths, 1u);
      }
      if (asks_alone_) ask_alone(unclustered, paths);
      std::uint32_t reported[2 + REPORTED_ITEMS] = {};
      queue_.enqueueWriteBuffer(report_, CL_TRUE, 0, sizeof reported, reported);
      resolve_.setArg(1, static_cast<cl_uint>(part));
      launch(resolve_, static_cast<std::uint32_t>(part), capacity_, 1);
      queue_.enqueueReadBuffer(report_, CL_TRUE, 0, sizeof reported, reported);
      queue_.enqueueReadBuffer(records_, CL_TRUE, 0, part * 12, result.records.data() + begin * 12);
      counters.nonfinite += reported[0];
      for (std::uint32_t k = 0; k < std::min(reported[1], REPORTED_ITEMS); ++k)
        counters.nonfinite_items.push_back(batch_.first + begin + reported[2 + k]);
    }
  }

 private:
  void prepare_residual(std::size_t room) {
    const std::size_t most = room * MAX_RESIDUAL_SAMPLES;
    residual_lights_ = take("residual.lights", (most + 1) * 4);
    residual_terms_ = take("residual.terms", (most + 1) * 12);
    residual_spacings_ = take("residual.spacings", room * 4);
    residual_counts_ = take("residual.counts", room * 4);
    residual_firsts_ = take("residual.firsts", room * 4);
    residual_places_ = take("residual.places", most * 4);
    residual_answers_ = take("residual.answers", most / 8);
    select_ = kernel(kResidualFile, "vpl_residual_select");
    residual_rays_ = kernel(kResidualFile, "vpl_residual_rays");
    apply_ = kernel(kResidualFile, "vpl_residual_apply");
    select_.setArg(0, batch_.parameters);
    select_.setArg(1, points_);
    select_.setArg(3, tables_.lights);
    select_.setArg(4, tables_.boxes);
    select_.setArg(5, tables_.width);
    select_.setArg(6, p_.samples);
    select_.setArg(7, tables_.bits);
    select_.setArg(8, tables_.row_words);
    select_.setArg(9, rows_);
    select_.setArg(10, weights_);
    select_.setArg(11, level_);
    select_.setArg(12, residual_lights_);
    select_.setArg(13, static_cast<cl_uint>(most));
    select_.setArg(14, residual_counts_);
    select_.setArg(15, residual_spacings_);
    residual_rays_.setArg(0, batch_.parameters);
    const unsigned at = residual_rays_first_ = batch_.scene.set_arguments(residual_rays_, 1);
    residual_rays_.setArg(at, points_);
    residual_rays_.setArg(at + 1, tables_.lights);
    residual_rays_.setArg(at + 2, residual_places_);
    residual_rays_.setArg(at + 5, residual_lights_);
    residual_rays_.setArg(at + 6, residual_spacings_);
    residual_rays_.setArg(at + 7, asker_.rays());
    residual_rays_.setArg(at + 8, residual_terms_);
    residual_rays_.setArg(at + 9, lobes_);
    apply_.setArg(1, residual_firsts_);
    apply_.setArg(2, residual_counts_);
    apply_.setArg(3, residual_lights_);
    apply_.setArg(4, residual_terms_);
    apply_.setArg(5, residual_answers_);
    apply_.setArg(6, tables_.lights);
    apply_.setArg(7, p_.clusters);
    apply_.setArg(8, tables_.bits);
    apply_.setArg(9, tables_.row_words);
    apply_.setArg(10, rows_);
    apply_.setArg(11, weights_);
    apply_.setArg(12, radiance_);
    apply_.setArg(13, sampled_);
  }

  // Points ask for some lights themselves, and are put right by the answers.
  void ask_residual(std::uint32_t paths) {
    select_.setArg(2, paths);
    launch(select_, paths);
    std::vector<std::uint32_t> counts(paths), firsts(paths), places;
    queue_.enqueueReadBuffer(residual_counts_, CL_TRUE, 0, std::size_t{paths} * 4, counts.data());
    for (std::uint32_t i = 0; i < paths; ++i) {
      firsts[i] = static_cast<std::uint32_t>(places.size());
      for (std::uint32_t k = 0; k < counts[i]; ++k) places.push_back(i * MAX_RESIDUAL_SAMPLES + k);
    }
    if (places.empty()) return;
    queue_.enqueueWriteBuffer(residual_firsts_, CL_TRUE, 0, firsts.size() * 4, firsts.data());
    queue_.enqueueWriteBuffer(residual_places_, CL_TRUE, 0, places.size() * 4, places.data());
    const std::uint32_t capacity = ray_capacity(batch_.device);
    for (std::size_t base = 0; base < places.size(); base += capacity) {
      const auto count = static_cast<std::uint32_t>(std::min<std::size_t>(capacity, places.size() - base));
      residual_rays_.setArg(residual_rays_first_ + 3, static_cast<cl_uint>(base));
      residual_rays_.setArg(residual_rays_first_ + 4, count);
      launch(residual_rays_, count, capacity, batch_.device.lanes());
      RayRange range;
      // One by one: which rays stand beside each other depends on the batch.
      range.incoherent = count;
      asker_.answer(range, count, base, residual_answers_, counters);
    }
    counters.shadow += places.size();
    apply_.setArg(0, paths);
    launch(apply_, paths, capacity_, 1);
    queue_.finish();
  }

  // Points that no cluster speaks for, sixteen of one slice at a time.
  void ask_alone(const std::vector<std::uint32_t>& unclustered, std::uint32_t paths) {
    std::vector<std::uint32_t> list;
    for (std::uint32_t slice = 0; slice < p_.samples; ++slice) {
      for (std::uint32_t block = slice; block < paths / 16; block += p_.samples)
        for (std::uint32_t i = 16 * block; i < 16 * block + 16; ++i)
          if (unclustered[i]) list.push_back(i);
      list.resize((list.size() + 15) / 16 * 16, GLEANER_NONE);
    }
    for (std::size_t at = 0; at < list.size(); at += own_rows_) {
      const auto rows = static_cast<std::uint32_t>(std::min<std::size_t>(own_rows_, list.size() - at));
      queue_.enqueueWriteBuffer(chosen_, CL_TRUE, 0, std::size_t{rows} * 4, &list[at]);
      asker_.ask(points_, chosen_, true, 0, rows, own_bits_, left_out_, cutoff_, p_.clamp, counters);
      gather_.setArg(gather_first_ + 2, cl_uint{1});
      gather_.setArg(gather_first_ + 3, rows);
      gather_.setArg(gather_first_ + 7, own_bits_);
      launch(gather_, rows);
    }
  }

  VplPointParameters p_;
  // Points near no cluster ask every light where they take no residual samples.
  bool asks_alone_ = !p_.point_clusters || !(p_.residual_threshold > 0);
  const ShadeTables& tables_;
  Asker asker_;
  cl::Kernel members_, gather_, resolve_, select_{}, residual_rays_{}, apply_{};
  cl::Buffer level_, residual_lights_, residual_terms_, residual_spacings_, residual_counts_, residual_firsts_,
      residual_places_, residual_answers_;
  unsigned residual_rays_first_ = 0;
  cl::Buffer rows_, weights_, unclustered_, radiance_, sampled_, records_, report_, own_bits_, left_out_, cutoff_,
      chosen_;
  std::uint32_t own_rows_ = 0;
  unsigned gather_first_ = 0;
};

}  // namespace

BatchResult run_vpl_trace_stage(const Device& device, Workspace& workspace, DeviceScene& scene, const StageTask& task,
                                std::uint64_t first, std::uint64_t count) {
  const auto p = read_parameters<VplTraceParameters>(task);
  check_range(task, (std::uint64_t{p.items_high} << 32) | p.items_low, first, count);
  const double start = seconds_now();
  BatchResult result;
  result.records.resize(count * VPL_PATH_SLOTS * VPL_WORDS * 4);
  if (!scene.shines()) return result;
  Batch batch(device, workspace, scene, task, first, count, 1);
  run<TraceLane>(batch, result, start);
  return result;
}

BatchResult run_vpl_points_stage(const Device& device, Workspace& workspace, DeviceScene& scene, const StageTask& task,
                                 std::uint64_t first, std::uint64_t count) {
  const auto p = read_point_parameters(task);
  check_range(task, p.items_low, first, count);
  if (p.stride == 0 || (std::uint64_t{p.items_low} - 1) * p.stride >= std::uint64_t{p.width} * p.height)
    throw Error::bad_input("stage vpl_points", "stride", "pixels within the picture", std::to_string(p.stride));
  const double start = seconds_now();
  BatchResult result;
  result.records.resize(count * POINT_WORDS * 4);
  Batch batch(device, workspace, scene, task, first, count, 1);
  run<PointLane>(batch, result, start, true);
  return result;
}

BatchResult run_vpl_visibility_stage(const Device& device, Workspace& workspace, DeviceScene& scene,
                                     const StageTask& task, std::uint64_t first, std::uint64_t count) {
  const auto p = read_parameters<VisibilityParameters>(task);
  if (p.clusters == 0 || p.clusters % 32 != 0 || p.clusters > (1u << 24))
    throw Error::bad_input("stage vpl_visibility", "clusters", "a multiple of 32 up to 2^24",
                           std::to_string(p.clusters));
  if (!(p.clamp > 0) || !(p.cutoff >= 0))
    throw Error::bad_input("stage vpl_visibility", "clamp, cutoff", "a number above 0, and one that is not below",
                           "others");
  check_range(task, p.point_clusters, first, count);
  const double start = seconds_now();
  BatchResult result;
  result.records.resize(count * (p.clusters / 32 + VISIBILITY_COUNTS) * 4);
  Batch batch(device, workspace, scene, task, first, count, 1);
  const auto& tables = kept_tables<VisibilityTables>(batch, "vpl.visibility", [&] {
    const std::span<const std::byte> lights = read_table(task, "lights", p.clusters, VPL_WORDS);
    const std::span<const std::byte> points = read_table(task, "points", p.point_clusters, POINT_WORDS);
    check_triangles(task, "points", points, POINT_WORDS, POINT_TRIANGLE, scene.triangles());
    cl::CommandQueue queue = device.make_queue();
    return VisibilityTables{batch.put(queue, "vpl.visibility.lights", lights.data(), lights.size()),
                            batch.put(queue, "vpl.visibility.points", points.data(), points.size())};
  });
  run<VisibilityLane>(batch, result, start, tables, p);
  return result;
}

BatchResult run_vpl_shade_stage(const Device& device, Workspace& workspace, DeviceScene& scene, const StageTask& task,
                                std::uint64_t first, std::uint64_t count) {
  const auto p = read_point_parameters(task);
  check_range(task, p.items_low, first, count);
  if (first % 16 != 0)
    throw Error::bad_input("stage vpl_shade", "items", "a range that begins at a multiple of 16",
                           std::to_string(first));
  if (p.clusters == 0 || p.clusters % (32 * p.samples) != 0 || p.clusters > (1u << 24))
    throw Error::bad_input("stage vpl_shade", "clusters", "a multiple of 32 times the samples",
                           std::to_string(p.clusters));
  if (p.fuzziness == 0 || p.fuzziness > MAX_FUZZINESS)
    throw Error::bad_input("stage vpl_shade", "fuzziness", "1 to " + std::to_string(MAX_FUZZINESS),
                           std::to_string(p.fuzziness));
  const double start = seconds_now();
  BatchResult result;
  result.records.resize(count * 12);
  Batch batch(device, workspace, scene, task, first, count, p.point_clusters ? p.fuzziness : 1);
  const auto& tables = kept_tables<ShadeTables>(batch, "vpl.shade", [&] { return make_shade_tables(batch, p); });
  run<ShadeLane>(batch, result, start, p, tables);
  return result;
}

}  // namespace gleaner::worker

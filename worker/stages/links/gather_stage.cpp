// Stage kinds "links_gather": one bounce of light over the links (kernels/links/gather.cl), and "links_exchange": all
// bounces on one worker.

#include <array>
#include <span>

#include "scene/model/error.h"
#include "worker/stages/links/flux.h"
#include "worker/stages/links/mesh.h"
#include "worker/stages/links/stages.h"
#include "worker/stages/links/waves.h"
#include "worker/stages/vpl/rows.h"
#include "worker/wavefront/host_threads.h"
#include "worker/wavefront/input_rows.h"

namespace gleaner::worker {
namespace {

using kernels::LinksGatherParameters;

std::uint32_t gather_capacity(const Device& device) { return device.info().cpu ? 1u << 9 : 1u << 17; }

// An input's bytes [offset, offset + bytes) as a buffer: where they lie already, on devices that share the host's
// memory.
cl::Buffer as_buffer(const StageRun& run, cl::CommandQueue& queue, const InputRows& rows, const TaskInput& input,
                     std::uint64_t offset, std::uint64_t bytes) {
  const std::span<const std::byte> whole = input.in_memory();
  if (bytes == 0) return run.device.make_buffer(64);
  if (run.device.info().cpu && !whole.empty() && reinterpret_cast<std::uintptr_t>(whole.data() + offset) % 16 == 0)
    return cl::Buffer(run.device.context(), CL_MEM_READ_ONLY | CL_MEM_USE_HOST_PTR, bytes,
                      const_cast<std::byte*>(whole.data() + offset));
  cl::Buffer buffer = run.device.make_buffer(bytes);
  rows.upload(queue, buffer, 0, offset / rows.row_bytes(), bytes / rows.row_bytes(), {});
  return buffer;
}

// A batch's inputs, as its host threads read them.
struct GatherBatch {
  std::uint32_t elements = 0;  // of the mesh
  cl::Buffer parameters{}, words{}, starts{}, sent{}, light{}, albedo{}, records{}, faults{};
};

cl::Buffer own_rows(const StageRun& run, cl::CommandQueue& queue, const char* name, std::size_t row_bytes,
                    std::uint64_t elements) {
  const InputRows rows(run.task, name, row_bytes);
  const std::uint64_t first = rows.first_row_of(run.first, run.count, elements);
  return as_buffer(run, queue, rows, run.task.inputs.at(name), first * row_bytes, run.count * row_bytes);
}

// Of rows of RADIOSITY_WORDS what is looked up over links: what elements send, without the rest of their rows, which is
// as much again, by the numbers of links' ends. `rows`: of the elements from `first` on; the first `plain` of all
// elements are the mesh's.
constexpr std::size_t kRowBytes = RADIOSITY_WORDS * 4, kSentBytes = (RADIOSITY_WORDS - RADIOSITY_SENT) * 4;
void copy_sent(std::span<const std::byte> rows, std::uint64_t first, std::uint64_t plain, std::byte* sent) {
  for (std::size_t at = 0; at < rows.size(); at += kRowBytes, ++first) {
    const std::uint64_t end = first < plain ? LINK_END(first, plain / 2) : first;
    std::memcpy(sent + end * kSentBytes, &rows[at + std::size_t{RADIOSITY_SENT} * 4], kSentBytes);
  }
}

void put_sent(const StageRun& run, cl::CommandQueue& queue, const char* name, std::uint64_t elements,
              std::uint64_t plain, cl::Buffer& buffer) {
  const InputRows rows(run.task, name, kRowBytes);
  rows.expect_rows(elements);
  auto* out = static_cast<std::byte*>(
      queue.enqueueMapBuffer(buffer, CL_TRUE, CL_MAP_WRITE_INVALIDATE_REGION, 0, elements * kSentBytes));
  rows.visit(0, elements,
             [&](std::uint64_t row, std::span<const std::byte> bytes) { copy_sent(bytes, row, plain, out); });
  queue.enqueueUnmapMemObject(buffer, out);
  queue.finish();
}

// For all batches of a bounce.
struct SentTable {
  cl::Buffer sent{};
  std::size_t bytes() const { return sent.getInfo<CL_MEM_SIZE>(); }
};

cl::Buffer kept_sent(const StageRun& run, cl::CommandQueue& queue, const LinksGatherParameters& p) {
  StageTask radiosity;
  radiosity.kind = run.task.kind;
  radiosity.parameters = run.task.parameters;
  radiosity.inputs["radiosity"] = run.task.inputs.at("radiosity");
  return run.tables
      .get<SentTable>(radiosity,
                      [&] {
                        SentTable table{run.device.make_buffer(p.elements * kSentBytes)};
                        put_sent(run, queue, "radiosity", p.elements, p.plain, table.sent);
                        return table;
                      })
      ->sent;
}

// Links on the device, and where each element's begin.
struct LinkTables {
  TaskInput source{};  // the buffer may be its memory
  cl::Buffer words{}, starts{};
  std::size_t bytes() const { return words.getInfo<CL_MEM_SIZE>() + starts.getInfo<CL_MEM_SIZE>(); }
};

LinkTables links_of(const StageRun& run, cl::CommandQueue& queue, std::uint64_t elements) {
  const InputRows rows(run.task, "links", 4);
  const TaskInput& input = run.task.inputs.at("links");
  const std::uint64_t at = input.own_items ? run.first - input.first_item : run.first;
  const std::uint64_t held = input.offsets ? input.offsets->size() : 0;
  if ((input.own_items && run.first < input.first_item) || at + run.count >= held ||
      (!input.own_items && held != elements + 1) || input.offsets->back() > rows.rows())
    throw Error::bad_input(
        run.where(), "input links",
        "links of elements " + std::to_string(run.first) + " + " + std::to_string(run.count),
        "offsets of " + std::to_string(held) + " elements and " + std::to_string(rows.rows()) + " words");
  const std::uint64_t* offset = input.offsets->data() + at;
  const std::uint64_t words = offset[run.count] - offset[0];
  if (words > 0xffffffffu)
    throw Error::bad_input(run.where(), "input links", "fewer than 2^32 words a batch", std::to_string(words));
  std::vector<cl_uint> starts(run.count + 1);
  for (std::uint64_t k = 0; k <= run.count; ++k) starts[k] = static_cast<cl_uint>(offset[k] - offset[0]);
  LinkTables tables;
  tables.source = input;
  tables.starts = run.device.make_buffer(starts.size() * 4);
  queue.enqueueWriteBuffer(tables.starts, CL_TRUE, 0, starts.size() * 4, starts.data());
  tables.words = as_buffer(run, queue, rows, input, offset[0] * 4, words * 4);
  return tables;
}

// Links serve every light and every bounce: they stay on the device, whatever else the stage reads.
std::shared_ptr<const LinkTables> kept_links(const StageRun& run, cl::CommandQueue& queue, std::uint64_t elements) {
  StageTask links;
  links.kind = run.task.kind;
  links.inputs["links"] = run.task.inputs.at("links");
  const std::array<std::uint64_t, 2> items = {run.first, run.count};
  const auto bytes = std::as_bytes(std::span(items));
  links.parameters.assign(bytes.begin(), bytes.end());
  return run.tables.get<LinkTables>(links, [&] { return links_of(run, queue, elements); });
}

class GatherThread : public HostThread {
 public:
  GatherThread(const StageRun& run, const GatherBatch& batch, const Program& program, WorkQueue& work, unsigned index)
      : HostThread(run.device, run.workspace, run.scene.tracer(), work, index),
        records_(batch.records),
        gather_(run.device, program, "links_gather") {
    gather_.set("parameters", batch.parameters)
        .set("words", batch.words)
        .set("starts", batch.starts)
        .set("sent", batch.sent)
        .set("light", batch.light)
        .set("albedo", batch.albedo)
        .set("records", batch.records)
        .set("faults", batch.faults);
  }

  void run(BatchResult& result) {
    const std::uint32_t capacity = gather_capacity(device_);
    while (const WorkQueue::Block block = work_.claim(capacity)) {
      gather_.set("base", static_cast<cl_uint>(block.first))
          .set("count", static_cast<cl_uint>(block.first + block.count));
      // On CPU devices a work-item has vectors of its own: groups of one keep PoCL from taking these apart.
      gather_.launch(queue_, {.work = block.count, .capacity = capacity, .group = device_.info().cpu ? 1u : 0u});
      queue_.enqueueReadBuffer(records_, CL_TRUE, block.first * kRowBytes, block.count * kRowBytes,
                               result.records.data() + block.first * kRowBytes);
    }
  }

 private:
  cl::Buffer records_;
  Kernel gather_;
};

// What stays for all bounces: their results, and what the host threads count.
void make_room(const StageRun& run, cl::CommandQueue& queue, GatherBatch& batch) {
  batch.records = run.workspace.take("links.gathered", run.count * kRowBytes);
  batch.faults = run.workspace.take("links.faults", 64);
  constexpr cl_uint none = 0;
  queue.enqueueWriteBuffer(batch.faults, CL_TRUE, 0, sizeof none, &none);
}

void put_parameters(const StageRun& run, cl::CommandQueue& queue, const LinksGatherParameters& p, GatherBatch& batch) {
  batch.elements = p.elements;
  batch.parameters = run.workspace.take("links.gather_parameters", sizeof p);
  queue.enqueueWriteBuffer(batch.parameters, CL_TRUE, 0, sizeof p, &p);
}

void check_plain(const StageRun& run, std::uint32_t elements, std::uint32_t plain) {
  if (elements == 0 || plain == 0 || plain > elements || plain % 2 != 0)
    throw Error::bad_input(run.where(), "elements", "1 or more, two a vertex of the mesh among them",
                           std::to_string(elements) + ", " + std::to_string(plain));
}

// One bounce of the batch's elements, into the result's records.
void gather(const StageRun& run, cl::CommandQueue& queue, const GatherBatch& batch, BatchResult& result) {
  const Program program = run.build_plain("gather.cl");
  WorkQueue work(run.count, host_threads(run.device));
  run_host_threads(work, result,
                   [&](unsigned index) { return std::make_unique<GatherThread>(run, batch, program, work, index); });
  cl_uint faults = 0;
  queue.enqueueReadBuffer(batch.faults, CL_TRUE, 0, sizeof faults, &faults);
  if (faults)
    throw Error::bad_input(run.where(), "input links", "ends below " + std::to_string(batch.elements),
                           std::to_string(faults) + " elements with others");
}

}  // namespace

BatchResult run_links_gather_stage(const StageRun& run) {
  const auto p = run.parameters<LinksGatherParameters>();
  run.check_range(p.elements);
  check_plain(run, p.elements, p.plain);
  const double start = seconds_now();
  cl::CommandQueue queue = run.device.make_queue();
  GatherBatch batch;
  put_parameters(run, queue, p, batch);
  const std::shared_ptr<const LinkTables> links = kept_links(run, queue, p.elements);
  batch.words = links->words;
  batch.starts = links->starts;
  batch.light = own_rows(run, queue, "light", kRowBytes, p.elements);
  batch.albedo = own_rows(run, queue, "albedo", ALBEDO_WORDS * 4, p.elements);
  batch.sent = kept_sent(run, queue, p);
  make_room(run, queue, batch);
  BatchResult result;
  result.records.resize(run.count * kRowBytes);
  gather(run, queue, batch, result);
  result.counters.seconds = seconds_now() - start;
  return result;
}

namespace {

// What all elements send after a bounce, for the next one.
void send(cl::CommandQueue& queue, const scene::Bytes& rows, std::uint64_t plain, const cl::Buffer& sent) {
  const std::uint64_t elements = rows.size() / kRowBytes;
  auto* out = static_cast<std::byte*>(
      queue.enqueueMapBuffer(sent, CL_TRUE, CL_MAP_WRITE_INVALIDATE_REGION, 0, elements * kSentBytes));
  copy_sent(rows, 0, plain, out);
  queue.enqueueUnmapMemObject(sent, out);
  queue.finish();
}

}  // namespace

BatchResult run_links_exchange_stage(const StageRun& run) {
  const auto p = run.parameters<kernels::LinksExchangeParameters>();
  run.check_range(p.elements);
  if (p.elements == 0 || run.count != p.elements)
    throw Error::bad_input(run.where(), "elements", "1 or more, all of them", std::to_string(run.count));
  check_plain(run, p.elements, p.plain);
  if (p.most_bounces == 0 || !(p.least_share >= 0))
    throw Error::bad_input(run.where(), "bounces", "1 or more, to a share that is not negative",
                           std::to_string(p.most_bounces) + ", " + std::to_string(p.least_share));
  const double start = seconds_now();
  cl::CommandQueue queue = run.device.make_queue();
  GatherBatch batch;
  put_parameters(run, queue, LinksGatherParameters{p.elements, p.exact, p.directions, p.plain}, batch);
  const std::shared_ptr<const LinkTables> links = kept_links(run, queue, p.elements);
  batch.words = links->words;
  batch.starts = links->starts;
  batch.light = own_rows(run, queue, "light", kRowBytes, p.elements);
  batch.albedo = own_rows(run, queue, "albedo", ALBEDO_WORDS * 4, p.elements);
  batch.sent = run.workspace.take("links.sent", p.elements * kSentBytes);
  put_sent(run, queue, "light", p.elements, p.plain, batch.sent);
  make_room(run, queue, batch);
  const std::vector<float> areas = p.least_share > 0 ? element_areas(run.task) : std::vector<float>{};
  if (p.least_share > 0 && areas.size() != p.elements)
    throw Error::bad_input(run.where(), "inputs mesh and lobes", std::to_string(p.elements) + " elements",
                           std::to_string(areas.size()));
  BatchResult result;
  result.records.resize(run.count * kRowBytes);
  // Rows after the last bounce and after the two before it, where these are measured.
  std::vector<float> after = input_rows(run.task, "light", RADIOSITY_WORDS), before, earlier;
  kernels::LinksBounces bounces;
  bounces.adds_tail = p.adds_tail != 0;
  std::uint32_t bounce = 0;
  for (bool enough = false; !enough && bounce < p.most_bounces;) {
    ++bounce;
    gather(run, queue, batch, result);
    if (p.least_share > 0 && bounce + 2 >= bounces.next && bounce < p.most_bounces) {
      std::swap(earlier, before);
      std::swap(before, after);
      after.resize(before.size());
      std::memcpy(after.data(), result.records.data(), result.records.size());
    }
    if (p.least_share > 0 && bounce == bounces.next && bounce < p.most_bounces)
      enough = bounces.is_enough(flux_of(areas, after, before, earlier), double{p.least_share});
    if (!enough && bounce < p.most_bounces) send(queue, result.records, p.plain, batch.sent);
  }
  if (p.least_share > 0 && bounces.adds_tail && bounce == bounces.done) {
    add_tail(after, before, bounces.tail);
    std::memcpy(result.records.data(), after.data(), result.records.size());
  }
  set_facts(result, kernels::LinksExchangeFacts{bounce, 0, bounces.left});
  result.counters.seconds = seconds_now() - start;
  return result;
}

}  // namespace gleaner::worker

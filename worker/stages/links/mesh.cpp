#include "worker/stages/links/mesh.h"

#include <cmath>

#include "scene/model/error.h"
#include "worker/stages/links/stages.h"
#include "worker/stages/vpl/rows.h"
#include "worker/wavefront/counters.h"

namespace gleaner::worker {
namespace {

// Checks words of a mesh section by section, as they pass.
class MeshCheck {
 public:
  MeshCheck(const InputRows& input, const MeshLayout& layout, std::uint64_t triangles)
      : input_(input), l_(layout), triangles_(triangles) {}

  void word(std::uint64_t at, std::uint32_t value) {
    if (at < MESH_HEADER) return;
    if (at < l_.nodes_at())
      triangle(at, value);
    else if (at < l_.rings_at())
      below(at, "node", value, l_.vertices);
    else if (at < l_.corners_at())
      ring(at, value);
    else if (at < l_.areas_at())
      corner(at, value);
    else if (at >= l_.places_at())
      place(at, value);
  }

 private:
  void below(std::uint64_t at, const char* what, std::uint32_t value, std::uint64_t limit) const {
    if (value >= limit) input_.fail(at, what, "below " + std::to_string(limit), std::to_string(value));
  }
  void triangle(std::uint64_t at, std::uint32_t value) {
    if ((at - MESH_HEADER) % MESH_TRIANGLE_WORDS == 0) {
      first_node_ = value;
      return;
    }
    below(at, "level", value, MESH_MOST_LEVEL + 1);
    if (first_node_ + nodes_of_level(value) > l_.nodes)
      input_.fail(at, "nodes", "among " + std::to_string(l_.nodes), std::to_string(first_node_) + " and on");
  }
  // Every vertex has a corner: kernels read one without looking.
  void ring(std::uint64_t at, std::uint32_t value) {
    const std::uint64_t vertex = at - l_.rings_at();
    const bool ok = vertex == 0 ? value == 0 : value > ring_ && (vertex < l_.vertices || value == l_.corners);
    if (!ok) input_.fail(at, "first corner", "above the last vertex' and within all", std::to_string(value));
    ring_ = value;
  }
  void corner(std::uint64_t at, std::uint32_t value) const {
    const std::uint64_t word = (at - l_.corners_at()) % CORNER_WORDS;
    if (word == CORNER_TRIANGLE) below(at, "triangle", value, triangles_);
    if (word == CORNER_PLACE) below(at, "kind", value >> 24, CORNER_KINDS);
  }

  void place(std::uint64_t at, std::uint32_t value) const {
    const bool hangs = at >= l_.hanging_at();
    const std::uint64_t word = hangs ? (at - l_.hanging_at()) % HANGING_WORDS : (at - l_.places_at()) % PLACE_WORDS;
    if (hangs ? word != HANGING_PART : word == PLACE_FIRST) below(at, "vertex", value, l_.vertices);
  }

  const InputRows& input_;
  const MeshLayout& l_;
  std::uint64_t triangles_;
  std::uint64_t first_node_ = 0;
  std::uint32_t ring_ = 0;
};

}  // namespace

MeshLayout read_mesh_layout(const StageTask& task, const char* name) {
  const InputRows input(task, name, 4);
  MeshLayout layout;
  if (input.rows() < MESH_HEADER)
    throw Error::bad_input("stage " + task.kind, std::string("input ") + name, "a header",
                           std::to_string(input.rows()) + " words");
  input.visit(0, MESH_HEADER, [&](std::uint64_t, std::span<const std::byte> words) {
    layout.triangles = row_word<std::uint32_t>(words.data(), MESH_TRIANGLES);
    layout.nodes = row_word<std::uint32_t>(words.data(), MESH_NODES);
    layout.vertices = row_word<std::uint32_t>(words.data(), MESH_VERTICES);
    layout.corners = row_word<std::uint32_t>(words.data(), MESH_CORNERS);
    layout.hanging = row_word<std::uint32_t>(words.data(), MESH_HANGING);
  });
  input.expect_rows(layout.words());
  return layout;
}

HostMesh read_mesh(const StageTask& task, const char* name) {
  HostMesh mesh{read_mesh_layout(task, name), {}};
  const InputRows input(task, name, 4);
  MeshCheck check(input, mesh.layout, mesh.layout.triangles);
  mesh.words.resize(mesh.layout.words());
  input.visit(0, mesh.words.size(), [&](std::uint64_t first, std::span<const std::byte> words) {
    std::memcpy(&mesh.words[first], words.data(), words.size());
    for (std::size_t at = 0; at < words.size(); at += 4) check.word(first++, row_word<std::uint32_t>(&words[at], 0));
  });
  return mesh;
}

namespace {

struct DeviceMesh {
  MeshLayout layout;
  cl::Buffer words{};
  std::size_t bytes() const { return words.getInfo<CL_MEM_SIZE>(); }
};

struct DeviceRows {
  cl::Buffer rows{};
  std::size_t bytes() const { return rows.getInfo<CL_MEM_SIZE>(); }
};

// Of the elements that lie inside, where a scene is seen from its fronts.
constexpr double kLeastHidden = 0.75;

// SIDE_BITS of each element of a probe's rows.
std::vector<std::uint32_t> side_words(const std::vector<float>& probe) {
  const std::uint64_t elements = probe.size() / PROBE_WORDS;
  std::uint64_t inside = 0, hidden = 0;
  for (std::uint64_t e = 0; e < elements; ++e) inside += is_inside(probe, e), hidden += is_hidden(probe, e);
  const bool from_fronts = hidden > 0 && static_cast<double>(hidden) >= kLeastHidden * static_cast<double>(inside);
  std::vector<std::uint32_t> words(elements / SIDES_OF_WORD + 1, 0);
  for (std::uint64_t e = 0; e < elements; ++e) {
    const std::uint32_t bits =
        (is_inside(probe, e) ? SIDE_INSIDE : 0u) | (from_fronts && is_hidden(probe, e) ? SIDE_HIDDEN : 0u);
    words[e / SIDES_OF_WORD] |= bits << (e % SIDES_OF_WORD * SIDE_BITS);
  }
  return words;
}

// Names what is kept of one input: neither the scene nor the stage has a part in it.
StageTask only(const StageTask& task, const char* input) {
  StageTask key;
  key.kind = std::string("links input ") + input;
  key.inputs[input] = task.inputs.at(input);
  return key;
}

// A number of a lobe, or an element that has one.
void check_lobe_word(const InputRows& input, std::uint64_t row, std::uint32_t value, std::uint64_t plain,
                     std::uint64_t lobes) {
  const bool numbers = row < plain;
  if (numbers ? value < lobes || value == GLEANER_NONE : value < plain) return;
  input.fail(row, numbers ? "lobe" : "element", "below " + std::to_string(numbers ? lobes : plain),
             std::to_string(value));
}

}  // namespace

MeshTables mesh_tables(const StageRun& run, const char* rows, unsigned words) {
  cl::CommandQueue queue = run.device.make_queue();
  const auto mesh = run.tables.get<DeviceMesh>(only(run.task, "mesh"), [&] {
    DeviceMesh made{read_mesh_layout(run.task, "mesh")};
    const InputRows input(run.task, "mesh", 4);
    MeshCheck check(input, made.layout, made.layout.triangles);
    made.words = input.to_device(run.device, queue, [&](std::uint64_t row, std::span<const std::byte> bytes) {
      for (std::size_t at = 0; at < bytes.size(); at += 4) check.word(row++, row_word<std::uint32_t>(&bytes[at], 0));
    });
    return made;
  });
  if (mesh->layout.triangles != run.scene.triangles())
    throw Error::bad_input(run.where(), "input mesh", std::to_string(run.scene.triangles()) + " triangles",
                           std::to_string(mesh->layout.triangles));
  MeshTables tables{mesh->layout, mesh->words};
  if (!rows) return tables;
  const InputRows input(run.task, rows, std::size_t{words} * 4);
  // Behind the mesh's elements there may be those of lobes.
  if (input.rows() < tables.layout.elements()) input.expect_rows(tables.layout.elements());
  tables.rows =
      run.tables
          .get<DeviceRows>(only(run.task, rows), [&] { return DeviceRows{input.to_device(run.device, queue, {})}; })
          ->rows;
  return tables;
}

cl::Buffer element_sides(const StageRun& run, std::uint64_t elements) {
  const auto make = [&] {
    const InputRows input(run.task, "probe", PROBE_WORDS * 4);
    input.expect_rows(elements);
    const std::vector<std::uint32_t> words = side_words(input_rows(run.task, "probe", PROBE_WORDS));
    cl::CommandQueue queue = run.device.make_queue();
    DeviceRows made{run.device.make_buffer(words.size() * 4)};
    queue.enqueueWriteBuffer(made.rows, CL_TRUE, 0, words.size() * 4, words.data());
    return made;
  };
  return run.tables.get<DeviceRows>(only(run.task, "probe"), make)->rows;
}

LobeTables lobe_tables(const StageRun& run, const MeshTables& mesh) {
  LobeTables tables{mesh.mesh, 0};
  if (!run.task.inputs.contains("lobes")) return tables;
  const InputRows input(run.task, "lobes", 4);
  const std::uint64_t plain = mesh.layout.elements();
  if (input.rows() < plain) input.expect_rows(plain);
  const std::uint64_t lobes = input.rows() - plain;
  tables.elements = lobes * LOBE_BINS;
  cl::CommandQueue queue = run.device.make_queue();
  tables.lobes =
      run.tables
          .get<DeviceRows>(only(run.task, "lobes"),
                           [&] {
                             return DeviceRows{input.to_device(
                                 run.device, queue, [&](std::uint64_t row, std::span<const std::byte> bytes) {
                                   for (std::size_t at = 0; at < bytes.size(); at += 4, ++row)
                                     check_lobe_word(input, row, row_word<std::uint32_t>(&bytes[at], 0), plain, lobes);
                                 })};
                           })
          ->rows;
  return tables;
}

namespace {

std::vector<std::uint32_t> levels_of(const StageRun& run, const TriangleRows& triangles,
                                     const kernels::LinksMeshParameters& wanted) {
  if (run.task.inputs.contains("divided")) {
    const HostMesh divided = read_mesh(run.task, "divided");
    if (divided.layout.triangles != triangles.count)
      throw Error::bad_input(run.where(), "input divided", std::to_string(triangles.count) + " triangles",
                             std::to_string(divided.layout.triangles));
    std::vector<std::uint32_t> levels(triangles.count);
    for (std::uint64_t t = 0; t < triangles.count; ++t) levels[t] = divided.level(t);
    return levels;
  }
  if (!run.task.inputs.contains("coarse")) return even_levels(triangles, wanted);
  const HostMesh coarse = read_mesh(run.task, "coarse");
  const std::vector<float> probe = input_rows(run.task, "probe", PROBE_WORDS);
  if (coarse.layout.triangles != triangles.count || probe.size() != coarse.layout.elements() * PROBE_WORDS)
    throw Error::bad_input(
        run.where(), "inputs coarse and probe",
        std::to_string(triangles.count) + " triangles, and a row for each of " +
            std::to_string(coarse.layout.elements()) + " elements",
        std::to_string(coarse.layout.triangles) + " and " + std::to_string(probe.size() / PROBE_WORDS));
  return refined_levels(triangles, wanted, coarse, probe);
}

}  // namespace

TriangleRows read_triangles(const StageRun& run, std::vector<float>& rows) {
  const unsigned words = run.scene.triangle_words();
  cl::CommandQueue queue = run.device.make_queue();
  rows.resize(run.scene.triangles() * words);
  if (!rows.empty()) queue.enqueueReadBuffer(run.scene.triangle_rows(), CL_TRUE, 0, rows.size() * 4, rows.data());
  return {rows.data(), words, run.scene.triangles()};
}

// Stage kind "links_mesh".
BatchResult run_links_mesh_stage(const StageRun& run) {
  const auto p = run.parameters<kernels::LinksMeshParameters>();
  run.check_range(1);
  const double start = seconds_now();
  std::vector<float> rows;
  const TriangleRows filled = read_triangles(run, rows);
  kernels::LinksMeshFacts facts{};
  const std::vector<std::uint32_t> mesh = make_links_mesh(filled, levels_of(run, filled, p), &facts);
  BatchResult result;
  result.records.resize(mesh.size() * 4);
  std::memcpy(result.records.data(), mesh.data(), result.records.size());
  result.counts = {static_cast<std::uint32_t>(mesh.size())};
  set_facts(result, facts);
  result.counters.seconds = seconds_now() - start;
  return result;
}

}  // namespace gleaner::worker

#include "worker/stages/photon/map_table.h"

#include <cmath>

#include "kernels/rays.h"
#include "scene/model/error.h"
#include "worker/wavefront/input_rows.h"

namespace gleaner::worker {
namespace {

constexpr std::size_t kRowBytes = PHOTON_WORDS * 4;

struct Shape {
  std::uint64_t nodes = 0, blocks = 0;
};

Shape read_header(const InputRows& rows) {
  Shape shape;
  if (rows.rows() == 0) rows.fail(0, "header", "a photon map", "no row");
  rows.visit(0, 1, [&](std::uint64_t, std::span<const std::byte> row) {
    shape.nodes = row_word<std::uint32_t>(row.data(), MAP_NODES);
    shape.blocks = row_word<std::uint32_t>(row.data(), MAP_BLOCKS);
  });
  // An odd number of nodes: the photons behind them lie at whole cache lines.
  if (shape.nodes % 2 == 0 || rows.rows() != 1 + shape.nodes + shape.blocks * RAY_BLOCK)
    rows.fail(0, "nodes and blocks", "an odd number of nodes, and together " + std::to_string(rows.rows()) + " rows",
              std::to_string(shape.nodes) + " and " + std::to_string(shape.blocks));
  return shape;
}

// Children and photons exist, and the walk through the nodes ends.
void check_nodes(const InputRows& rows, const Shape& shape) {
  rows.visit(1, shape.nodes, [&](std::uint64_t row, std::span<const std::byte> piece) {
    for (std::size_t at = 0; at < piece.size(); at += kRowBytes, ++row) {
      const std::uint64_t node = row - 1;
      const auto block = row_word<std::uint32_t>(&piece[at], NODE_BLOCK);
      const auto skip = row_word<std::uint32_t>(&piece[at], NODE_SKIP);
      const bool leaf = block != GLEANER_NONE;
      if (skip < node + (leaf ? 1 : 3) || skip > shape.nodes)
        rows.fail(row, "skip", "a node behind this one and its children, at most " + std::to_string(shape.nodes),
                  std::to_string(skip));
      if (leaf && block >= shape.blocks)
        rows.fail(row, "block", "below " + std::to_string(shape.blocks), std::to_string(block));
    }
  });
}

void check_powers(const InputRows& rows, const Shape& shape) {
  constexpr std::size_t words = std::size_t{PHOTON_WORDS} * RAY_BLOCK, power = std::size_t{PHOTON_POWER} * RAY_BLOCK;
  const InputRows::Check check = [&, word = std::size_t{0}](std::uint64_t row,
                                                            std::span<const std::byte> piece) mutable {
    for (std::size_t at = 0; at < piece.size(); at += 4, ++word) {
      const std::size_t in_block = word % words;
      if (in_block < power || in_block >= power + 3 * RAY_BLOCK) continue;
      const auto value = row_word<float>(&piece[at], 0);
      if (!(value >= 0) || !std::isfinite(value))
        rows.fail(row + at / kRowBytes, "power", "a finite number, not negative", std::to_string(value));
    }
  };
  rows.visit(1 + shape.nodes, shape.blocks * RAY_BLOCK, check);
}

PhotonMapTable make_table(const StageRun& run, const InputRows& rows) {
  const Shape shape = read_header(rows);
  check_nodes(rows, shape);
  check_powers(rows, shape);
  cl::CommandQueue queue = run.device.make_queue();
  return {.rows = rows.to_device(run.device, queue, {}),
          .nodes = static_cast<std::uint32_t>(shape.nodes),
          .size = rows.rows() * kRowBytes};
}

}  // namespace

void PhotonMapTable::set_arguments(Kernel& kernel, const std::string& name) const {
  kernel.set(name, rows).set(name + "_nodes", nodes);
}

std::shared_ptr<const PhotonMapTable> photon_map_table(const StageRun& run, const std::string& input) {
  // By the map alone: all kinds of stages that read it share its table, whatever their items.
  StageTask key;
  key.kind = "photon map";
  key.scene = run.task.scene;
  const auto found = run.task.inputs.find(input);
  if (found != run.task.inputs.end()) key.inputs["map"] = found->second;
  return run.tables.get<PhotonMapTable>(key, [&] { return make_table(run, InputRows(run.task, input, kRowBytes)); });
}

namespace {

// The walk through the cut ends, and what it finds is light.
PhotonCutTable make_cut(const StageRun& run) {
  const InputRows rows(run.task, "cut", CUT_WORDS * 4);
  const InputRows::Check check = [&](std::uint64_t row, std::span<const std::byte> piece) {
    for (std::size_t at = 0; at < piece.size(); at += CUT_WORDS * 4, ++row) {
      const auto skip = row_word<std::uint32_t>(&piece[at], NODE_SKIP);
      if (skip <= row || skip > rows.rows())
        rows.fail(row, "skip", "a node behind this one, at most " + std::to_string(rows.rows()), std::to_string(skip));
      for (const unsigned word : {CUT_NEARNESS, CUT_IRRADIANCE, CUT_IRRADIANCE + 1, CUT_IRRADIANCE + 2}) {
        const auto value = row_word<float>(&piece[at], word);
        if (!(value >= 0) || !std::isfinite(value))
          rows.fail(row, "irradiance", "finite numbers, not negative", std::to_string(value));
      }
    }
  };
  cl::CommandQueue queue = run.device.make_queue();
  return {.rows = rows.to_device(run.device, queue, check),
          .nodes = static_cast<std::uint32_t>(rows.rows()),
          .most_depth = 0,
          .size = rows.rows() * CUT_WORDS * 4};
}

}  // namespace

void PhotonCutTable::set_arguments(Kernel& kernel) const {
  kernel.set("cut", rows).set("cut_nodes", nodes).set("cut_depth", most_depth);
}

PhotonCutTable photon_cut_table(const StageRun& run, std::uint32_t most_depth) {
  const auto found = run.task.inputs.find("cut");
  // Not touched where there is no cut.
  if (found == run.task.inputs.end())
    return {.rows = run.workspace.take("cut.none", 64), .nodes = 0, .most_depth = 0, .size = 0};
  StageTask key;
  key.kind = "photon cut";
  key.scene = run.task.scene;
  key.inputs["cut"] = found->second;
  PhotonCutTable table = *run.tables.get<PhotonCutTable>(key, [&] { return make_cut(run); });
  table.most_depth = most_depth;
  return table;
}

void check_photon_estimate(const StageRun& run, const kernels::PhotonEstimate& estimate) {
  if (estimate.neighbours > PHOTON_MOST_NEIGHBOURS)
    throw Error::bad_input(run.where(), "neighbours", "at most " + std::to_string(PHOTON_MOST_NEIGHBOURS),
                           std::to_string(estimate.neighbours));
  if (!(estimate.most_radius > 0) || !std::isfinite(estimate.most_radius))
    throw Error::bad_input(run.where(), "most_radius", "metres above 0", std::to_string(estimate.most_radius));
}

}  // namespace gleaner::worker

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

// `words`: of each of a block's 16 members.
Shape read_header(const InputRows& rows, unsigned words) {
  Shape shape;
  if (rows.rows() == 0) rows.fail(0, "header", "a row", "none");
  rows.visit(0, 1, [&](std::uint64_t, std::span<const std::byte> row) {
    shape.nodes = row_word<std::uint32_t>(row.data(), MAP_NODES);
    shape.blocks = row_word<std::uint32_t>(row.data(), MAP_BLOCKS);
  });
  // An odd number of nodes: the blocks behind them lie at whole cache lines.
  if (shape.nodes % 2 == 0 ||
      rows.rows() != 1 + shape.nodes + shape.blocks * (std::uint64_t{words} * RAY_BLOCK / PHOTON_WORDS))
    rows.fail(0, "nodes and blocks", "an odd number of nodes, and together " + std::to_string(rows.rows()) + " rows",
              std::to_string(shape.nodes) + " and " + std::to_string(shape.blocks));
  return shape;
}

// Children and blocks exist, and the walk through the nodes ends.
void check_nodes(const InputRows& rows, const Shape& shape) {
  rows.visit(1, shape.nodes, [&](std::uint64_t row, std::span<const std::byte> piece) {
    for (std::size_t at = 0; at < piece.size(); at += kRowBytes, ++row) {
      const std::uint64_t node = row - 1;
      const auto block = row_word<std::uint32_t>(&piece[at], NODE_BLOCK) & NODE_BLOCK_MASK;
      const auto skip = row_word<std::uint32_t>(&piece[at], NODE_SKIP);
      const bool leaf = block != NODE_NO_BLOCK;
      if (skip < node + (leaf ? 1 : 3) || skip > shape.nodes)
        rows.fail(row, "skip", "a node behind this one and its children, at most " + std::to_string(shape.nodes),
                  std::to_string(skip));
      if (leaf && block >= shape.blocks)
        rows.fail(row, "block", "below " + std::to_string(shape.blocks), std::to_string(block));
    }
  });
}

// There is a box for each of a cut's blocks, and for each group of boxes one of the level above.
void check_groups(const InputRows& rows, const Shape& shape) {
  std::uint64_t groups = 0, of_level = shape.blocks;
  for (unsigned level = 0; level < CUT_LEVELS && (level == 0 || of_level > 1); ++level) {
    of_level = (of_level + RAY_BLOCK - 1) / RAY_BLOCK;
    groups += of_level;
  }
  if (of_level != 1 || shape.nodes != 1 + groups * CUT_BOX_ROWS)
    rows.fail(0, "nodes", "1 to 16^6 blocks and " + std::to_string(groups) + " groups of boxes over them",
              std::to_string(shape.blocks) + " and " + std::to_string(shape.nodes));
}

// Of a block's members, whose words are `words`, `count` from `first` on are finite and not negative.
void check_blocks(const InputRows& rows, const Shape& shape, unsigned words, unsigned first, unsigned count,
                  const char* name) {
  const std::size_t begin = std::size_t{first} * RAY_BLOCK, end = begin + std::size_t{count} * RAY_BLOCK;
  const InputRows::Check check = [&, word = std::size_t{0}](std::uint64_t row,
                                                            std::span<const std::byte> piece) mutable {
    for (std::size_t at = 0; at < piece.size(); at += 4, ++word) {
      const std::size_t in_block = word % (std::size_t{words} * RAY_BLOCK);
      if (in_block < begin || in_block >= end) continue;
      const auto value = row_word<float>(&piece[at], 0);
      if (!(value >= 0) || !std::isfinite(value))
        rows.fail(row + at / kRowBytes, name, "a finite number, not negative", std::to_string(value));
    }
  };
  rows.visit(1 + shape.nodes, rows.rows() - 1 - shape.nodes, check);
}

PhotonMapTable make_table(const StageRun& run, const InputRows& rows) {
  const Shape shape = read_header(rows, PHOTON_WORDS);
  check_nodes(rows, shape);
  rows.visit(0, 1, [&](std::uint64_t, std::span<const std::byte> row) {
    const auto caustics = row_word<std::uint32_t>(row.data(), MAP_CAUSTICS);
    if (caustics > shape.nodes)
      rows.fail(0, "caustics", "a node, at most " + std::to_string(shape.nodes), std::to_string(caustics));
    const auto reach = row_word<float>(row.data(), MAP_REACH);
    if (!(reach > 0) || !std::isfinite(reach)) rows.fail(0, "reach", "a finite number above 0", std::to_string(reach));
  });
  check_blocks(rows, shape, PHOTON_WORDS, PHOTON_POWER, 3, "power");
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

PhotonCutTable make_cut(const StageRun& run) {
  const InputRows rows(run.task, "cut", kRowBytes);
  const Shape shape = read_header(rows, CUT_WORDS);
  check_groups(rows, shape);
  check_blocks(rows, shape, CUT_WORDS, CUT_NEARNESS, 4, "nearness and irradiance");
  check_blocks(rows, shape, CUT_WORDS, CUT_SPREAD, 1, "spread");
  cl::CommandQueue queue = run.device.make_queue();
  return {.rows = rows.to_device(run.device, queue, {}),
          .blocks = static_cast<std::uint32_t>(shape.blocks),
          .most_depth = 0,
          .size = rows.rows() * kRowBytes};
}

}  // namespace

void PhotonCutTable::set_arguments(Kernel& kernel) const {
  kernel.set("cut", rows).set("cut_blocks", blocks).set("cut_depth", most_depth);
}

PhotonCutTable photon_cut_table(const StageRun& run, std::uint32_t most_depth) {
  const auto found = run.task.inputs.find("cut");
  // Not touched where there is no cut.
  if (found == run.task.inputs.end())
    return {.rows = run.workspace.take("cut.none", 64), .blocks = 0, .most_depth = 0, .size = 0};
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

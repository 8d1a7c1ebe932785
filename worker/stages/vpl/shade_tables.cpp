#include "worker/stages/vpl/shade_tables.h"

#include <algorithm>
#include <limits>

#include "scene/model/error.h"
#include "worker/stages/cluster_grid.h"
#include "worker/stages/vpl/records.h"

namespace gleaner::worker {
namespace {

using kernels::VplPointParameters;

// The box about each 32 lights that shine, filled light by light.
class LightBoxes {
 public:
  explicit LightBoxes(std::size_t lights) : boxes_(std::max<std::size_t>(lights / 32, 1)) {}

  void add(std::uint64_t row, const std::byte* light) {
    float flux[3];
    std::memcpy(flux, light + VPL_FLUX * 4, sizeof flux);
    const float luminance = 0.2126f * flux[0] + 0.7152f * flux[1] + 0.0722f * flux[2];
    if (!(luminance > 0)) return;
    Box& box = boxes_[row / 32];
    box.brightest = std::max(box.brightest, luminance);
    for (unsigned k = 0; k < 3; ++k) {
      const auto x = row_word<float>(light, VPL_POSITION + k);
      box.lower[k] = std::min(box.lower[k], x);
      box.upper[k] = std::max(box.upper[k], x);
    }
  }

  std::vector<float> table() const {
    std::vector<float> out(boxes_.size() * LIGHT_BOX_WORDS);
    float* to = out.data();
    for (const Box& box : boxes_) {
      to[LIGHT_BOX_BRIGHTEST] = box.brightest;
      // Where nothing shines, the box may lie anywhere.
      for (unsigned k = 0; k < 3 && box.brightest > 0; ++k) {
        to[k] = 0.5f * (box.lower[k] + box.upper[k]);
        to[3 + k] = 0.5f * (box.upper[k] - box.lower[k]);
      }
      to += LIGHT_BOX_WORDS;
    }
    return out;
  }

 private:
  static constexpr float kInfinity = std::numeric_limits<float>::infinity();
  struct Box {
    float lower[3] = {kInfinity, kInfinity, kInfinity}, upper[3] = {-kInfinity, -kInfinity, -kInfinity}, brightest = 0;
  };
  std::vector<Box> boxes_;
};

template <typename T>
cl::Buffer put(const StageRun& run, cl::CommandQueue& queue, const std::vector<T>& values) {
  // Room for the last row's load of a whole line.
  cl::Buffer buffer = run.device.make_buffer(values.size() * sizeof(T) + 64);
  if (!values.empty()) queue.enqueueWriteBuffer(buffer, CL_TRUE, 0, values.size() * sizeof(T), values.data());
  return buffer;
}

// The lights and, behind them, the members of those that are clusters.
void put_lights(const StageRun& run, cl::CommandQueue& queue, std::uint32_t clusters, ShadeTables& tables) {
  const std::size_t stride = VPL_WORDS * 4;
  const InputRows lights(run.task, "lights", stride);
  if (lights.rows() < clusters || lights.rows() > RESIDUAL_LIGHT)
    throw Error::bad_input(run.where(), "input lights",
                           std::to_string(clusters) + " to " + std::to_string(RESIDUAL_LIGHT) + " rows",
                           std::to_string(lights.rows()));
  const std::uint64_t members = lights.rows() - clusters;
  tables.lights = run.device.make_buffer(lights.rows() * stride + 64);
  LightBoxes boxes(clusters);
  const auto known = check_light_rows(lights, run.scene);
  const auto linked = check_member_links(lights, clusters, members, false);
  lights.upload(queue, tables.lights, 0, 0, clusters, [&](std::uint64_t row, std::span<const std::byte> rows) {
    known(row, rows);
    linked(row, rows);
    for (std::size_t at = 0; at < rows.size(); at += stride) boxes.add(row++, &rows[at]);
  });
  const auto members_linked = check_member_links(lights, clusters, members, true);
  lights.upload(queue, tables.lights, clusters * stride, clusters, members,
                [&](std::uint64_t row, std::span<const std::byte> rows) {
                  known(row, rows);
                  members_linked(row, rows);
                });
  tables.boxes = put(run, queue, boxes.table());
}

// The point clusters' grid; empty where every point queries all lights.
ClusterGrid make_point_grid(const StageRun& run, std::uint32_t clusters) {
  if (clusters == 0) return make_cluster_grid({}, POINT_WORDS, {});
  const InputRows points(run.task, "points", POINT_WORDS * 4);
  points.expect_rows(clusters);
  std::vector<float> rows(std::size_t{clusters} * POINT_WORDS);
  std::vector<bool> used(clusters);
  const auto known = check_point_rows(points, run.scene);
  points.visit(0, clusters, [&](std::uint64_t row, std::span<const std::byte> piece) {
    known(row, piece);
    std::memcpy(&rows[row * POINT_WORDS], piece.data(), piece.size());
    for (std::size_t at = 0; at < piece.size(); at += POINT_WORDS * 4)
      used[row++] = row_word<std::uint32_t>(&piece[at], POINT_TRIANGLE) != GLEANER_NONE;
  });
  return make_cluster_grid(rows, POINT_WORDS, used);
}

}  // namespace

std::size_t ShadeTables::bytes() const {
  std::size_t sum = 0;
  for (const cl::Buffer* buffer : {&lights, &boxes, &grid, &cells, &seeds, &bits})
    sum += buffer->getInfo<CL_MEM_SIZE>();
  return sum;
}

ShadeTables make_shade_tables(const StageRun& run, const VplPointParameters& p) {
  ShadeTables tables;
  cl::CommandQueue queue = run.device.make_queue();
  tables.width = p.clusters / p.samples;
  put_lights(run, queue, p.clusters, tables);
  const ClusterGrid grid = make_point_grid(run, p.point_clusters);
  tables.grid = put(run, queue, grid.header);
  tables.cells = put(run, queue, grid.cells);
  tables.seeds = put(run, queue, grid.seeds);
  if (p.point_clusters) {
    tables.row_words = p.clusters / 32 + VISIBILITY_COUNTS;
    const InputRows bits(run.task, "visibility", std::size_t{tables.row_words} * 4);
    bits.expect_rows(p.point_clusters);
    tables.bits = bits.to_device(run.device, queue, {});
  } else {
    tables.bits = run.device.make_buffer(64);
  }
  return tables;
}

}  // namespace gleaner::worker

#include "worker/stages/vpl/visibility_queries.h"

#include <algorithm>

#include "kernels/path_layout.h"
#include "kernels/vpl_records.h"
#include "worker/stages/vpl/waves.h"

namespace gleaner::worker {

VisibilityAnswers::VisibilityAnswers(const Device& device, const Program& program, cl::CommandQueue& queue,
                                     RayQueries& queries, cl::Buffer rays)
    : device_(device),
      queue_(queue),
      queries_(queries),
      rays_(std::move(rays)),
      pack_(device, program, "visibility_pack") {
  pack_.set("rays", rays_);
}

void VisibilityAnswers::answer(const RayRange& range, std::uint32_t count, std::uint64_t first,
                               const cl::Buffer& bits) {
  queries_.any(rays_, range);
  pack_.set("words", (count + 31) / 32).set("first", static_cast<cl_uint>(first / 32)).set("bits", bits);
  pack_.launch(queue_, {.work = count, .capacity = ray_capacity(device_), .per_item = 32});
}

VisibilityQueries::VisibilityQueries(const StageRun& run, cl::CommandQueue& queue, RayQueries& queries, cl::Buffer rays,
                                     cl::Buffer counters, const cl::Buffer& lights, std::uint32_t width,
                                     std::uint32_t slices)
    : device_(run.device),
      queue_(queue),
      width_(width),
      counters_(std::move(counters)),
      make_rays_(run.device, run.build_plain("visibility.cl"), "vpl_visibility_rays"),
      answers_(run.device, run.build_plain("visibility.cl"), queue, queries, std::move(rays)) {
  make_rays_.set("triangles", run.scene.triangle_rows())
      .set("triangle_words", run.scene.triangle_words())
      .set("instances", run.scene.instance_rows())
      .set("instanced", static_cast<cl_uint>(run.scene.instances() > 0))
      .set("lights", lights)
      .set("width", width)
      .set("slices", slices)
      .set("rays", answers_.rays())
      .set("counters", counters_);
}

std::uint64_t VisibilityQueries::run(const Query& query) {
  queue_.enqueueFillBuffer(query.left_out, cl_uint{0}, 0, std::size_t{query.rows} * VISIBILITY_COUNTS * 4);
  queue_.enqueueFillBuffer(counters_, cl_uint{0}, 0, sizeof(cl_uint));
  make_rays_.set("points", query.points)
      .set("chosen", query.chosen ? *query.chosen : query.points)
      .set("listed", static_cast<cl_uint>(query.chosen != nullptr))
      .set("point_base", query.point_base)
      .set("left_out", query.left_out)
      .set("cutoff", query.cutoff)
      .set("clamp_to", query.clamp);
  const std::uint64_t all = std::uint64_t{query.rows} * width_;
  const std::uint32_t capacity = ray_capacity(device_);
  for (std::uint64_t base = 0; base < all; base += capacity) {
    const auto count = static_cast<std::uint32_t>(std::min<std::uint64_t>(capacity, all - base));
    make_rays_.set("ray_base", static_cast<cl_uint>(base)).set("count", count);
    make_rays_.launch(queue_, {.work = count, .capacity = capacity, .per_item = device_.lanes()});
    // Sixteen lights as one point sees them, always the same sixteen.
    answers_.answer(ray_packets(VISIBILITY_ROWS, count), count, base, query.bits);
  }
  cl_uint queried = 0;
  queue_.enqueueReadBuffer(counters_, CL_TRUE, 0, sizeof queried, &queried);
  return queried;
}

}  // namespace gleaner::worker

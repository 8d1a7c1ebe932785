#include <algorithm>
#include <chrono>
#include <span>
#include <string>

#include "kernels/scene_layout.h"
#include "scene/model/error.h"
#include "scene/model/limits.h"
#include "worker/device/clock.h"
#include "worker/device/kernel.h"
#include "worker/trace/opencl_top_level.h"

namespace gleaner::worker {
namespace {

// Entries of a traversal stack: one a level below the roots suffices; multiples of 16 keep the number of variants
// small. It becomes memory of each work-item, so that a blob must not choose it freely.
std::uint32_t stack_size(std::uint32_t depth) {
  constexpr std::uint32_t most = 2 * scene::kMaxBvhDepth;  // of a mesh's tree, below the top level
  if (depth > most)
    throw Error::bad_input("BVH", "max_depth", "at most " + std::to_string(most), std::to_string(depth));
  return (depth / 16 + 1) * 16;
}

class OpenClTracer final : public Tracer {
 public:
  OpenClTracer(const Device& device, const scene::Scene& scene, const scene::Bvh& bvh, const cl::Buffer& triangles,
               unsigned triangle_words)
      : device_(device),
        levels_(scene, bvh),
        triangles_(triangles),
        options_(
            std::string("-D LANES=1") + (triangle_words == TRIANGLE_WORDS_SECOND_UVS ? " -D NEED_SECOND_UVS" : "") +
            (levels_.has_two_levels() ? " -D TWO_LEVELS" : "") + (levels_.has_instances() ? " -D NEED_INSTANCES" : "")),
        nodes_(device.make_buffer(levels_.node_capacity() * sizeof(scene::BvhNode), CL_MEM_READ_ONLY)),
        slots_(device.make_buffer(levels_.slot_capacity() * sizeof(std::uint32_t), CL_MEM_READ_ONLY)),
        overflow_(device.make_buffer(sizeof(std::uint32_t))) {
    if (bvh.max_depth > scene::kMaxBvhDepth)
      throw Error::bad_input("BVH", "max_depth", "at most " + std::to_string(scene::kMaxBvhDepth),
                             std::to_string(bvh.max_depth));
    cl::CommandQueue queue = device.make_queue();
    write(queue, nodes_, 0, std::span(bvh.nodes));
    write(queue, slots_, 0, std::span(bvh.triangles));
    const std::uint32_t zero = 0;
    queue.enqueueWriteBuffer(overflow_, CL_TRUE, 0, sizeof zero, &zero);
    if (levels_.has_two_levels()) {
      top_ = device.make_buffer(levels_.top().size() * sizeof(scene::BvhNode), CL_MEM_READ_ONLY);
      entries_ = device.make_buffer(levels_.entries().size() * sizeof(std::uint32_t), CL_MEM_READ_ONLY);
      inverses_ =
          device.make_buffer(std::max<std::size_t>(levels_.inverses().size(), 16) * sizeof(float), CL_MEM_READ_ONLY);
    } else {
      // The kernels' variant reads none of them.
      top_ = nodes_, entries_ = slots_, inverses_ = nodes_;
    }
    load_top(queue);
  }

  MotionReport follow(const SceneMotion& motion) override {
    cl::CommandQueue queue = device_.make_queue();
    MotionReport report = levels_.follow(
        motion, [&](std::size_t first, std::span<const scene::BvhNode> nodes) { write(queue, nodes_, first, nodes); },
        [&](std::size_t first, std::span<const std::uint32_t> slots) { write(queue, slots_, first, slots); });
    const auto start = std::chrono::steady_clock::now();
    load_top(queue);
    report.top_level_seconds += seconds_since(start);
    return report;
  }

  void closest(cl::CommandQueue& queue, cl::Buffer& rays, const RayRange& range) override {
    run("trace_closest", queue, rays, range);
  }
  void any(cl::CommandQueue& queue, cl::Buffer& rays, const RayRange& range) override {
    run("trace_any", queue, rays, range);
  }

 private:
  template <typename T>
  static void write(cl::CommandQueue& queue, cl::Buffer& to, std::size_t first, std::span<const T> values) {
    if (!values.empty())
      queue.enqueueWriteBuffer(to, CL_TRUE, first * sizeof(T), values.size() * sizeof(T), values.data());
  }

  // The top level may become deeper than the kernels' stack was made for.
  void load_top(cl::CommandQueue& queue) {
    if (levels_.has_two_levels()) {
      write(queue, top_, 0, std::span(levels_.top()));
      write(queue, entries_, 0, std::span(levels_.entries()));
      write(queue, inverses_, 0, std::span(levels_.inverses()));
    }
    const std::uint32_t wanted = stack_size(levels_.depth());
    if (wanted <= stack_) return;
    program_ = device_.build("kernels/bvh_trace.cl", options_ + " -D STACK_SIZE=" + std::to_string(wanted));
    stack_ = wanted;
  }

  void run(const char* name, cl::CommandQueue& queue, cl::Buffer& rays, const RayRange& range) {
    if (range.end() == 0) return;
    Kernel kernel(device_, program_, name);
    kernel.set("nodes", nodes_)
        .set("slots", slots_)
        .set("triangles", triangles_)
        .set("top", top_)
        .set("entries", entries_)
        .set("inverses", inverses_)
        .set("rays", rays)
        .set("rows", range.rows)
        .set("count", range.end())
        .set("overflow", overflow_);
    kernel.launch(
        queue,
        {.work = range.end(), .capacity = rays.getInfo<CL_MEM_SIZE>() / (range.rows * sizeof(float)), .group = 64});
    std::uint32_t overflow = 0;
    queue.enqueueReadBuffer(overflow_, CL_TRUE, 0, sizeof overflow, &overflow);
    if (overflow) {
      // The next batch's rays have their own say.
      const std::uint32_t zero = 0;
      queue.enqueueWriteBuffer(overflow_, CL_TRUE, 0, sizeof zero, &zero);
      throw Error::failed("the traversal stack of the OpenCL tracer was too small for " + std::to_string(overflow) +
                          " rays");
    }
  }

  const Device& device_;
  OpenClTopLevel levels_;
  cl::Buffer triangles_;
  std::string options_;
  Program program_;
  std::uint32_t stack_ = 0;
  cl::Buffer nodes_, slots_, overflow_, top_, entries_, inverses_;
};

}  // namespace

std::unique_ptr<Tracer> make_opencl_tracer(const Device& device, const scene::Scene& scene, const scene::Bvh& bvh,
                                           const cl::Buffer& triangles, unsigned triangle_words) {
  return std::make_unique<OpenClTracer>(device, scene, bvh, triangles, triangle_words);
}

}  // namespace gleaner::worker

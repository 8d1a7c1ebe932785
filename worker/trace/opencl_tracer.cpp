#include <mutex>

#include "kernels/scene_layout.h"
#include "scene/model/error.h"
#include "scene/model/limits.h"
#include "worker/device/kernel.h"
#include "worker/trace/tracer.h"

namespace gleaner::worker {
namespace {

// Entries of a traversal stack: one a level below the root suffices; multiples of 16 keep the number of variants small.
// It becomes memory of each work-item, so that a blob must not choose it freely.
std::uint32_t stack_size(const scene::Bvh& bvh) {
  if (bvh.max_depth > scene::kMaxBvhDepth)
    throw Error::bad_input("BVH", "max_depth", "at most " + std::to_string(scene::kMaxBvhDepth),
                           std::to_string(bvh.max_depth));
  return (bvh.max_depth / 16 + 1) * 16;
}

class OpenClTracer final : public Tracer {
 public:
  OpenClTracer(const Device& device, const scene::Bvh& bvh, const cl::Buffer& triangles, unsigned triangle_words)
      : device_(device),
        triangles_(triangles),
        program_(device.build("kernels/bvh_trace.cl",
                              "-D LANES=1 -D STACK_SIZE=" + std::to_string(stack_size(bvh)) +
                                  (triangle_words == TRIANGLE_WORDS_SECOND_UVS ? " -D NEED_SECOND_UVS" : ""))),
        nodes_(device.make_buffer(bvh.nodes.size() * sizeof(scene::BvhNode), CL_MEM_READ_ONLY)),
        slots_(device.make_buffer(bvh.triangles.size() * sizeof(std::uint32_t), CL_MEM_READ_ONLY)),
        overflow_(device.make_buffer(sizeof(std::uint32_t))) {
    cl::CommandQueue queue = device.make_queue();
    queue.enqueueWriteBuffer(nodes_, CL_TRUE, 0, bvh.nodes.size() * sizeof(scene::BvhNode), bvh.nodes.data());
    if (!bvh.triangles.empty())
      queue.enqueueWriteBuffer(slots_, CL_TRUE, 0, bvh.triangles.size() * sizeof(std::uint32_t), bvh.triangles.data());
    const std::uint32_t zero = 0;
    queue.enqueueWriteBuffer(overflow_, CL_TRUE, 0, sizeof zero, &zero);
  }

  void closest(cl::CommandQueue& queue, cl::Buffer& rays, const RayRange& range) override {
    run("trace_closest", queue, rays, range);
  }
  void any(cl::CommandQueue& queue, cl::Buffer& rays, const RayRange& range) override {
    run("trace_any", queue, rays, range);
  }

 private:
  void run(const char* name, cl::CommandQueue& queue, cl::Buffer& rays, const RayRange& range) {
    if (range.end() == 0) return;
    Kernel kernel(device_, program_, name);
    kernel.set("nodes", nodes_)
        .set("slots", slots_)
        .set("triangles", triangles_)
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
  cl::Buffer triangles_;
  Program program_;
  cl::Buffer nodes_, slots_, overflow_;
};

}  // namespace

std::unique_ptr<Tracer> make_opencl_tracer(const Device& device, const scene::Bvh& bvh, const cl::Buffer& triangles,
                                           unsigned triangle_words) {
  return std::make_unique<OpenClTracer>(device, bvh, triangles, triangle_words);
}

}  // namespace gleaner::worker

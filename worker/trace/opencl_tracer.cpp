#include <mutex>

#include "scene/model/error.h"
#include "worker/trace/tracer.h"

namespace gleaner::worker {
namespace {

class OpenClTracer final : public Tracer {
 public:
  OpenClTracer(const Device& device, const scene::Bvh& bvh, const cl::Buffer& triangles)
      : cpu_(device.info().cpu),
        triangles_(triangles),
        // One entry a level below the root suffices; multiples of 16 keep the number of variants small.
        program_(device.build("kernels/bvh_trace.cl",
                              "-D LANES=1 -D STACK_SIZE=" + std::to_string((bvh.max_depth / 16 + 1) * 16))),
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
    // A kernel object of its own per call: arguments belong to the object, and lanes call at the same time.
    cl::Kernel kernel(program_, name);
    kernel.setArg(0, nodes_);
    kernel.setArg(1, slots_);
    kernel.setArg(2, triangles_);
    kernel.setArg(3, rays);
    kernel.setArg(4, range.rows);
    kernel.setArg(5, range.end());
    kernel.setArg(6, overflow_);
    constexpr std::size_t group = 64;
    // On CPU devices always a grid of the buffer's size: PoCL 3.1 loses count of a kernel's users where two threads
    // launch it with several sizes (pocl_release_dlhandle_cache aborts).
    std::size_t items = range.end();
    if (cpu_) items = rays.getInfo<CL_MEM_SIZE>() / (range.rows * sizeof(float));
    queue.enqueueNDRangeKernel(kernel, cl::NullRange, cl::NDRange((items + group - 1) / group * group),
                               cl::NDRange(group));
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

  bool cpu_;
  cl::Buffer triangles_;
  cl::Program program_;
  cl::Buffer nodes_, slots_, overflow_;
};

}  // namespace

std::unique_ptr<Tracer> make_opencl_tracer(const Device& device, const scene::Bvh& bvh, const cl::Buffer& triangles) {
  return std::make_unique<OpenClTracer>(device, bvh, triangles);
}

}  // namespace gleaner::worker

#pragma once
// The OpenCL tracer alone: rays that are the same on every machine, and what they hit.

#include "scene/model/blob.h"
#include "worker/device/device.h"

namespace gleaner::bench {

enum class RayKind { camera, scattered };  // neighbours through a camera's pixels; from surfaces into all directions

struct RayAnswer {
  std::uint32_t primitive = 0xffffffffu;  // nothing was hit
  float t = 0;
  std::uint32_t blocked = 0;  // by anything nearer than a tenth of the scene's size
};

// What `count` rays (a multiple of 16) meet, traced by `device`. Throws cl::Error, Error::failed.
std::vector<RayAnswer> trace_rays(const worker::Device& device, const scene::Scene& scene, const scene::Bvh& bvh,
                                  RayKind kind, std::uint32_t count);

struct RayRate {
  double closest = 0, any = 0;  // rays per second, kernels alone
};
RayRate time_rays(const worker::Device& device, const scene::Scene& scene, const scene::Bvh& bvh, RayKind kind,
                  std::uint32_t count, int rounds);

}  // namespace gleaner::bench

#include "bench/device/rays.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>

#include "kernels/rays.h"
#include "scene/model/order.h"
#include "worker/stages/device_scene.h"
#include "worker/wavefront/ray_queries.h"

namespace gleaner::bench {
namespace {

// Numbers by hashing, directions by rejection: nothing but +, -, *, / and square roots, which round alike everywhere.
class Random {
 public:
  double unit() { return scene::unit_hash(++state_); }
  void direction(float (&d)[3]) {
    double v[3], length;
    do {
      for (double& x : v) x = 2 * unit() - 1;
      length = v[0] * v[0] + v[1] * v[1] + v[2] * v[2];
    } while (!(length > 0.01 && length <= 1));
    length = std::sqrt(length);
    for (int k = 0; k < 3; ++k) d[k] = static_cast<float>(v[k] / length);
  }

 private:
  std::uint64_t state_ = 0x9e3779b97f4a7c15ull;
};

struct Ray {
  float origin[3], direction[3];
  std::uint32_t source = GLEANER_NONE;
};

Ray camera_ray(const scene::Camera& c, std::uint32_t index, std::uint32_t side) {
  const double x = (2.0 * (index % side + 0.5) / side - 1) * c.half_width;
  const double y = (1 - 2.0 * (index / side + 0.5) / side) * c.half_height;
  Ray ray;
  double d[3], length = 0;
  for (int k = 0; k < 3; ++k) {
    d[k] = c.forward[k] + x * c.right[k] + y * c.up[k];
    length += d[k] * d[k];
  }
  for (int k = 0; k < 3; ++k) {
    ray.origin[k] = c.origin[k];
    ray.direction[k] = static_cast<float>(d[k] / std::sqrt(length));
  }
  return ray;
}

Ray scattered_ray(const scene::Scene& scene, Random& random) {
  Ray ray;
  const auto triangle = static_cast<std::uint32_t>(random.unit() * static_cast<double>(scene.triangle_count()));
  ray.source = std::min<std::uint32_t>(triangle, static_cast<std::uint32_t>(scene.triangle_count()) - 1);
  double u = random.unit(), v = random.unit();
  if (u + v > 1) {
    u = 1 - u;
    v = 1 - v;
  }
  for (int k = 0; k < 3; ++k) {
    const auto corner = [&](std::size_t c) {
      return double{scene.positions[3 * std::size_t{scene.indices[3 * std::size_t{ray.source} + c]} +
                                    static_cast<std::size_t>(k)]};
    };
    ray.origin[k] = static_cast<float>(corner(0) * (1 - u - v) + corner(1) * u + corner(2) * v);
  }
  random.direction(ray.direction);
  return ray;
}

float scene_size(const scene::Scene& scene) {
  float size = 0;
  for (std::size_t k = 0; k < 3; ++k) {
    float lower = std::numeric_limits<float>::infinity(), upper = -lower;
    for (std::size_t i = k; i < scene.positions.size(); i += 3) {
      lower = std::min(lower, scene.positions[i]);
      upper = std::max(upper, scene.positions[i]);
    }
    size = std::max(size, upper - lower);
  }
  return size;
}

// Blocks of 16 rays as kernels lay them out.
std::vector<float> make_blocks(const scene::Scene& scene, RayKind kind, std::uint32_t count, float far) {
  Random random;
  auto side = static_cast<std::uint32_t>(std::sqrt(static_cast<double>(count)));
  std::vector<float> blocks(std::size_t{count} * RAY_HIT_ROWS, 0.0f);
  for (std::uint32_t i = 0; i < count; ++i) {
    const Ray ray = kind == RayKind::camera ? camera_ray(scene.cameras.front().camera, i % (side * side), side)
                                            : scattered_ray(scene, random);
    float* at = &blocks[std::size_t{i / RAY_BLOCK} * RAY_BLOCK * RAY_HIT_ROWS + i % RAY_BLOCK];
    const auto word = [at](unsigned row, std::uint32_t w) { std::memcpy(at + RAY_BLOCK * row, &w, 4); };
    for (unsigned k = 0; k < 3; ++k) {
      at[RAY_BLOCK * (ROW_ORIGIN + k)] = ray.origin[k];
      at[RAY_BLOCK * (ROW_DIRECTION + k)] = ray.direction[k];
    }
    at[RAY_BLOCK * ROW_FAR] = far;
    word(ROW_MASK, 0xffffffffu);
    word(ROW_SOURCE, ray.source);
    word(ROW_GEOMETRY, GLEANER_NONE);
  }
  return blocks;
}

// A scene's tracer and a buffer of rays.
class RayBench {
 public:
  RayBench(const worker::Device& device, const scene::Scene& scene, const scene::Bvh& bvh, std::uint32_t count)
      : held_(device, std::make_shared<scene::Scene>(scene), &bvh),
        queue_(device.make_queue()),
        buffer_(device.make_buffer(std::size_t{count} * RAY_HIT_ROWS * 4)),
        range_(worker::single_rays(RAY_HIT_ROWS, count)) {}

  void write(const std::vector<float>& blocks) {
    queue_.enqueueWriteBuffer(buffer_, CL_TRUE, 0, blocks.size() * 4, blocks.data());
  }
  void read(std::vector<float>& blocks) {
    queue_.enqueueReadBuffer(buffer_, CL_TRUE, 0, blocks.size() * 4, blocks.data());
  }
  void closest() { held_.tracer().closest(queue_, buffer_, range_); }
  void any() { held_.tracer().any(queue_, buffer_, range_); }

 private:
  worker::DeviceScene held_;
  cl::CommandQueue queue_;
  cl::Buffer buffer_;
  worker::RayRange range_;
};

}  // namespace

std::vector<RayAnswer> trace_rays(const worker::Device& device, const scene::Scene& scene, const scene::Bvh& bvh,
                                  RayKind kind, std::uint32_t count) {
  RayBench bench(device, scene, bvh, count);
  std::vector<RayAnswer> answers(count);
  std::vector<float> blocks = make_blocks(scene, kind, count, std::numeric_limits<float>::infinity());
  const auto at = [&](std::uint32_t i, unsigned row) -> const float& {
    return blocks[std::size_t{i / RAY_BLOCK} * RAY_BLOCK * RAY_HIT_ROWS + RAY_BLOCK * row + i % RAY_BLOCK];
  };
  bench.write(blocks);
  bench.closest();
  bench.read(blocks);
  for (std::uint32_t i = 0; i < count; ++i) {
    std::uint32_t geometry;
    std::memcpy(&geometry, &at(i, ROW_GEOMETRY), 4);
    if (geometry == GLEANER_NONE) continue;
    std::memcpy(&answers[i].primitive, &at(i, ROW_PRIMITIVE), 4);
    answers[i].t = at(i, ROW_FAR);
  }
  blocks = make_blocks(scene, kind, count, 0.1f * scene_size(scene));
  bench.write(blocks);
  bench.any();
  bench.read(blocks);
  for (std::uint32_t i = 0; i < count; ++i) answers[i].blocked = at(i, ROW_FAR) < 0;
  return answers;
}

RayRate time_rays(const worker::Device& device, const scene::Scene& scene, const scene::Bvh& bvh, RayKind kind,
                  std::uint32_t count, int rounds) {
  device.profile().turn_on();
  RayBench bench(device, scene, bvh, count);
  const std::vector<float> far = make_blocks(scene, kind, count, std::numeric_limits<float>::infinity());
  const std::vector<float> near = make_blocks(scene, kind, count, 0.1f * scene_size(scene));
  for (int round = -1; round < rounds; ++round) {
    if (round == 0) device.profile().take();  // the first warms the device
    bench.write(far);
    bench.closest();
    bench.write(near);
    bench.any();
  }
  RayRate rate;
  for (const auto& [kernel, time] : device.profile().take())
    (kernel == "trace_closest" ? rate.closest : rate.any) = static_cast<double>(time.work) / time.seconds;
  return rate;
}

}  // namespace gleaner::bench

#pragma once
// Rays against a scene through the worker's own tracers, in buffers laid out as kernels lay them out.

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cstdint>
#include <cstring>
#include <limits>
#include <memory>
#include <string>
#include <vector>

#include "kernels/rays.h"
#include "scene/bvh/build.h"
#include "scene/model/scene.h"
#include "worker/device/device.h"
#include "worker/stages/device_scene.h"

namespace gleaner::test {

inline constexpr float kInfinity = std::numeric_limits<float>::infinity();

struct Ray {
  std::array<float, 3> origin{}, direction{};
  float far = kInfinity;
  std::uint32_t source = GLEANER_NONE;
  std::uint32_t source_instance = 0;  // in scenes with instances; GLEANER_NONE: of none
};

struct Hit {
  std::uint32_t primitive = GLEANER_NONE;
  float t = kInfinity, u = 0, v = 0;
  std::uint32_t instance = GLEANER_NONE;  // in scenes with instances
  bool found() const { return primitive != GLEANER_NONE; }
};

// How Embree is asked: each ray for itself, or 16 together.
enum class Packing { single, packets };

// A device that traces with `kind`, in one thread: a CPU for Embree, the default device for the OpenCL tracer. Null
// where there is none.
inline std::unique_ptr<worker::Device> open_device(worker::TraceKind kind) {
  worker::DeviceChoice choice{.device = -1, .threads = 1, .trace = kind};
  const auto devices = worker::list_devices();
  if (devices.empty()) return nullptr;
  if (kind == worker::TraceKind::embree) {
    const auto cpu = std::find_if(devices.begin(), devices.end(),
                                  [&](const worker::DeviceInfo& info) { return info.trace == kind; });
    if (cpu == devices.end()) return nullptr;
    choice.device = cpu->index;
  }
  return std::make_unique<worker::Device>(choice);
}

// A test that runs with Embree and with the OpenCL tracer.
class WithTracer : public testing::TestWithParam<worker::TraceKind> {
 protected:
  void SetUp() override {
    device_ = open_device(GetParam());
    if (!device_)
      GTEST_SKIP() << "NOT TESTED: no OpenCL device here traces with " << worker::trace_kind_name(GetParam());
  }
  bool embree() const { return GetParam() == worker::TraceKind::embree; }

  std::unique_ptr<worker::Device> device_;
};

inline auto both_tracers() { return testing::Values(worker::TraceKind::embree, worker::TraceKind::opencl); }
inline std::string tracer_name(const testing::TestParamInfo<worker::TraceKind>& kind) {
  return worker::trace_kind_name(kind.param);
}

class TracedScene {
 public:
  // Without `bvh`, one is built where the device needs it. Throws what the device library throws.
  TracedScene(const worker::Device& device, const scene::Scene& scene, const scene::Bvh* bvh = nullptr)
      : queue_(device.make_queue()), rays_(device.make_buffer(kBytes)) {
    scene::Bvh built;
    if (!bvh && device.info().trace == worker::TraceKind::opencl) bvh = &(built = scene::build_bvh(scene));
    on_device_ = std::make_unique<worker::DeviceScene>(device, std::make_shared<scene::Scene>(scene), bvh);
  }

  // Closest hits of `count` rays: make(i) gives the i-th, seen(i, ray, hit) gets it with its answer.
  template <typename Make, typename Seen>
  void closest(std::size_t count, Make&& make, Seen&& seen, Packing packing = Packing::single) {
    in_batches(count, make, packing, false, [&](std::size_t i, const Ray& ray, const float* at) {
      Hit hit;
      if (word(at, ROW_GEOMETRY) != GLEANER_NONE)
        hit = {word(at, ROW_PRIMITIVE), at[RAY_BLOCK * ROW_FAR], at[RAY_BLOCK * ROW_U], at[RAY_BLOCK * ROW_V],
               word(at, ROW_INSTANCE)};
      seen(i, ray, hit);
    });
  }

  // Whether anything lies in the rays' way: seen(i, ray, blocked).
  template <typename Make, typename Seen>
  void any(std::size_t count, Make&& make, Seen&& seen, Packing packing = Packing::single) {
    in_batches(count, make, packing, true, [&](std::size_t i, const Ray& ray, const float* at) {
      seen(i, ray, at[RAY_BLOCK * ROW_FAR] == -kInfinity);
    });
  }

  worker::Tracer& tracer() { return on_device_->tracer(); }
  worker::DeviceScene& on_device() { return *on_device_; }

 private:
  static constexpr std::size_t kBatch = std::size_t{1} << 15;
  static constexpr std::size_t kBytes = 4 * kBatch * RAY_HIT_ROWS;

  static std::uint32_t word(const float* at, unsigned row) {
    std::uint32_t w;
    std::memcpy(&w, at + RAY_BLOCK * row, sizeof w);
    return w;
  }
  static void set_word(float* at, unsigned row, std::uint32_t w) { std::memcpy(at + RAY_BLOCK * row, &w, sizeof w); }
  static float* address(float* rays, std::size_t i) {
    return rays + i / RAY_BLOCK * (RAY_BLOCK * RAY_HIT_ROWS) + i % RAY_BLOCK;
  }

  template <typename Work>
  void mapped(cl_map_flags flags, Work&& work) {
    auto* rays = static_cast<float*>(queue_.enqueueMapBuffer(rays_, CL_TRUE, flags, 0, kBytes));
    work(rays);
    queue_.enqueueUnmapMemObject(rays_, rays);
    queue_.finish();
  }

  template <typename Make, typename Answer>
  void in_batches(std::size_t count, Make& make, Packing packing, bool any, Answer&& answer) {
    std::vector<Ray> made;
    for (std::size_t first = 0; first < count; first += kBatch) {
      const std::size_t size = std::min(kBatch, count - first);
      made.clear();
      for (std::size_t i = 0; i < size; ++i) made.push_back(make(first + i));
      mapped(CL_MAP_WRITE, [&](float* rays) {
        for (std::size_t i = 0; i < size; ++i) {
          float* at = address(rays, i);
          for (unsigned k = 0; k < 3; ++k) {
            at[RAY_BLOCK * (ROW_ORIGIN + k)] = made[i].origin[k];
            at[RAY_BLOCK * (ROW_DIRECTION + k)] = made[i].direction[k];
          }
          at[RAY_BLOCK * ROW_NEAR] = at[RAY_BLOCK * ROW_TIME] = 0;
          at[RAY_BLOCK * ROW_FAR] = made[i].far;
          set_word(at, ROW_MASK, 0xffffffffu);
          set_word(at, ROW_SOURCE, made[i].source);
          set_word(at, ROW_FLAGS, made[i].source_instance);
          set_word(at, ROW_GEOMETRY, GLEANER_NONE);
        }
      });
      worker::RayRange range;
      range.rows = RAY_HIT_ROWS;
      (packing == Packing::single ? range.incoherent : range.coherent_count) = static_cast<std::uint32_t>(size);
      if (any)
        tracer().any(queue_, rays_, range);
      else
        tracer().closest(queue_, rays_, range);
      mapped(CL_MAP_READ, [&](float* rays) {
        for (std::size_t i = 0; i < size; ++i) answer(first + i, made[i], address(rays, i));
      });
    }
  }

  cl::CommandQueue queue_;
  cl::Buffer rays_;
  std::unique_ptr<worker::DeviceScene> on_device_;
};

}  // namespace gleaner::test

// Rays per second of the Embree tracer on buffers of the kernels' layout, against a bare Embree loop over the same rays
// in the same blocks and one thread: scattered rays from random points of a scene, interleaved, median of the rounds.
//
//   build/bench/bench_trace SCENE [ROUNDS]

#include <embree3/rtcore.h>
#include <pmmintrin.h>
#include <xmmintrin.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <limits>
#include <numbers>
#include <random>
#include <vector>

#include "kernels/path_layout.h"
#include "scene/import/import.h"
#include "worker/trace/tracer.h"

namespace {

constexpr std::uint32_t kRays = 1u << 18, kWave = 1u << 12;

double now() { return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count(); }

double median(std::vector<double> values) {
  std::ranges::sort(values);
  return values[values.size() / 2];
}

// Rays from uniform points of the surfaces into all directions, in blocks of `rows` rows.
std::vector<float> scattered_rays(const gleaner::scene::Scene& scene, unsigned rows) {
  std::mt19937 random(1);
  std::uniform_real_distribution<float> unit(0, 1);
  std::vector<double> areas;
  double sum = 0;
  const auto corner = [&](std::size_t t, int k) { return &scene.positions[3 * std::size_t{scene.indices[3 * t + k]}]; };
  for (std::size_t t = 0; t < scene.triangle_count(); ++t) {
    const float *a = corner(t, 0), *b = corner(t, 1), *c = corner(t, 2);
    const double u[3] = {b[0] - a[0], b[1] - a[1], b[2] - a[2]}, v[3] = {c[0] - a[0], c[1] - a[1], c[2] - a[2]};
    sum += std::hypot(u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]);
    areas.push_back(sum);
  }
  std::vector<float> rays(std::size_t{kRays} * rows, 0.0f);
  for (std::uint32_t i = 0; i < kRays; ++i) {
    const auto t = static_cast<std::size_t>(std::ranges::lower_bound(areas, unit(random) * sum) - areas.begin());
    const std::size_t triangle = std::min(t, scene.triangle_count() - 1);
    const float s = std::sqrt(unit(random)), w = unit(random), z = 2 * unit(random) - 1;
    const float phi = 2 * std::numbers::pi_v<float> * unit(random), r = std::sqrt(1 - z * z);
    const float direction[3] = {r * std::cos(phi), r * std::sin(phi), z};
    float* block = &rays[std::size_t{i / 16} * 16 * rows];
    const auto set = [&](unsigned row, float value) { block[16 * row + i % 16] = value; };
    const auto set_word = [&](unsigned row, std::uint32_t value) { std::memcpy(&block[16 * row + i % 16], &value, 4); };
    for (unsigned k = 0; k < 3; ++k) {
      const float p =
          corner(triangle, 0)[k] * (1 - s) + corner(triangle, 1)[k] * s * (1 - w) + corner(triangle, 2)[k] * s * w;
      set(ROW_ORIGIN + k, p + 1e-4f * direction[k]);
      set(ROW_DIRECTION + k, direction[k]);
    }
    set(ROW_FAR, std::numeric_limits<float>::infinity());
    set_word(ROW_MASK, 0xffffffffu);
    set_word(ROW_SOURCE, 0xffffffffu);
    if (rows > RAY_ROWS) set_word(ROW_GEOMETRY, 0xffffffffu);
  }
  return rays;
}

}  // namespace

int main(int argc, char** argv) try {
  if (argc < 2) {
    std::fprintf(stderr, "usage: bench_trace SCENE [ROUNDS]\n");
    return 2;
  }
  const int rounds = argc > 2 ? std::atoi(argv[2]) : 9;
  const gleaner::scene::Scene scene = gleaner::scene::import_scene(argv[1]);
  gleaner::worker::Device device({.threads = 1, .trace = gleaner::worker::TraceKind::embree});
  auto tracer = gleaner::worker::make_embree_tracer(scene, 1);

  RTCDevice embree = rtcNewDevice("threads=1");
  RTCScene bare = rtcNewScene(embree);
  rtcSetSceneFlags(bare, RTC_SCENE_FLAG_ROBUST);
  RTCGeometry geometry = rtcNewGeometry(embree, RTC_GEOMETRY_TYPE_TRIANGLE);
  std::memcpy(rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3, 12, scene.vertex_count()),
              scene.positions.data(), 4 * scene.positions.size());
  std::memcpy(rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3, 12, scene.triangle_count()),
              scene.indices.data(), 4 * scene.indices.size());
  rtcCommitGeometry(geometry);
  rtcAttachGeometry(bare, geometry);
  rtcCommitScene(bare);

  const std::vector<float> rays = scattered_rays(scene, PATH_ROWS), shadows = scattered_rays(scene, SHADOW_ROWS);
  cl::CommandQueue queue = device.make_queue();
  std::vector<double> ours_closest, ours_any, bare_closest, bare_any;
  _MM_SET_FLUSH_ZERO_MODE(_MM_FLUSH_ZERO_ON);
  _MM_SET_DENORMALS_ZERO_MODE(_MM_DENORMALS_ZERO_ON);
  alignas(64) int all[16];
  std::ranges::fill(all, -1);
  for (int round = 0; round < rounds; ++round) {
    for (const bool closest : {true, false}) {
      const unsigned rows = closest ? PATH_ROWS : SHADOW_ROWS;
      const std::vector<float>& source = closest ? rays : shadows;
      cl::Buffer buffer = device.make_buffer(std::size_t{kWave} * rows * 4);
      double seconds = 0;
      for (std::uint32_t first = 0; first < kRays; first += kWave) {
        queue.enqueueWriteBuffer(buffer, CL_TRUE, 0, std::size_t{kWave} * rows * 4, &source[std::size_t{first} * rows]);
        const double start = now();
        const gleaner::worker::RayRange range{rows, kWave, kWave, 0};
        closest ? tracer->closest(queue, buffer, range) : tracer->any(queue, buffer, range);
        seconds += now() - start;
      }
      (closest ? ours_closest : ours_any).push_back(seconds);

      auto* blocks = static_cast<float*>(std::aligned_alloc(64, std::size_t{kWave} * rows * 4));
      seconds = 0;
      for (std::uint32_t first = 0; first < kRays; first += kWave) {
        std::memcpy(blocks, &source[std::size_t{first} * rows], std::size_t{kWave} * rows * 4);
        const double start = now();
        RTCIntersectContext context;
        rtcInitIntersectContext(&context);
        context.flags = RTC_INTERSECT_CONTEXT_FLAG_INCOHERENT;
        for (std::uint32_t block = 0; block < kWave / 16; ++block) {
          float* at = blocks + std::size_t{block} * 16 * rows;
          if (closest)
            rtcIntersect16(all, bare, &context, reinterpret_cast<RTCRayHit16*>(at));
          else
            rtcOccluded16(all, bare, &context, reinterpret_cast<RTCRay16*>(at));
        }
        seconds += now() - start;
      }
      (closest ? bare_closest : bare_any).push_back(seconds);
      std::free(blocks);
    }
  }
  const auto line = [&](const char* name, const std::vector<double>& ours, const std::vector<double>& theirs) {
    std::vector<double> ratios;
    for (std::size_t k = 0; k < ours.size(); ++k) ratios.push_back(theirs[k] / ours[k]);
    std::printf("%-12s tracer %6.2f Mrays/s  bare Embree %6.2f Mrays/s  ratio %.3f (median of %zu)\n", name,
                kRays / median(ours) / 1e6, kRays / median(theirs) / 1e6, median(ratios), ours.size());
  };
  std::printf("%s: %zu triangles, %u scattered rays, one thread\n", argv[1], scene.triangle_count(), kRays);
  line("closest hit", ours_closest, bare_closest);
  line("any hit", ours_any, bare_any);
  rtcReleaseGeometry(geometry);
  rtcReleaseScene(bare);
  rtcReleaseDevice(embree);
} catch (const std::exception& error) {
  std::fprintf(stderr, "bench_trace: %s\n", error.what());
  return 1;
}

// What instances and following motion cost, as ratios within one run, on one thread:
//
//   memory       a mesh of 10,000 triangles in 2,000 places against one copy each (measured with fewer copies, scaled)
//   trace speed  rays a second in as many instances as copies
//   refit        a mesh of 100,000 triangles that deforms, in a scene of 500,000, against building the scene
//   top level    a rigid object of 100,000 triangles that moves, against the same
//
//   build/bench/bench_instances [COPIES] [ROUNDS] [embree|opencl]

#include <malloc.h>
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <limits>
#include <memory>
#include <random>
#include <string>
#include <vector>

#include "kernels/rays.h"
#include "scene/bvh/build.h"
#include "scene/library/bake.h"
#include "scene/library/builder.h"
#include "scene/library/library.h"
#include "scene/model/instances.h"
#include "worker/stages/device_scene.h"

namespace {

using gleaner::scene::Scene;
using gleaner::scene::Vec;
using gleaner::worker::Device;
using gleaner::worker::DeviceScene;

constexpr std::uint32_t kPlaces = 2000, kRays = 1u << 15;

double now() { return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count(); }

double median(std::vector<double> values) {
  std::ranges::sort(values);
  return values[values.size() / 2];
}

double resident_bytes() {
  malloc_trim(0);
  long pages = 0, resident = 0;
  if (std::FILE* file = std::fopen("/proc/self/statm", "r")) {
    if (std::fscanf(file, "%ld %ld", &pages, &resident) != 2) resident = 0;
    std::fclose(file);
  }
  return static_cast<double>(resident) * static_cast<double>(sysconf(_SC_PAGESIZE));
}

std::unique_ptr<DeviceScene> loaded(const Device& device, const std::shared_ptr<const Scene>& scene) {
  gleaner::scene::Bvh bvh;
  const bool opencl = device.info().trace == gleaner::worker::TraceKind::opencl;
  if (opencl) bvh = gleaner::scene::build_bvh(*scene);
  return std::make_unique<DeviceScene>(device, scene, opencl ? &bvh : nullptr);
}

std::shared_ptr<const Scene> stack(std::uint32_t count, bool copies) {
  Scene scene = gleaner::scene::make_scene("stack", {{"count", std::to_string(count)}, {"segments", "100"}});
  return std::make_shared<const Scene>(copies ? gleaner::scene::baked(scene) : std::move(scene));
}

// The scene's arrays, the device's tables and the tracer.
double bytes_of(const Device& device, std::uint32_t count, bool copies) {
  const double before = resident_bytes();
  const auto scene = stack(count, copies);
  const auto held = loaded(device, scene);
  return resident_bytes() - before;
}

// Seconds for kRays rays between random points of the scene's box, each for itself.
double trace_seconds(const Device& device, DeviceScene& scene, const gleaner::scene::Bounds& box) {
  std::mt19937 random(1);
  std::uniform_real_distribution<float> unit(0, 1);
  std::vector<float> rays(std::size_t{kRays} * RAY_HIT_ROWS, 0.0f);
  for (std::uint32_t i = 0; i < kRays; ++i) {
    float* at = &rays[std::size_t{i / 16} * 16 * RAY_HIT_ROWS + i % 16];
    for (unsigned k = 0; k < 3; ++k) {
      const float from = std::lerp(box.lower[k], box.upper[k], unit(random));
      at[16 * (ROW_ORIGIN + k)] = from;
      at[16 * (ROW_DIRECTION + k)] = std::lerp(box.lower[k], box.upper[k], unit(random)) - from;
    }
    at[16 * ROW_FAR] = std::numeric_limits<float>::infinity();
    const std::uint32_t none = GLEANER_NONE;
    for (const unsigned row : {ROW_MASK, ROW_SOURCE, ROW_GEOMETRY}) std::memcpy(at + 16 * row, &none, 4);
  }
  cl::CommandQueue queue = device.make_queue();
  cl::Buffer buffer = device.make_buffer(rays.size() * 4);
  queue.enqueueWriteBuffer(buffer, CL_TRUE, 0, rays.size() * 4, rays.data());
  gleaner::worker::RayRange range;
  range.rows = RAY_HIT_ROWS;
  range.incoherent = kRays;
  const double start = now();
  scene.tracer().closest(queue, buffer, range);
  return now() - start;
}

// A hall of 400,000 triangles and a sheet of 100,000, which deforms, or is an instance.
Scene with_sheet(bool deforming) {
  Scene scene = gleaner::scene::make_scene("hall", {{"triangles", "400000"}});
  gleaner::scene::SceneBuilder b("sheet");
  b.mesh("sheet");
  b.grid(224, 224,
         [](std::uint32_t i, std::uint32_t j) {
           return Vec{0.02 * i - 2, 2, 0.02 * j - 2};
         },
         b.material("cloth", gleaner::scene::lambert(gleaner::scene::grey(0.5))), {.smooth = true});
  const Scene sheet = b.finish();
  const auto vertices = static_cast<std::uint32_t>(scene.vertex_count());
  gleaner::scene::Mesh mesh{"sheet", static_cast<std::uint32_t>(scene.triangle_count()),
                            static_cast<std::uint32_t>(sheet.triangle_count())};
  mesh.deforming = deforming;
  mesh.instanced = !deforming;
  scene.meshes.push_back(mesh);
  scene.positions.insert(scene.positions.end(), sheet.positions.begin(), sheet.positions.end());
  scene.normals.insert(scene.normals.end(), sheet.normals.begin(), sheet.normals.end());
  for (const std::uint32_t corner : sheet.indices) scene.indices.push_back(vertices + corner);
  scene.triangle_material.insert(scene.triangle_material.end(), sheet.triangle_count(), 0);
  if (!deforming) {
    gleaner::scene::Instance instance{};
    instance.transform[0] = instance.transform[5] = instance.transform[10] = 1;
    instance.mesh = static_cast<std::uint32_t>(scene.meshes.size() - 1);
    scene.instances.push_back(instance);
  }
  validate(scene, "bench");
  return scene;
}

void measure_motion(const Device& device, int rounds) {
  std::vector<double> build, refit, top, growth;
  Scene plain = with_sheet(true);
  const gleaner::scene::Mesh sheet = plain.meshes.back();
  plain.meshes.back().deforming = false;
  const auto still = std::make_shared<const Scene>(plain);
  for (int round = 0; round < rounds; ++round) {
    const double start = now();
    if (device.info().trace == gleaner::worker::TraceKind::opencl)
      gleaner::scene::build_bvh(*still);
    else
      gleaner::worker::make_embree_tracer(*still, 1);
    build.push_back(now() - start);
  }
  const auto deforming = std::make_shared<const Scene>(with_sheet(true));
  const auto held = loaded(device, deforming);
  const std::vector<std::uint32_t> moved{static_cast<std::uint32_t>(deforming->meshes.size() - 1)};
  Scene shown = *deforming;
  std::size_t rebuilt = 0;
  for (int round = 0; round < rounds; ++round) {
    for (std::size_t i = 3 * std::size_t{sheet.first_triangle}; i < shown.indices.size(); ++i) {
      float* p = &shown.positions[3 * std::size_t{shown.indices[i]}];
      p[1] = 2 + 0.05f * std::sin(3 * p[0] + static_cast<float>(round)) * std::cos(2 * p[2]);
    }
    const auto report = held->show(std::make_shared<const Scene>(shown), moved);
    refit.push_back(report.meshes[0].seconds + report.top_level_seconds);
    growth.push_back(report.meshes[0].growth);
    rebuilt += report.meshes[0].rebuilt;
  }
  const auto rigid = std::make_shared<const Scene>(with_sheet(false));
  const auto of_rigid = loaded(device, rigid);
  shown = *rigid;
  for (int round = 0; round < rounds; ++round) {
    shown.instances[0].transform[3] = 0.01f * static_cast<float>(round + 1);
    top.push_back(of_rigid->show(std::make_shared<const Scene>(shown), {}).top_level_seconds);
  }
  std::printf("build of the scene of %zu triangles   %8.2f ms\n", still->triangle_count(), 1e3 * median(build));
  std::printf(
      "refit of %u of them                %8.2f ms, %.3f of the build (SAH cost times %.2f, %zu of %d rebuilt)\n",
      sheet.triangle_count, 1e3 * median(refit), median(refit) / median(build), median(growth), rebuilt, rounds);
  std::printf("top level for a rigid object of as many %6.3f ms, %.5f of the build\n", 1e3 * median(top),
              median(top) / median(build));
}

}  // namespace

int main(int argc, char** argv) try {
  const auto copies = static_cast<std::uint32_t>(argc > 1 ? std::atoi(argv[1]) : 200);
  const int rounds = argc > 2 ? std::atoi(argv[2]) : 7;
  const bool opencl = argc > 3 && std::string(argv[3]) == "opencl";
  if (copies < 1 || rounds < 1) {
    std::fprintf(stderr, "usage: bench_instances [COPIES] [ROUNDS] [embree|opencl]\n");
    return 2;
  }
  const Device device(
      {.threads = 1, .trace = opencl ? gleaner::worker::TraceKind::opencl : gleaner::worker::TraceKind::embree});
  bytes_of(device, 1, false);  // what is loaded once
  const double few = bytes_of(device, copies, true) / copies, instanced = bytes_of(device, kPlaces, false);
  std::printf("10,000 triangles in %u places: %.1f MB as instances, %.0f MB as copies (scaled from %u), 1/%.0f\n",
              kPlaces, instanced / 1e6, few * kPlaces / 1e6, copies, few * kPlaces / instanced);
  const auto instances = stack(copies, false), plain = stack(copies, true);
  const gleaner::scene::Bounds box = bounds_of(*plain);
  const auto a = loaded(device, instances), b = loaded(device, plain);
  std::vector<double> fast, slow, ratios;
  for (int round = 0; round < rounds; ++round) {
    slow.push_back(trace_seconds(device, *b, box));
    fast.push_back(trace_seconds(device, *a, box));
    ratios.push_back(slow.back() / fast.back());
  }
  std::printf("%u places: %.2f Mrays/s in instances, %.2f in copies, %.2f times\n", copies, kRays / median(fast) / 1e6,
              kRays / median(slow) / 1e6, median(ratios));
  measure_motion(device, rounds);
} catch (const std::exception& error) {
  std::fprintf(stderr, "bench_instances: %s\n", error.what());
  return 1;
}

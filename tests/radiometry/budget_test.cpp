// What a batch asks of its device is counted, and is what the scene makes necessary: rays, kernel launches, bytes
// moved, and the features that its kernels are compiled with.

#include <dlfcn.h>

#include <atomic>
#include <cstdio>
#include <set>
#include <sstream>

#include "scene/library/builder.h"
#include "scene/library/library.h"
#include "tests/radiometry/shot.h"
#include "worker/stages/device_scene.h"

// This program's own entries stand before the OpenCL library's: they count and pass on.
namespace {
std::atomic<std::uint64_t> launches{0}, bytes_read{0}, bytes_written{0};

template <typename Function>
Function* real(const char* name) {
  return reinterpret_cast<Function*>(dlsym(RTLD_NEXT, name));
}
}  // namespace

extern "C" {
CL_API_ENTRY cl_int CL_API_CALL clEnqueueNDRangeKernel(cl_command_queue queue, cl_kernel kernel, cl_uint dimensions,
                                                       const size_t* offset, const size_t* global, const size_t* local,
                                                       cl_uint waits, const cl_event* list, cl_event* event) {
  ++launches;
  static auto* const pass_on = real<decltype(clEnqueueNDRangeKernel)>("clEnqueueNDRangeKernel");
  return pass_on(queue, kernel, dimensions, offset, global, local, waits, list, event);
}
CL_API_ENTRY cl_int CL_API_CALL clEnqueueReadBuffer(cl_command_queue queue, cl_mem buffer, cl_bool blocking,
                                                    size_t offset, size_t size, void* to, cl_uint waits,
                                                    const cl_event* list, cl_event* event) {
  bytes_read += size;
  static auto* const pass_on = real<decltype(clEnqueueReadBuffer)>("clEnqueueReadBuffer");
  return pass_on(queue, buffer, blocking, offset, size, to, waits, list, event);
}
CL_API_ENTRY cl_int CL_API_CALL clEnqueueWriteBuffer(cl_command_queue queue, cl_mem buffer, cl_bool blocking,
                                                     size_t offset, size_t size, const void* from, cl_uint waits,
                                                     const cl_event* list, cl_event* event) {
  bytes_written += size;
  static auto* const pass_on = real<decltype(clEnqueueWriteBuffer)>("clEnqueueWriteBuffer");
  return pass_on(queue, buffer, blocking, offset, size, from, waits, list, event);
}
}

namespace gleaner::test {
namespace {

using scene::grey;
using scene::SceneBuilder;

struct Cost {
  worker::BatchCounters rays;
  std::uint64_t launches = 0, read = 0, written = 0, records = 0;
};

// One batch of all items, the scene loaded and the kernels built before.
Cost cost_of(const Shot& shot) {
  worker::Executor& on = executor(shot.trace);
  const std::uint64_t items = std::uint64_t{shot.width} * shot.height * shot.chunks;
  const worker::StageTask task = task_of(parameters_of(shot), load(on, shot.scene));
  on.run(task, 0, 1);
  launches = bytes_read = bytes_written = 0;
  const auto result = on.run(task, 0, items);
  const Cost cost{result.counters, launches, bytes_read, bytes_written, result.records.size()};
  std::printf(
      "  %-24s depth %u: rays camera %zu, scatter %zu, shadow %zu; %zu launches; bytes read %zu (records %zu), written "
      "%zu\n",
      shot.scene->name.c_str(), shot.depth, std::size_t{cost.rays.camera_rays}, std::size_t{cost.rays.scatter_rays},
      std::size_t{cost.rays.shadow_rays}, std::size_t{cost.launches}, std::size_t{cost.read}, std::size_t{cost.records},
      std::size_t{cost.written});
  return cost;
}

Shot small(const std::string& name, std::uint32_t depth) {
  Shot shot{.scene = std::make_shared<const Scene>(scene::make_scene(name))};
  shot.camera = camera_of(*shot.scene);
  shot.width = shot.height = 8;
  shot.chunks = 1;
  shot.depth = depth;
  return shot;
}

constexpr std::uint64_t kPaths = 8 * 8 * 16;

// A closed box of Lambert walls that glow: every ray hits, every point is lit.
TEST(Budget, ClosedLambertBox) {
  Shot shot = small("furnace", 1);
  const Cost one = cost_of(shot);
  EXPECT_EQ(one.rays.camera_rays, kPaths);
  EXPECT_EQ(one.rays.scatter_rays, kPaths) << "each path scatters once";
  EXPECT_LE(one.rays.shadow_rays, kPaths);
  // A light sample on the wall that is stood upon sees nothing.
  EXPECT_GE(one.rays.shadow_rays, kPaths / 2);
  // Generate, shade and connect; shade what was scattered; resolve.
  EXPECT_EQ(one.launches, 5u);

  shot.depth = 2;
  const Cost two = cost_of(shot);
  EXPECT_EQ(two.rays.scatter_rays, 2 * kPaths);
  EXPECT_LE(two.rays.shadow_rays, 2 * kPaths);
  EXPECT_EQ(two.launches, 7u);
  // Up: the parameters, and counters by the wave; down: the records, what was not finite, and counters.
  EXPECT_LE(two.written, sizeof(kernels::PathParameters) + 64 * two.launches);
  EXPECT_LE(two.read, two.records + 64 * two.launches);
}

TEST(Budget, TracedInOpenCl) {
  Shot shot = small("furnace", 1);
  shot.trace = worker::TraceKind::opencl;
  const Cost one = cost_of(shot);
  EXPECT_EQ(one.rays.scatter_rays, kPaths);
  // Besides: two waves of closest hits, one of shadow rays.
  EXPECT_EQ(one.launches, 8u);
}

// The camera sees the whole room; a last scattering could only find emission, and points do not emit.
TEST(Budget, PunctualLightsNeedNoLastRay) {
  const auto room = [] {
    SceneBuilder b("room with a point light");
    b.mesh("walls");
    b.box({}, {1, 1, 1}, 0, b.material("wall", scene::lambert(grey(0.5))), true);
    b.point_light({0.2, 0.3, 0.1}, grey(1));
    b.camera("camera", {0.1, 0.05, 0.9}, {}, 60, 16, 16);
    return std::make_shared<const Scene>(b.finish());
  };
  Shot shot = small("furnace", 1);
  shot.scene = room();
  shot.camera = camera_of(*shot.scene);
  const Cost one = cost_of(shot);
  EXPECT_EQ(one.rays.scatter_rays, 0u);
  EXPECT_EQ(one.rays.shadow_rays, kPaths);
  EXPECT_EQ(one.launches, 4u);
  shot.depth = 2;
  const Cost two = cost_of(shot);
  EXPECT_EQ(two.rays.scatter_rays, kPaths);
  EXPECT_EQ(two.rays.shadow_rays, 2 * kPaths);
}

// A shadow ray is asked once more for each surface that lets its light through, and all of a wave's together.
TEST(Budget, ShadowRaysThroughAlpha) {
  SceneBuilder b("floor under two veils");
  b.mesh("floor");
  b.quad({-9, 0, 9}, {9, 0, 9}, {9, 0, -9}, {-9, 0, -9}, b.material("floor", scene::lambert(grey(0.5))));
  scene::Material sheet = scene::lambert(grey(0));
  sheet.flags |= GLEANER_MATERIAL_ALPHA_BLEND;
  sheet.alpha = 0.5f;
  const auto material = b.material("sheet", sheet);
  for (const double y : {1.0, 2.0}) b.quad({-9, y, 9}, {9, y, 9}, {9, y, -9}, {-9, y, -9}, material);
  b.directional_light({0, -1, 0}, grey(1));
  b.camera("camera", {0, 0.5, 0.1}, {}, 20, 16, 16);
  Shot shot = small("furnace", 1);
  shot.scene = std::make_shared<const Scene>(b.finish());
  shot.camera = camera_of(*shot.scene);
  const Cost cost = cost_of(shot);
  EXPECT_EQ(cost.rays.scatter_rays, 0u);
  EXPECT_EQ(cost.rays.shadow_rays, 3 * kPaths);
  // Generate, shade, three times pass, resolve.
  EXPECT_EQ(cost.launches, 6u);
}

TEST(Budget, WithoutLightsNothingIsAskedOfThem) {
  SceneBuilder b("room without a light");
  b.mesh("walls");
  b.box({}, {1, 1, 1}, 0, b.material("wall", scene::lambert(grey(0.5))), true);
  b.camera("camera", {0.1, 0.05, 0.9}, {}, 60, 16, 16);
  Shot shot = small("furnace", 4);
  shot.scene = std::make_shared<const Scene>(b.finish());
  shot.camera = camera_of(*shot.scene);
  const Cost cost = cost_of(shot);
  EXPECT_EQ(cost.rays.camera_rays, kPaths);
  EXPECT_EQ(cost.rays.shadow_rays, 0u);
}

// Mirrors and glass cannot see a light sample: none is drawn.
TEST(Budget, MirrorsAskNoShadowRays) {
  SceneBuilder b("mirrors");
  b.mesh("mirror");
  b.quad({-1, 0, 1}, {1, 0, 1}, {1, 0, -1}, {-1, 0, -1}, b.material("mirror", scene::metal(grey(0.9), 0)));
  b.environment(4, [](scene::Vec) { return grey(1); });
  b.camera("camera", {0, 2, 0.1}, {}, 20, 16, 16);
  Shot shot = small("furnace", 0);
  shot.scene = std::make_shared<const Scene>(b.finish());
  shot.camera = camera_of(*shot.scene);
  const Cost cost = cost_of(shot);
  EXPECT_EQ(cost.rays.scatter_rays, kPaths) << "each is mirrored once, into the sky";
  EXPECT_EQ(cost.rays.shadow_rays, 0u);
}

TEST(Budget, ShortLastItem) {
  Shot shot = small("furnace", 1);
  worker::Executor& on = executor(shot.trace);
  kernels::PathParameters p = parameters_of(shot);
  p.last_item_samples = 5;
  const auto result = on.run(task_of(p, load(on, shot.scene)), 0, 64);
  EXPECT_EQ(result.counters.camera_rays, 63u * 16 + 5);
}

std::set<std::string> features_of(const std::string& options) {
  std::set<std::string> features;
  std::istringstream words(options);
  for (std::string word; words >> word;)
    if (word.starts_with("NEED_")) features.insert(word.substr(5));
  return features;
}
std::set<std::string> features_of(Scene scene) {
  worker::DeviceChoice choice;
  choice.threads = 1;
  const worker::Device device(choice);
  const auto held = std::make_shared<const Scene>(std::move(scene));
  const scene::Bvh bvh = scene::build_bvh(*held);
  const worker::DeviceScene on_device(device, held, &bvh);
  const auto features = features_of(on_device.kernel_options());
  std::printf("  %-20s %s\n", held->name.c_str(), on_device.kernel_options().c_str());
  return features;
}

// What a scene does not need is not compiled.
TEST(Budget, KernelsKnowWhatTheSceneNeedsAlone) {
  using Set = std::set<std::string>;
  const auto library = [](const char* name) { return features_of(scene::make_scene(name)); };
  EXPECT_EQ(library("cornell-box"), Set{"EMISSIVE_TRIANGLES"});
  EXPECT_EQ(library("furnace-point"), Set{"PUNCTUAL_LIGHTS"});
  EXPECT_EQ(library("punctual-lights"), (Set{"GLOSSY", "METALLIC", "SMOOTH_NORMALS", "PUNCTUAL_LIGHTS"}));
  EXPECT_EQ(library("cornell-mirror"), (Set{"SPECULAR", "METALLIC", "EMISSIVE_TRIANGLES"}));
  EXPECT_EQ(library("emissive-textured"), (Set{"GLOSSY", "METALLIC", "TEXTURES", "MATERIAL_TEXTURES",
                                               "EMISSION_TEXTURES", "SMOOTH_NORMALS", "EMISSIVE_TRIANGLES"}));
  EXPECT_EQ(features_of(scene::make_scene("white-furnace", {{"transmission", "1"}, {"roughness", "0"}})),
            (Set{"SPECULAR", "TRANSMISSIVE", "SMOOTH_NORMALS", "ENVIRONMENT"}));

  // A light that does not shine is none.
  Scene dark = scene::make_scene("furnace-point");
  for (auto& light : dark.lights)
    for (float& c : light.intensity) c = 0;
  EXPECT_EQ(features_of(dark), Set{});
}

}  // namespace
}  // namespace gleaner::test

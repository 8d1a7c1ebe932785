#include "worker/trace/embree_levels.h"

#include <algorithm>
#include <chrono>
#include <cstring>
#include <string>

#include "scene/model/error.h"
#include "scene/model/instances.h"
#include "worker/device/clock.h"

namespace gleaner::worker {
namespace {

constexpr gl_float kUnmoved[12] = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0};
constexpr std::uint32_t kMeasuredLeaf = 4;  // triangles, as Embree's own leaves hold

// Room behind the last element: Embree loads sixteen bytes at once.
template <typename T>
EmbreeHandle<RTCBuffer> copied(RTCDevice device, const std::vector<T>& values) {
  EmbreeHandle<RTCBuffer> buffer(rtcNewBuffer(device, values.size() * sizeof(T) + 16));
  if (void* bytes = buffer ? rtcGetBufferData(buffer.get()) : nullptr)
    std::memcpy(bytes, values.data(), values.size() * sizeof(T));
  return buffer;
}

}  // namespace

EmbreeLevels::EmbreeLevels(const scene::Scene& scene, unsigned threads, const std::string& isa)
    : device_(rtcNewDevice(("threads=" + std::to_string(threads) + (isa.empty() ? "" : ",isa=" + isa)).c_str())),
      vertex_count_(scene.vertex_count()) {
  if (!device_) throw Error::failed("Embree: no device (error " + std::to_string(rtcGetDeviceError(nullptr)) + ")");
  native_packets_ = rtcGetDeviceProperty(device_.get(), RTC_DEVICE_PROPERTY_NATIVE_RAY16_SUPPORTED) != 0;
  vertices_ = copied(device_.get(), scene.positions);
  corners_ = copied(device_.get(), scene.indices);
  check("copying the scene");
  build_world(scene);
  build_parts(scene);
  build_top(scene);
}

void EmbreeLevels::check(const char* what) {
  if (const auto error = rtcGetDeviceError(device_.get()); error != RTC_ERROR_NONE)
    throw Error::failed(std::string("Embree: ") + what + " failed (error " + std::to_string(error) + ")");
}

// Robust: watertight at shared edges. Medium: the high-quality build is not deterministic.
EmbreeHandle<RTCScene> EmbreeLevels::new_scene(RTCSceneFlags more) {
  EmbreeHandle<RTCScene> scene(rtcNewScene(device_.get()));
  rtcSetSceneFlags(scene.get(), static_cast<RTCSceneFlags>(RTC_SCENE_FLAG_ROBUST | more));
  rtcSetSceneBuildQuality(scene.get(), RTC_BUILD_QUALITY_MEDIUM);
  return scene;
}

void EmbreeLevels::attach_triangles(RTCScene scene, std::uint32_t first, std::uint32_t count, RTCBuildQuality quality) {
  RTCGeometry geometry = rtcNewGeometry(device_.get(), RTC_GEOMETRY_TYPE_TRIANGLE);
  if (count) {
    rtcSetGeometryBuffer(geometry, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3, vertices_.get(), 0, 12, vertex_count_);
    rtcSetGeometryBuffer(geometry, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3, corners_.get(), std::size_t{12} * first,
                         12, count);
  }
  rtcSetGeometryBuildQuality(geometry, quality);
  rtcCommitGeometry(geometry);
  rtcAttachGeometry(scene, geometry);
  rtcReleaseGeometry(geometry);
}

void EmbreeLevels::build_world(const scene::Scene& scene) {
  std::vector<scene::TriangleRun> runs = scene::still_triangles(scene);
  if (runs.empty() && scene.triangle_count() > 0) return;
  if (runs.empty()) runs.push_back({0, 0});
  world_ = new_scene();
  for (const scene::TriangleRun& run : runs) {
    attach_triangles(world_.get(), run.first, run.count, RTC_BUILD_QUALITY_MEDIUM);
    world_firsts_.push_back(run.first);
  }
  rtcCommitScene(world_.get());
  check("building the scene");
}

void EmbreeLevels::build_parts(const scene::Scene& scene) {
  for (const std::uint32_t m : scene::meshes_with_own_bvh(scene)) {
    const scene::Mesh& mesh = scene.meshes[m];
    Part& part = parts_.emplace_back();
    part.mesh = m;
    part.first_triangle = mesh.first_triangle;
    part.triangle_count = mesh.triangle_count;
    // Embree refits in dynamic scenes alone.
    part.rest = new_scene(mesh.deforming ? RTC_SCENE_FLAG_DYNAMIC : RTC_SCENE_FLAG_NONE);
    attach_triangles(part.rest.get(), mesh.first_triangle, mesh.triangle_count,
                     mesh.deforming ? RTC_BUILD_QUALITY_REFIT : RTC_BUILD_QUALITY_MEDIUM);
    rtcCommitScene(part.rest.get());
    check("building a mesh");
    if (!mesh.deforming) continue;
    const auto corners =
        std::span(scene.indices).subspan(std::size_t{3} * mesh.first_triangle, std::size_t{3} * mesh.triangle_count);
    const auto [least, most] = std::minmax_element(corners.begin(), corners.end());
    part.first_vertex = *least;
    part.end_vertex = *most + 1;
    part.measure = scene::build_tree(boxes_of(part), kMeasuredLeaf);
    part.cost_at_rest = scene::sah_cost(part.measure.nodes);
  }
}

void EmbreeLevels::add_to_top(const Part& part, const gl_float* transform, std::uint32_t instance) {
  RTCGeometry geometry = rtcNewGeometry(device_.get(), RTC_GEOMETRY_TYPE_INSTANCE);
  rtcSetGeometryInstancedScene(geometry, part.rest.get());
  rtcSetGeometryTransform(geometry, 0, RTC_FORMAT_FLOAT3X4_ROW_MAJOR, transform);
  rtcCommitGeometry(geometry);
  rtcAttachGeometryByID(top_.get(), geometry, static_cast<unsigned>(rows_.size()));
  rtcReleaseGeometry(geometry);
  rows_.push_back({part.first_triangle, instance});
}

// First the meshes that deform, in the order of the parts, then the scene's instances.
void EmbreeLevels::build_top(const scene::Scene& scene) {
  if (parts_.empty()) return;
  top_ = new_scene();
  std::vector<const Part*> part_of(scene.meshes.size());
  for (const Part& part : parts_) {
    part_of[part.mesh] = &part;
    if (scene.meshes[part.mesh].deforming) add_to_top(part, kUnmoved, GLEANER_NONE);
  }
  instances_ = scene.instances;
  for (std::uint32_t i = 0; i < instances_.size(); ++i)
    add_to_top(*part_of[instances_[i].mesh], instances_[i].transform, i);
  rtcCommitScene(top_.get());
  check("building the top level");
  rtcGetSceneBounds(top_.get(), &top_bounds_);
}

std::vector<scene::TreeBox> EmbreeLevels::boxes_of(const Part& part) const {
  const auto* positions = static_cast<const float*>(rtcGetBufferData(vertices_.get()));
  const auto* corners = static_cast<const std::uint32_t*>(rtcGetBufferData(corners_.get()));
  std::vector<scene::TreeBox> boxes(part.triangle_count);
  for (std::size_t t = 0; t < boxes.size(); ++t)
    for (std::size_t k = 0; k < 3; ++k)
      boxes[t].extend(positions + std::size_t{3} * corners[3 * (part.first_triangle + t) + k]);
  return boxes;
}

// Afterwards the top level has to be built anew. `rebuilt` is used where it exists.
MotionReport::Mesh EmbreeLevels::deform(Part& part, std::span<const float> positions) {
  const auto start = std::chrono::steady_clock::now();
  auto* vertices = static_cast<float*>(rtcGetBufferData(vertices_.get()));
  std::copy(positions.begin() + std::size_t{3} * part.first_vertex,
            positions.begin() + std::size_t{3} * part.end_vertex, vertices + std::size_t{3} * part.first_vertex);
  const std::vector<scene::TreeBox> boxes = boxes_of(part);
  scene::refit({part.measure.nodes, 0}, [&](std::uint32_t slot) { return boxes[part.measure.slots[slot]]; });
  MotionReport::Mesh report{.mesh = part.mesh};
  report.growth = scene::sah_cost(part.measure.nodes) / part.cost_at_rest;
  report.rebuilt = !(report.growth <= kMostSahGrowth);
  if (report.rebuilt) {
    part.rebuilt = new_scene();
    attach_triangles(part.rebuilt.get(), part.first_triangle, part.triangle_count, RTC_BUILD_QUALITY_MEDIUM);
    rtcCommitScene(part.rebuilt.get());
  } else {
    part.rebuilt.reset();
    RTCGeometry geometry = rtcGetGeometry(part.rest.get(), 0);
    rtcUpdateGeometryBuffer(geometry, RTC_BUFFER_TYPE_VERTEX, 0);
    rtcCommitGeometry(geometry);
    rtcCommitScene(part.rest.get());
  }
  check("following a mesh that deforms");
  report.seconds = seconds_since(start);
  return report;
}

MotionReport EmbreeLevels::follow(const SceneMotion& motion) {
  MotionReport report;
  check_motion(motion, instances_, 3 * vertex_count_);
  for (const std::uint32_t mesh : motion.deformed) {
    const auto part = std::ranges::find_if(parts_, [&](const Part& p) { return p.mesh == mesh && p.end_vertex > 0; });
    if (part == parts_.end()) throw Error::failed("mesh " + std::to_string(mesh) + " does not deform");
    report.meshes.push_back(deform(*part, motion.positions));
  }
  if (!top_) return report;
  const auto start = std::chrono::steady_clock::now();
  unsigned row = 0;
  for (const Part& part : parts_) {
    if (part.end_vertex == 0) continue;
    RTCGeometry geometry = rtcGetGeometry(top_.get(), row++);
    rtcSetGeometryInstancedScene(geometry, part.rebuilt ? part.rebuilt.get() : part.rest.get());
    rtcCommitGeometry(geometry);
  }
  for (std::size_t i = 0; i < motion.instances.size(); ++i) {
    const scene::Instance& moved = motion.instances[i];
    if (std::memcmp(&moved, &instances_[i], sizeof moved) == 0) continue;
    instances_[i] = moved;
    RTCGeometry geometry = rtcGetGeometry(top_.get(), row + static_cast<unsigned>(i));
    rtcSetGeometryTransform(geometry, 0, RTC_FORMAT_FLOAT3X4_ROW_MAJOR, moved.transform);
    rtcCommitGeometry(geometry);
  }
  rtcCommitScene(top_.get());
  check("building the top level");
  rtcGetSceneBounds(top_.get(), &top_bounds_);
  report.top_level_seconds = seconds_since(start);
  return report;
}

}  // namespace gleaner::worker

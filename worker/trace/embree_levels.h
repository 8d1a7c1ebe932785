#pragma once
// The scenes that Embree traces: one of all triangles that stand still in the world, and, where a scene has instances
// or meshes that deform, a top level of instances of scenes of one mesh each. Rays ask the one, then the other.

#if __has_include(<embree4/rtcore.h>)
#include <embree4/rtcore.h>
#define GLEANER_EMBREE4
#else
#include <embree3/rtcore.h>
#endif

#include <cstdint>
#include <memory>
#include <string>
#include <type_traits>
#include <vector>

#include "scene/model/tree.h"
#include "worker/trace/tracer.h"

namespace gleaner::worker {

struct EmbreeRelease {
  void operator()(RTCDevice device) const { rtcReleaseDevice(device); }
  void operator()(RTCScene scene) const { rtcReleaseScene(scene); }
  void operator()(RTCBuffer buffer) const { rtcReleaseBuffer(buffer); }
};
template <typename Handle>
using EmbreeHandle = std::unique_ptr<std::remove_pointer_t<Handle>, EmbreeRelease>;

class EmbreeLevels {
 public:
  // `isa` as make_embree_tracer()'s. Throws Error::failed where Embree cannot build (out of memory).
  EmbreeLevels(const scene::Scene& scene, unsigned threads, const std::string& isa);

  // Whether Embree traces 16 rays by instructions for 16 lanes.
  bool native_packets() const { return native_packets_; }

  // Null where all triangles are of the top level.
  RTCScene world() const { return world_.get(); }
  // A hit on the world's geometry g is on triangle primitive + world_firsts()[g].
  const std::vector<std::uint32_t>& world_firsts() const { return world_firsts_; }

  // Null where a scene has neither instances nor meshes that deform.
  RTCScene top() const { return top_.get(); }
  const RTCBounds& top_bounds() const { return top_bounds_; }
  // What an instance of the top level stands for.
  struct Row {
    std::uint32_t first_triangle;  // of its mesh
    std::uint32_t instance;        // of the scene; GLEANER_NONE: a mesh that deforms, in world space
  };
  const std::vector<Row>& rows() const { return rows_; }

  bool has_instances() const { return !instances_.empty(); }

  MotionReport follow(const SceneMotion& motion);

 private:
  // A mesh with a BVH of its own.
  struct Part {
    std::uint32_t mesh = 0, first_triangle = 0, triangle_count = 0;
    EmbreeHandle<RTCScene> rest;                     // of the mesh at rest; refitted where it deforms
    EmbreeHandle<RTCScene> rebuilt;                  // where refitting made too bad a tree
    std::uint32_t first_vertex = 0, end_vertex = 0;  // of a mesh that deforms: its vertices lie in this range
    // Of a mesh that deforms: Embree does not tell its trees' SAH cost. This one is built by the same heuristic.
    scene::Tree measure;
    double cost_at_rest = 0;
  };

  EmbreeHandle<RTCScene> new_scene(RTCSceneFlags more = RTC_SCENE_FLAG_NONE);
  void attach_triangles(RTCScene scene, std::uint32_t first, std::uint32_t count, RTCBuildQuality quality);
  void build_world(const scene::Scene& scene);
  void build_parts(const scene::Scene& scene);
  void build_top(const scene::Scene& scene);
  void add_to_top(const Part& part, const gl_float* transform, std::uint32_t instance);
  std::vector<scene::TreeBox> boxes_of(const Part& part) const;
  MotionReport::Mesh deform(Part& part, std::span<const float> positions);
  void check(const char* what);

  EmbreeHandle<RTCDevice> device_;
  bool native_packets_ = false;
  EmbreeHandle<RTCBuffer> vertices_, corners_;
  std::size_t vertex_count_ = 0;
  EmbreeHandle<RTCScene> world_, top_;
  RTCBounds top_bounds_{};
  std::vector<std::uint32_t> world_firsts_;
  std::vector<Part> parts_;
  std::vector<Row> rows_;
  std::vector<scene::Instance> instances_;  // as the top level has them
};

}  // namespace gleaner::worker

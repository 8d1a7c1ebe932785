#pragma once
// Ray queries against one scene: closest hit and any hit, over blocks of 16 rays (kernels/rays.h).

#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "scene/model/blob.h"
#include "worker/device/device.h"
#include "worker/trace/motion.h"

namespace gleaner::worker {

bool embree_available();
std::string tracer_description(TraceKind kind);

// A run of rays in a buffer of blocks of `rows` rows of 16. Rays [0, incoherent) answer one by one; blocks from
// `coherent_base` (a multiple of 16) on, `coherent_count` rays, hold 16 neighbours each and may answer as packets.
struct RayRange {
  unsigned rows = 0;
  std::uint32_t incoherent = 0, coherent_base = 0, coherent_count = 0;
  std::uint32_t end() const { return coherent_count ? coherent_base + coherent_count : incoherent; }
};

// What moved since a tracer was made, or last updated.
struct SceneMotion {
  std::span<const float> positions;         // of all vertices, as Scene::positions; of `deformed` meshes they are read
  std::span<const std::uint32_t> deformed;  // meshes marked Mesh::deforming
  std::span<const scene::Instance> instances;  // all of the scene's, in its order, of the same meshes; empty: unmoved
};

// A mesh is refitted as long as its tree's SAH cost grows to no more than this, and else rebuilt. Refitting always
// starts at the tree of the mesh at rest, so that the answers do not depend on what was shown before.
inline constexpr double kMostSahGrowth = 1.5;

// Throws Error::failed where a motion is not of a scene with these instances, but for their transforms, and so many
// coordinates.
void check_motion(const SceneMotion& motion, std::span<const scene::Instance> instances, std::size_t position_values);

class Tracer {
 public:
  virtual ~Tracer() = default;
  // Both block until the answers are in the buffer. Rays whose far is not positive are left alone. Thread-safe.
  // Throw Error::failed where the device fails or a traversal stack was too small.
  virtual void closest(cl::CommandQueue& queue, cl::Buffer& rays, const RayRange& range) = 0;
  virtual void any(cl::CommandQueue& queue, cl::Buffer& rays, const RayRange& range) = 0;
  // Follows what moved: deformed meshes are refitted or rebuilt, then the top level is built anew. Nothing else is
  // touched. The caller sees to it that no query runs meanwhile.
  virtual MotionReport follow(const SceneMotion& motion) = 0;
};

// `isa`: the instructions that Embree may use, as its configuration calls them ("avx2"); empty: all that the CPU has.
std::unique_ptr<Tracer> make_embree_tracer(const scene::Scene& scene, unsigned threads, const std::string& isa = "");
// `triangles`: the table of kernels/scene_layout.h.
std::unique_ptr<Tracer> make_opencl_tracer(const Device& device, const scene::Scene& scene, const scene::Bvh& bvh,
                                           const cl::Buffer& triangles, unsigned triangle_words);

}  // namespace gleaner::worker

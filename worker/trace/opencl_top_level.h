#pragma once
// The host's side of the OpenCL tracer's two levels: which parts of the BVH stand where, the top level over them, and
// what motion makes of both. Refitting runs on the host: it is one pass over the nodes, whose new boxes then go to the
// device together, and it gives the SAH cost by which the tracer decides to rebuild, summed in the nodes' order.

#include <cstdint>
#include <functional>
#include <span>
#include <vector>

#include "scene/model/blob.h"
#include "scene/model/tree.h"
#include "worker/trace/tracer.h"

namespace gleaner::worker {

class OpenClTopLevel {
 public:
  // Throws Error::bad_input where the BVH's parts are not those of the scene.
  OpenClTopLevel(const scene::Scene& scene, const scene::Bvh& bvh);

  // Whether there is anything but what stands still in the world.
  bool has_two_levels() const { return parts_.size() > 1; }
  bool has_instances() const { return !instances_.empty(); }
  // Nodes and slots that the device needs room for: the BVH's own, then those that rebuilt meshes may take.
  std::size_t node_capacity() const { return node_capacity_; }
  std::size_t slot_capacity() const { return slot_capacity_; }
  // Entries of a stack that a ray may need.
  std::uint32_t depth() const { return has_two_levels() ? top_.depth + part_depth_ : part_depth_; }

  const std::vector<scene::BvhNode>& top() const { return top_.nodes; }
  const std::vector<std::uint32_t>& entries() const { return entries_; }  // two words each, see kernels/bvh_trace.cl
  const std::vector<float>& inverses() const { return inverses_; }        // sixteen words an instance

  // Writes of nodes and slots, from a number on.
  using WriteNodes = std::function<void(std::size_t first, std::span<const scene::BvhNode>)>;
  using WriteSlots = std::function<void(std::size_t first, std::span<const std::uint32_t>)>;
  MotionReport follow(const SceneMotion& motion, const WriteNodes& write_nodes, const WriteSlots& write_slots);

 private:
  struct Part {
    std::uint32_t mesh = 0, root = 0;
    scene::TreeBox box;
    // Of a mesh that deforms.
    bool deforms = false;
    std::uint32_t first_node = 0, first_slot = 0, first_triangle = 0;
    std::vector<scene::BvhNode> nodes;           // as the BVH has them at rest, fitted to where the mesh is
    std::vector<std::uint32_t> slots;            // triangles
    std::vector<std::uint32_t> corners;          // of the mesh's triangles
    std::size_t spare_node = 0, spare_slot = 0;  // where a rebuilt tree goes
    double cost_at_rest = 0;
  };

  void add_part(const scene::Scene& scene, const scene::Bvh& bvh, const scene::BvhPart& from);
  void build_top();
  MotionReport::Mesh deform(Part& part, std::span<const float> positions, const WriteNodes& write_nodes,
                            const WriteSlots& write_slots);

  std::vector<Part> parts_;
  std::vector<std::size_t> part_of_;  // of each mesh
  std::vector<scene::Bounds> boxes_;  // of each instanced mesh, in its own space
  std::vector<scene::Instance> instances_;
  std::size_t node_capacity_, slot_capacity_, position_values_;
  std::uint32_t part_depth_;
  scene::Tree top_;
  std::vector<std::uint32_t> entries_;
  std::vector<float> inverses_;
};

}  // namespace gleaner::worker

#include "worker/trace/opencl_top_level.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <limits>
#include <string>

#include "scene/model/error.h"
#include "scene/model/instances.h"
#include "scene/model/limits.h"
#include "worker/device/clock.h"

namespace gleaner::worker {
namespace {

constexpr std::uint32_t kRebuiltLeaf = 4;  // triangles, as in the trees of blobs

scene::TreeBox box_of(const scene::BvhNode& root) {
  scene::TreeBox box;
  for (int c = 0; c < 3; ++c) {
    box.lower[c] = std::min(root.lower0[c], root.lower1[c]);
    box.upper[c] = std::max(root.upper0[c], root.upper1[c]);
  }
  return box;
}

// Floats that hold all of it.
scene::TreeBox box_of(const scene::DerivedInstance& instance) {
  scene::TreeBox box;
  for (int c = 0; c < 3; ++c) {
    box.lower[c] = std::nextafter(static_cast<float>(instance.lower[c]), -std::numeric_limits<float>::infinity());
    box.upper[c] = std::nextafter(static_cast<float>(instance.upper[c]), std::numeric_limits<float>::infinity());
  }
  return box;
}

}  // namespace

OpenClTopLevel::OpenClTopLevel(const scene::Scene& scene, const scene::Bvh& bvh)
    : part_of_(scene.meshes.size()),
      boxes_(scene.meshes.size()),
      instances_(scene.instances),
      node_capacity_(bvh.nodes.size()),
      slot_capacity_(bvh.triangles.size()),
      position_values_(scene.positions.size()),
      part_depth_(bvh.max_depth) {
  const std::vector<std::uint32_t> meshes = scene::meshes_with_own_bvh(scene);
  if (bvh.parts.size() != meshes.size() + 1)
    throw Error::bad_input("BVH", "parts", std::to_string(meshes.size() + 1), std::to_string(bvh.parts.size()));
  for (std::size_t p = 0; p < bvh.parts.size(); ++p) {
    const std::uint32_t mesh = p == 0 ? GLEANER_NONE : meshes[p - 1];
    if (bvh.parts[p].mesh != mesh)
      throw Error::bad_input("BVH", "parts[" + std::to_string(p) + "]", "mesh " + std::to_string(mesh),
                             std::to_string(bvh.parts[p].mesh));
    add_part(scene, bvh, bvh.parts[p]);
  }
  build_top();
}

void OpenClTopLevel::add_part(const scene::Scene& scene, const scene::Bvh& bvh, const scene::BvhPart& from) {
  Part& part = parts_.emplace_back();
  part.mesh = from.mesh;
  part.root = from.first_node;
  part.box = box_of(bvh.nodes[from.first_node]);
  if (from.mesh == GLEANER_NONE) return;
  part_of_[from.mesh] = parts_.size() - 1;
  const scene::Mesh& mesh = scene.meshes[from.mesh];
  if (mesh.instanced) boxes_[from.mesh] = bounds_of(scene, mesh);
  if (!mesh.deforming) return;
  part.deforms = true;
  part.first_node = from.first_node;
  part.first_slot = from.first_slot;
  part.first_triangle = mesh.first_triangle;
  const auto copy = [](const auto& all, std::size_t first, std::size_t count, auto& to) {
    const auto begin = all.begin() + static_cast<std::ptrdiff_t>(first);
    to.assign(begin, begin + static_cast<std::ptrdiff_t>(count));
  };
  copy(bvh.nodes, from.first_node, from.nodes, part.nodes);
  copy(bvh.triangles, from.first_slot, from.slots, part.slots);
  copy(scene.indices, std::size_t{3} * mesh.first_triangle, std::size_t{3} * mesh.triangle_count, part.corners);
  for (const std::uint32_t triangle : part.slots)
    if (triangle < mesh.first_triangle || triangle - mesh.first_triangle >= mesh.triangle_count)
      throw Error::bad_input("BVH", "part of mesh " + std::to_string(from.mesh), "triangles of the mesh alone",
                             std::to_string(triangle));
  part.cost_at_rest = scene::sah_cost(part.nodes);
  part.spare_node = node_capacity_;
  part.spare_slot = slot_capacity_;
  node_capacity_ += mesh.triangle_count;
  slot_capacity_ += mesh.triangle_count;
  // A tree that is built here may be deeper than those of the blob.
  part_depth_ = scene::kMaxBvhDepth;
}

// An entry for all that stands still, for each mesh that deforms, and for each instance.
void OpenClTopLevel::build_top() {
  std::vector<scene::TreeBox> boxes;
  std::vector<std::uint32_t> entries;
  const auto add = [&](const scene::TreeBox& box, std::uint32_t root, std::uint32_t instance) {
    boxes.push_back(box);
    entries.push_back(root);
    entries.push_back(instance);
  };
  for (const Part& part : parts_)
    if (part.mesh == GLEANER_NONE || part.deforms) add(part.box, part.root, GLEANER_NONE);
  inverses_.assign(16 * instances_.size(), 0.0f);
  for (std::uint32_t i = 0; i < instances_.size(); ++i) {
    const scene::Instance& instance = instances_[i];
    const scene::DerivedInstance d = scene::derived(instance.transform, boxes_[instance.mesh]);
    float* row = &inverses_[std::size_t{16} * i];
    for (std::size_t r = 0; r < 3; ++r) {
      double back = 0;
      for (std::size_t c = 0; c < 3; ++c) {
        row[3 * r + c] = static_cast<float>(d.inverse[3 * r + c]);
        back -= d.inverse[3 * r + c] * instance.transform[4 * c + 3];
      }
      row[9 + r] = static_cast<float>(back);
    }
    add(box_of(d), parts_[part_of_[instance.mesh]].root, i);
  }
  top_ = scene::build_tree(boxes, 1);
  entries_.clear();
  for (const std::uint32_t slot : top_.slots) {
    entries_.push_back(entries[2 * std::size_t{slot}]);
    entries_.push_back(entries[2 * std::size_t{slot} + 1]);
  }
}

MotionReport::Mesh OpenClTopLevel::deform(Part& part, std::span<const float> positions, const WriteNodes& write_nodes,
                                          const WriteSlots& write_slots) {
  const auto start = std::chrono::steady_clock::now();
  std::vector<scene::TreeBox> boxes(part.corners.size() / 3);
  for (std::size_t t = 0; t < boxes.size(); ++t)
    for (std::size_t k = 0; k < 3; ++k) boxes[t].extend(&positions[std::size_t{3} * part.corners[3 * t + k]]);
  scene::refit({part.nodes, part.first_node},
               [&](std::uint32_t slot) { return boxes[part.slots[slot - part.first_slot] - part.first_triangle]; });
  MotionReport::Mesh report{.mesh = part.mesh};
  report.growth = scene::sah_cost(part.nodes) / part.cost_at_rest;
  report.rebuilt = !(report.growth <= kMostSahGrowth);
  part.box = box_of(part.nodes[0]);
  if (report.rebuilt) {
    scene::Tree tree = scene::build_tree(boxes, kRebuiltLeaf);
    for (scene::BvhNode& node : tree.nodes)
      for (gl_uint& child : node.child)
        child += static_cast<gl_uint>(child & GLEANER_BVH_LEAF ? part.spare_slot : part.spare_node);
    for (std::uint32_t& slot : tree.slots) slot += part.first_triangle;
    write_nodes(part.spare_node, tree.nodes);
    write_slots(part.spare_slot, tree.slots);
    part.root = static_cast<std::uint32_t>(part.spare_node);
  } else {
    write_nodes(part.first_node, part.nodes);
    part.root = part.first_node;
  }
  report.seconds = seconds_since(start);
  return report;
}

MotionReport OpenClTopLevel::follow(const SceneMotion& motion, const WriteNodes& write_nodes,
                                    const WriteSlots& write_slots) {
  MotionReport report;
  check_motion(motion, instances_, position_values_);
  for (const std::uint32_t mesh : motion.deformed) {
    const auto part = std::ranges::find_if(parts_, [&](const Part& p) { return p.mesh == mesh && p.deforms; });
    if (part == parts_.end()) throw Error::failed("mesh " + std::to_string(mesh) + " does not deform");
    report.meshes.push_back(deform(*part, motion.positions, write_nodes, write_slots));
  }
  if (!has_two_levels()) return report;
  const auto start = std::chrono::steady_clock::now();
  if (!motion.instances.empty()) instances_.assign(motion.instances.begin(), motion.instances.end());
  build_top();
  report.top_level_seconds = seconds_since(start);
  return report;
}

}  // namespace gleaner::worker

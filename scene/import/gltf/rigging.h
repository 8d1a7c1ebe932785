#pragma once
// What moves among a file's meshes: fills a scene's rig while the meshes are added, and later says how a time poses it.

#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "scene/import/gltf/animation.h"
#include "scene/import/gltf/nodes.h"
#include "scene/import/gltf/primitive.h"
#include "scene/model/frame_state.h"

namespace gleaner::scene::gltf {

// What moves a skinned mesh: nodes, and of each the matrix that comes before its transform.
struct Skin {
  std::size_t index = 0;  // in the file
  std::vector<std::size_t> joints;
  std::vector<Matrix> binds;
};

// A mesh under a node. A skinned one is moved by its joints alone.
struct Instance {
  std::size_t node = 0;
  std::vector<Matrix> locals;      // to the node's space; several where the node repeats its mesh
  std::optional<Skin> skin;        // instead of the node's own transform
  std::vector<Matrix> placements;  // to the world: of the locals, or the joints' matrices
  std::vector<Matrix> instances;   // placements of which each is an instance, not a copy: all of a node that moves
  bool stores_mesh = false;        // the first node with instances of its mesh
};

// A primitive as Meshes added it to the scene.
struct AddedPrimitive {
  const Primitive& primitive;
  const std::vector<std::uint32_t>& kept;  // its vertices that were added; empty: all
  std::size_t local = 0;                   // of the instance
  std::uint32_t first_vertex = 0, vertex_count = 0, first_triangle = 0, triangle_count = 0;
  bool mirrored = false;
};

// What places something relative to the scene's origin.
Placement placement_of(const Matrix& matrix, const Point3& origin);

// The weights of an instance's morph targets: the node's go before the mesh's.
std::vector<double> morph_weights(const Document& document, std::size_t node);

class Rigging {
 public:
  // None of these are kept but by reference. `is_base`: the scene gets a rig, as animations will move it.
  Rigging(const Document& document, const Animations& animations, bool is_base, Nodes& nodes, Scene& scene);

  // Whether animations move what is under this node.
  bool moves(std::size_t node) const { return moving_[node]; }
  // Whether a mesh without a skin under this node keeps its shape at all times, so that a transform shows it: it does
  // not morph, and no scale shrinks it to nothing. The same for a base and for a scene of one time, so that both are
  // made of the same meshes.
  bool keeps_shape(std::size_t node) const;
  // Whether what has this material at rest may be instanced at all times (may_be_instanced). `index`: of the scene's.
  bool may_be_instanced(const Material& material, std::size_t index) const;

  // Whether the animations move this primitive of the instance vertex by vertex.
  bool is_posed(const Instance& instance, const Primitive& primitive) const;
  void add(const Instance& instance, const AddedPrimitive& added);
  // A node's instances, one a local, which stand among the scene's from that one on: they follow where it moves.
  void add_instances(const Instance& instance, std::uint32_t first);

  // A time whose pose cannot be shown by the rig: the vertices' colours or texture coordinates change.
  bool needs_own_scenes() const { return needs_own_scenes_; }

  // The rig's matrices and weights, from nodes that stand as they do at the frame's time. False where the base cannot
  // show that pose: a posed mesh is mirrored in one of both, or an instance is flattened.
  bool pose(Nodes& nodes, const Scene& base, FrameState& state) const;

 private:
  // A run of the state's matrices.
  struct Matrices {
    std::size_t node = 0;
    std::vector<Matrix> locals;
    std::optional<Skin> skin;
    std::uint32_t first = 0;
  };
  struct Weights {
    std::size_t node = 0;
    std::uint32_t first = 0, count = 0;
  };
  struct Rest {
    std::uint32_t first_rest, first_target, first_influence;
  };

  bool has_moving_weights(std::size_t node) const;
  std::uint32_t matrices_of(const Instance& instance);
  std::uint32_t weights_of(std::size_t node, std::uint32_t targets);
  Rest rest_of(const AddedPrimitive& added, bool skinned);
  std::uint32_t add_deltas(const AddedPrimitive& added, std::size_t target, const char* attribute);
  void add_influences(const AddedPrimitive& added);

  const Document& document_;
  const Animations& animations_;
  bool is_base_;
  Rig& rig_;
  std::vector<bool> moving_, vanishing_;  // by node: it moves; it may shrink to nothing
  std::vector<Matrices> matrices_;
  std::map<std::size_t, std::uint32_t> matrices_of_skin_, matrices_of_node_, weights_of_node_;
  std::vector<Weights> weights_;
  std::map<std::string, Rest> rest_;  // by the primitive's name, and whether it is skinned
  std::vector<bool> mirrored_;        // by the rig's mesh
  bool needs_own_scenes_ = false;
};

}  // namespace gleaner::scene::gltf

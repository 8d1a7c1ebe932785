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
  std::vector<Matrix> instances;   // placements of which each is an instance, not a copy
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

// The weights of an instance's morph targets: the node's go before the mesh's.
std::vector<double> morph_weights(const Document& document, std::size_t node);

class Rigging {
 public:
  // None of these are kept but by reference. `is_base`: the scene gets a rig, as animations will move it.
  Rigging(const Document& document, const Animations& animations, bool is_base, Nodes& nodes, Scene& scene);

  // Whether animations may move a mesh under this node, or change its materials. The same for a base and for a scene
  // of one time, so that both are made of the same meshes.
  bool may_move(std::size_t node) const;

  // Whether the animations move this primitive of the instance.
  bool is_posed(const Instance& instance, const Primitive& primitive) const;
  void add(const Instance& instance, const AddedPrimitive& added);

  // A time whose pose cannot be shown by the rig: the vertices' colours or texture coordinates change.
  bool needs_own_scenes() const { return needs_own_scenes_; }

  // The rig's matrices and weights, from nodes that stand as they do at the frame's time. False where the base cannot
  // show that pose: a mesh is mirrored in one of both.
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
  std::uint32_t add_deltas(const AddedPrimitive& added, const std::optional<FloatView>& deltas);
  void add_influences(const AddedPrimitive& added);

  const Document& document_;
  const Animations& animations_;
  bool is_base_;
  Rig& rig_;
  std::vector<bool> moving_;  // by node
  std::vector<Matrices> matrices_;
  std::map<std::size_t, std::uint32_t> matrices_of_skin_, matrices_of_node_, weights_of_node_;
  std::vector<Weights> weights_;
  std::map<std::string, Rest> rest_;  // by the primitive's name, and whether it is skinned
  std::vector<bool> mirrored_;        // by the rig's mesh
  bool needs_own_scenes_ = false;
};

}  // namespace gleaner::scene::gltf

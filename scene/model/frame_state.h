#pragma once
// What of a scene a frame shows otherwise than the base does: small, and sent with the frame, while the base is sent
// once. A base and a state are a scene.

#include <array>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "scene/model/blob.h"
#include "scene/model/scene.h"

namespace gleaner::scene {

// Rows of a 3 x 4 matrix, one behind the other: to the base's space.
using Placement = std::array<double, 12>;

struct FrameState {
  std::vector<Placement> matrices;    // of the rig's meshes and instances, see PosedMesh and PosedInstance
  std::vector<double> morph_weights;  // of the rig's meshes
  // Lights and materials that take the place of the base's with these indices, which rise.
  std::vector<std::uint32_t> light_indices, material_indices;
  std::vector<Light> lights;
  std::vector<Material> materials;
  std::vector<float> albedo_tables;  // instead of the base's; empty: the base's

  // A frame that shows the base as it is needs no state.
  bool empty() const {
    return matrices.empty() && morph_weights.empty() && lights.empty() && materials.empty() && albedo_tables.empty();
  }
};

Bytes serialize(const FrameState& state);
// Throws Error::bad_input (named `origin`) on bytes that are no state: truncated, misaligned, not finite, indices that
// do not rise. Whether it fits a base is posed()'s to say.
FrameState parse_frame_state(std::span<const std::byte> bytes, const std::string& origin);

// Throws Error::bad_input, named `origin`, unless the state has so many matrices and weights: those of its base's rig.
void check_counts(const FrameState& state, std::uint32_t matrices, std::uint32_t morph_weights,
                  const std::string& origin);

// The base as the state shows it: a scene without a rig, which has passed validate(). Throws Error::bad_input, named
// `origin`, where the state has other numbers of matrices or weights than the base's rig, names lights or materials
// that the base lacks, or makes a scene that is not valid.
Scene posed(const Scene& base, const FrameState& state, const std::string& origin);

// A base as frames show it, one after the other: of a copy's arrays, a state rewrites what it has otherwise than the
// state before. What is shown is that of posed(), whatever was shown before.
class PosedScene {
 public:
  // Shows the base as its arrays have it, until the first state.
  explicit PosedScene(std::shared_ptr<const Scene> base);

  struct Changes {
    std::vector<std::uint32_t> meshes;  // of the scene: vertices moved
    bool lights = false;
    bool materials = false;  // or albedo tables
  };
  // Posing is shared among so many threads. Throws as posed(); then the scene must not be used any more.
  Changes show(const FrameState& state, const std::string& origin, unsigned threads = 1);
  // Shows the base as its arrays have it again.
  Changes show_rest();

  // Without a rig. Changed by show().
  const std::shared_ptr<const Scene>& scene() const { return shown_; }
  Scene take() && { return std::move(*mutable_); }

 private:
  std::vector<std::uint32_t> pose(const FrameState& state, const std::string& origin, unsigned threads);
  void place(const FrameState& state, const std::string& origin);
  void add_meshes_of(const PosedMesh& mesh, std::vector<std::uint32_t>& moved) const;

  std::shared_ptr<const Scene> base_;
  std::shared_ptr<Scene> mutable_;
  std::shared_ptr<const Scene> shown_;
  std::vector<Bounds> instanced_boxes_;
  std::optional<FrameState> state_;  // that is shown
};

// What `shown` has otherwise than the base, as a state; its matrices and weights are left empty. Only lights, materials
// and albedo tables are compared: there are as many of the first two in both.
FrameState changes(const Scene& base, const Scene& shown);

}  // namespace gleaner::scene

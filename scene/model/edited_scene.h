#pragma once
// A scene that somebody changes bit by bit: a base, and the state that shows it as it has been changed so far.

#include <array>
#include <memory>
#include <optional>
#include <string>

#include "scene/model/frame_state.h"

namespace gleaner::scene {

using Triple = std::array<float, 3>;

// What is not given stays as it is.
struct LightChange {
  std::uint32_t light = 0;  // of Scene::lights
  std::optional<Triple> position, direction, intensity;
};
struct MaterialChange {
  std::uint32_t material = 0;  // of Scene::materials
  std::optional<Triple> base_color, emission;
};
struct ObjectChange {
  std::uint32_t matrix = 0;  // of FrameState::matrices
  Placement placement{};     // from the base's place
};

class EditedScene {
 public:
  explicit EditedScene(std::shared_ptr<const Scene> base);

  // Each throws Error::bad_input, and changes nothing, for what the base lacks and for numbers that no scene may have.
  void apply(const LightChange& change);
  void apply(const MaterialChange& change);
  void apply(const ObjectChange& change);

  const std::shared_ptr<const Scene>& base() const { return base_; }
  // Says of every light and material what it is like, so that it is never empty where there are any.
  const FrameState& state() const { return state_; }

 private:
  std::shared_ptr<const Scene> base_;
  FrameState state_;
};

// Gives a mesh of a still scene vertices of its own, which a matrix of the scene's states places: the next one, whose
// number is returned. Throws Error::bad_input where there is no such mesh, or it cannot move: one that is instanced, or
// that moves already.
std::uint32_t make_movable(Scene& scene, const std::string& mesh);

}  // namespace gleaner::scene

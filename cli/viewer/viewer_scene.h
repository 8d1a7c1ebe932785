#pragma once
// What of a session's scene its page shows and changes, as it is by now: lights, materials, the camera.

#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "coordinator/plan/plan.h"
#include "gleaner/v1/farm.pb.h"
#include "scene/model/edited_scene.h"
#include "scene/model/scene.h"

namespace gleaner::cli {

class ViewerScene {
 public:
  ViewerScene(const scene::Scene& scene, std::string name, const coordinator::FrameSettings& settings);

  // name; size; lights (type, position in metres from `origin`, direction, intensity); materials (name, base_color,
  // emission); camera (type, origin, right, up, forward, half_width, half_height); centre and radius of the scene.
  nlohmann::json json() const;

  // The change that the page asks for: {"lights": [{"light", "position", "direction", "intensity"}], "materials":
  // [{"material", "base_color", "emission"}], "camera": {"origin", "forward", "up"}}, of which all may be missing but
  // light and material. Throws Error::bad_input, and changes nothing, for what it is not, or what the scene lacks.
  v1::SessionChange change(const nlohmann::json& words);

 private:
  scene::EditedScene edited_;  // lights and materials alone
  scene::Camera camera_;
  std::string name_;
  std::vector<std::string> material_names_;
  std::array<double, 3> origin_;
  std::uint32_t width_, height_;
  std::array<double, 3> centre_;
  double radius_;
};

}  // namespace gleaner::cli

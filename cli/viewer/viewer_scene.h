#pragma once
// What of a session's scene its page shows and changes, as it is by now: lights, materials, objects that may move, the
// camera.

#include <map>
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
  // `objects`: as SessionScene::objects.
  ViewerScene(const scene::Scene& scene, std::string name, const coordinator::FrameSettings& settings,
              const std::map<std::string, std::uint32_t>& objects = {});

  // name; size; lights (type, position in metres from `origin`, direction, intensity); materials (name, base_color,
  // emission); objects (name, position: of the middle of their bounds); camera (type, origin, right, up, forward,
  // half_width, half_height); centre and radius of the scene.
  nlohmann::json json() const;

  // The change that the page asks for: {"lights": [{"light", "position", "direction", "intensity"}], "materials":
  // [{"material", "base_color", "emission"}], "objects": [{"object", "position"}], "camera": {"origin", "forward",
  // "up"}}, of which all may be missing but light, material and object with its position. Throws Error::bad_input, and
  // changes nothing, for what it is not, or what the scene lacks.
  v1::SessionChange change(const nlohmann::json& words);

 private:
  struct Object {
    std::string name;
    std::uint32_t matrix = 0;
    scene::Triple rest{};  // the middle of its bounds in the scene as it was opened
  };

  scene::Triple position_of(const Object& object) const;
  scene::ObjectChange object_change(const nlohmann::json& words, v1::ObjectChange& out) const;

  scene::EditedScene edited_;  // without its geometry
  std::vector<Object> objects_;
  scene::Camera camera_;
  std::string name_;
  std::vector<std::string> material_names_;
  std::array<double, 3> origin_;
  std::uint32_t width_, height_;
  std::array<double, 3> centre_;
  double radius_;
};

}  // namespace gleaner::cli

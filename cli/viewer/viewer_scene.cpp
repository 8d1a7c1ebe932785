#include "cli/viewer/viewer_scene.h"

#include <algorithm>
#include <cmath>
#include <memory>
#include <optional>
#include <utility>

#include "coordinator/gateway/convert.h"
#include "scene/model/error.h"
#include "scene/model/instances.h"

namespace gleaner::cli {

namespace pb = gleaner::v1;
using nlohmann::json;
using scene::Triple;

namespace {

constexpr float farthest = 1e18f;  // that single precision still computes with

// All that changes are checked against.
std::shared_ptr<const scene::Scene> without_geometry(const scene::Scene& scene) {
  auto part = std::make_shared<scene::Scene>();
  part->rig.matrices = scene.rig.matrices;
  part->lights = scene.lights;
  part->materials = scene.materials;
  return part;
}

json array_of(const float (&values)[3]) { return {values[0], values[1], values[2]}; }

Error expected(const std::string& field, const std::string& what) { return Error::bad_input("change", field, what); }

std::optional<Triple> triple(const json& object, const char* field) {
  const auto at = object.find(field);
  if (at == object.end()) return std::nullopt;
  Triple values;
  if (!at->is_array() || at->size() != 3) throw expected(field, "three numbers");
  for (std::size_t k = 0; k < 3; ++k) {
    if (!(*at)[k].is_number()) throw expected(field, "three numbers");
    values[k] = (*at)[k].get<float>();
  }
  return values;
}

std::uint32_t index(const json& object, const char* field) {
  const auto at = object.is_object() ? object.find(field) : object.end();
  if (!object.is_object() || at == object.end() || !at->is_number_unsigned() || at->get<std::uint64_t>() > UINT32_MAX)
    throw expected(field, "a number of the scene's");
  return at->get<std::uint32_t>();
}

const json& list(const json& words, const char* field) {
  static const json none = json::array();
  const auto at = words.find(field);
  if (at == words.end()) return none;
  if (!at->is_array()) throw expected(field, "a list");
  return *at;
}

void set(pb::Vector3& to, const Triple& v) {
  to.set_x(v[0]);
  to.set_y(v[1]);
  to.set_z(v[2]);
}

Triple cross(const Triple& a, const Triple& b) {
  return {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
}

Triple unit(const Triple& v, const char* field) {
  const double length = std::hypot(double{v[0]}, double{v[1]}, double{v[2]});
  if (!(length > 1e-6 && length < farthest)) throw expected(field, "a vector of some length");
  return {static_cast<float>(v[0] / length), static_cast<float>(v[1] / length), static_cast<float>(v[2] / length)};
}

// `camera` at another place. The axes are made right-angled again.
void aim(scene::Camera& camera, const json& words) {
  if (!words.is_object()) throw expected("camera", "origin, forward and up");
  const auto origin = triple(words, "origin"), forward = triple(words, "forward"), up = triple(words, "up");
  if (!origin || !forward || !up) throw expected("camera", "origin, forward and up");
  for (const float x : *origin)
    if (!(std::abs(x) <= farthest)) throw expected("origin", "finite coordinates");
  const Triple ahead = unit(*forward, "forward");
  const Triple right = unit(cross(ahead, unit(*up, "up")), "up");
  const Triple above = unit(cross(right, ahead), "up");
  std::ranges::copy(*origin, camera.origin);
  std::ranges::copy(ahead, camera.forward);
  std::ranges::copy(right, camera.right);
  std::ranges::copy(above, camera.up);
}

std::array<double, 3> middle_of(const scene::Bounds& box) {
  std::array<double, 3> middle;
  for (std::size_t k = 0; k < 3; ++k) middle[k] = 0.5 * (double{box.lower[k]} + double{box.upper[k]});
  return middle;
}

scene::LightChange light_change(const json& words, pb::LightChange& out) {
  scene::LightChange change;
  change.light = index(words, "light");
  change.position = triple(words, "position");
  change.direction = triple(words, "direction");
  change.intensity = triple(words, "intensity");
  out.set_light(change.light);
  if (change.position) set(*out.mutable_position(), *change.position);
  if (change.direction) set(*out.mutable_direction(), *change.direction);
  if (change.intensity) set(*out.mutable_intensity(), *change.intensity);
  return change;
}

scene::MaterialChange material_change(const json& words, pb::MaterialChange& out) {
  scene::MaterialChange change;
  change.material = index(words, "material");
  change.base_color = triple(words, "base_color");
  change.emission = triple(words, "emission");
  out.set_material(change.material);
  if (change.base_color) set(*out.mutable_base_color(), *change.base_color);
  if (change.emission) set(*out.mutable_emission(), *change.emission);
  return change;
}

}  // namespace

ViewerScene::ViewerScene(const scene::Scene& scene, std::string name, const coordinator::FrameSettings& settings,
                         const std::map<std::string, std::uint32_t>& objects)
    : edited_(without_geometry(scene)),
      camera_(settings.camera),
      name_(std::move(name)),
      material_names_(scene.material_names),
      origin_(scene.origin),
      width_(settings.width),
      height_(settings.height) {
  const scene::Bounds bounds = scene::bounds_of(scene);
  centre_ = middle_of(bounds);
  double squared = 0;
  for (std::size_t k = 0; k < 3; ++k) squared += std::pow(0.5 * (double{bounds.upper[k]} - double{bounds.lower[k]}), 2);
  radius_ = std::sqrt(squared);
  for (const auto& [object, matrix] : objects) {
    const auto mesh = std::ranges::find(scene.meshes, object, &scene::Mesh::name);
    Object& added = objects_.emplace_back(object, matrix);
    std::ranges::transform(middle_of(scene::bounds_of(scene, *mesh)), added.rest.begin(),
                           [](double x) { return static_cast<float>(x); });
  }
}

Triple ViewerScene::position_of(const Object& object) const {
  Triple position = object.rest;
  for (std::size_t k = 0; k < 3; ++k)
    position[k] += static_cast<float>(edited_.state().matrices.at(object.matrix)[4 * k + 3]);
  return position;
}

scene::ObjectChange ViewerScene::object_change(const nlohmann::json& words, pb::ObjectChange& out) const {
  const std::uint32_t number = index(words, "object");
  if (number >= objects_.size())
    throw expected("object", "one of the " + std::to_string(objects_.size()) + " that may move");
  const Object& object = objects_[number];
  const auto position = triple(words, "position");
  if (!position) throw expected("position", "three numbers");
  scene::ObjectChange change;
  change.matrix = object.matrix;
  for (std::size_t k = 0; k < 3; ++k) {
    change.placement[5 * k] = 1;
    change.placement[4 * k + 3] = double{(*position)[k]} - object.rest[k];
  }
  out.set_matrix(change.matrix);
  for (const double value : change.placement) out.add_placement(value);
  return change;
}

json ViewerScene::json() const {
  constexpr const char* types[] = {"point", "spot", "directional"};
  nlohmann::json lights = nlohmann::json::array(), materials = nlohmann::json::array();
  for (const scene::Light& light : edited_.state().lights)
    lights.push_back({{"type", types[std::min<std::uint32_t>(light.type, 2)]},
                      {"position", array_of(light.position)},
                      {"direction", array_of(light.direction)},
                      {"intensity", array_of(light.intensity)}});
  for (std::size_t k = 0; k < edited_.state().materials.size(); ++k) {
    const scene::Material& material = edited_.state().materials[k];
    materials.push_back({{"name", k < material_names_.size() ? material_names_[k] : std::string()},
                         {"base_color", array_of(material.base_color)},
                         {"emission", array_of(material.emission)}});
  }
  nlohmann::json objects = nlohmann::json::array();
  for (const Object& object : objects_) objects.push_back({{"name", object.name}, {"position", position_of(object)}});
  return {{"name", name_},
          {"size", {width_, height_}},
          {"origin", origin_},
          {"centre", centre_},
          {"radius", radius_},
          {"lights", std::move(lights)},
          {"materials", std::move(materials)},
          {"objects", std::move(objects)},
          {"camera",
           {{"orthographic", camera_.type == GLEANER_CAMERA_ORTHOGRAPHIC},
            {"origin", array_of(camera_.origin)},
            {"right", array_of(camera_.right)},
            {"up", array_of(camera_.up)},
            {"forward", array_of(camera_.forward)},
            {"half_width", camera_.half_width},
            {"half_height", camera_.half_height}}}};
}

pb::SessionChange ViewerScene::change(const nlohmann::json& words) {
  if (!words.is_object()) throw Error::bad_input("change", "", "lights, materials, objects or a camera");
  pb::SessionChange out;
  scene::EditedScene edited = edited_;
  scene::Camera camera = camera_;
  for (const auto& light : list(words, "lights")) edited.apply(light_change(light, *out.add_lights()));
  for (const auto& material : list(words, "materials")) edited.apply(material_change(material, *out.add_materials()));
  for (const auto& object : list(words, "objects")) edited.apply(object_change(object, *out.add_objects()));
  if (const auto at = words.find("camera"); at != words.end()) {
    aim(camera, *at);
    *out.mutable_camera() = gateway::to_proto(camera);
  }
  edited_ = std::move(edited);
  camera_ = camera;
  return out;
}

}  // namespace gleaner::cli

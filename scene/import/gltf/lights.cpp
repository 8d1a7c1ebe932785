#include "scene/import/gltf/lights.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "scene/import/gltf/cameras.h"

namespace gleaner::scene::gltf {
namespace {

constexpr double kLumensPerWatt = 683;  // at 555 nm; what Blender's exporter multiplies watts by

// Below these no lamp of a lit scene is in photometric units: less than a tenth of a watt, less than a 30th of W/m^2.
constexpr double kDimCandela = 5, kDimLux = 20;

bool is_blender(const Element& root) {
  const auto generator = root.at("asset").find("generator");
  return generator && generator->json().is_string() && generator->text().find("Blender I/O") != std::string::npos;
}

}  // namespace

Lights::Lights(const Document& document, LightUnits units, Scene& scene, Warnings& warnings)
    : document_(document), scene_(scene), warnings_(warnings) {
  if (is_photometric(units)) watts_per_unit_ = 1 / kLumensPerWatt;
}

Element Lights::light(const Element& reference) const {
  const auto holder = document_.root().extension("KHR_lights_punctual");
  if (!holder) reference.fail("extensions.KHR_lights_punctual at the top of the file", "none");
  const Element lights = holder->at("lights");
  return lights[reference.index(lights.size())];
}

bool Lights::is_photometric(LightUnits units) const {
  const auto holder = document_.root().extension("KHR_lights_punctual");
  const auto lights = holder ? holder->find("lights") : std::nullopt;
  if (!lights || lights->size() == 0) return false;
  if (units != LightUnits::automatic) {
    scene_.light_units =
        units == LightUnits::photometric ? "photometric (--light-units)" : "radiometric (--light-units)";
    return units == LightUnits::photometric;
  }
  bool is_bright = false;
  for (std::size_t i = 0; i < lights->size(); ++i) {
    const Element each = (*lights)[i];
    const double intensity = each.factor("intensity", 1, kAnyNumber);
    is_bright |= intensity >= (each.at("type").text() == "directional" ? kDimLux : kDimCandela);
  }
  if (!is_blender(document_.root())) {
    scene_.light_units = "radiometric (as they stand)";
    return false;
  }
  if (!is_bright) {
    scene_.light_units = "radiometric (Blender's exporter, but too dim for candela and lux)";
    warnings_.add(
        "lights of Blender's exporter are too dim for candela and lux and were taken as W/sr and W/m^2: "
        "--light-units photometric divides them by 683");
    return false;
  }
  scene_.light_units = "photometric (Blender's exporter)";
  warnings_.add(
      "lights of Blender's exporter are candela and lux: divided by 683, watts as Blender has them "
      "(--light-units radiometric takes them as they stand)");
  return true;
}

void Lights::add(Nodes& nodes) {
  for (const std::size_t index : nodes.in_scene()) {
    const Element node = nodes.node(index);
    if (const auto light = node.extension("KHR_lights_punctual")) add(node, light->at("light"), nodes.to_world(index));
  }
}

void Lights::add_cone(const Element& cone, Light& light) {
  const double outer = cone.factor("outerConeAngle", std::numbers::pi / 4, std::numbers::pi / 2 + 1e-6);
  const double inner = cone.factor("innerConeAngle", 0, std::numbers::pi / 2 + 1e-6);
  if (!(inner <= outer)) cone.at("innerConeAngle").fail("at most the outerConeAngle");
  light.cos_inner = static_cast<float>(std::cos(inner));
  light.cos_outer = static_cast<float>(std::cos(outer));
}

void Lights::add(const Element& node, const Element& reference, const Matrix& to_world) {
  const Element element = light(reference);
  Light light{};
  store(relative(column(to_world, 3), scene_.origin), light.position);
  gl_float tint[3] = {1, 1, 1};
  element.colour("color", tint, kAnyNumber);
  const double intensity = element.factor("intensity", 1, kAnyNumber) * watts_per_unit_;
  for (int c = 0; c < 3; ++c) {
    if (!(tint[c] * intensity <= kAnyNumber))
      element.fail("a product of color and intensity that a float can hold", "more");
    light.intensity[c] = static_cast<float>(tint[c] * intensity);
  }
  const Vector forward = unit(column(to_world, 2));
  store({-forward[0], -forward[1], -forward[2]}, light.direction);
  const std::string type = element.at("type").text();
  if (type != "point" && dot(forward, forward) == 0) {
    warnings_.add(node.name(), "a light under a node scaled to 0 has no direction and was left out");
    return;
  }
  if (type == "directional") {
    light.type = GLEANER_LIGHT_DIRECTIONAL;
    std::fill(light.position, light.position + 3, 0.0f);
  } else if (type == "point" || type == "spot") {
    light.type = type == "point" ? GLEANER_LIGHT_POINT : GLEANER_LIGHT_SPOT;
    if (const auto range = element.find("range")) {
      light.range = static_cast<float>(range->number(0, kAnyNumber));
      if (!(light.range > 0)) range->fail("more than 0");
    }
  } else {
    element.at("type").fail("point, spot or directional");
  }
  if (type == "spot") {
    static const nlohmann::json defaults = nlohmann::json::object();
    add_cone(element.find("spot").value_or(Element(defaults, element.name() + ".spot", element.file())), light);
  }
  scene_.lights.push_back(light);
}

}  // namespace gleaner::scene::gltf

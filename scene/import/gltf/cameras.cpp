#include "scene/import/gltf/cameras.h"

#include <cmath>
#include <numbers>

namespace gleaner::scene::gltf {
namespace {

// The film that a camera or its node asks for in `extras`; what else people keep there is theirs.
void read_film(const Element& holder, NamedCamera& named) {
  const auto extras = holder.find("extras");
  if (!extras || !extras->is_object()) return;
  const auto width = extras->find("width"), height = extras->find("height");
  if (!width || !height || !width->is_number() || !height->is_number()) return;
  constexpr double most = 1u << 28;
  const double w = width->number(), h = height->number();
  if (!(w >= 1 && w <= most && h >= 1 && h <= most && w == std::floor(w) && h == std::floor(h))) return;
  named.width = static_cast<std::uint32_t>(w);
  named.height = static_cast<std::uint32_t>(h);
}

void read_lens(const Element& element, NamedCamera& named) {
  const std::string type = element.at("type").text();
  if (type == "perspective") {
    const Element lens = element.at("perspective");
    const double yfov = lens.at("yfov").number(0, kAnyNumber);
    if (!(yfov > 0 && yfov < std::numbers::pi)) lens.at("yfov").fail("radians between 0 and pi");
    const auto aspect = lens.find("aspectRatio");
    if (aspect && !(aspect->number(0, 1e6) > 0)) aspect->fail("more than 0");
    if (aspect) named.aspect = static_cast<float>(aspect->number(0, 1e6));
    if (named.aspect == 0 && named.width) named.aspect = static_cast<float>(double(named.width) / named.height);
    named.camera.type = GLEANER_CAMERA_PERSPECTIVE;
    named.camera.half_height = static_cast<float>(std::tan(yfov / 2));
    named.camera.half_width = named.camera.half_height * (named.aspect > 0 ? named.aspect : 1);
  } else if (type == "orthographic") {
    const Element lens = element.at("orthographic");
    for (const char* key : {"xmag", "ymag"})
      if (!(lens.at(key).number(-kAnyNumber, kAnyNumber) > 0)) lens.at(key).fail("more than 0");
    named.camera.type = GLEANER_CAMERA_ORTHOGRAPHIC;
    named.camera.half_width = static_cast<float>(lens.at("xmag").number());
    named.camera.half_height = static_cast<float>(lens.at("ymag").number());
    named.aspect = named.camera.half_width / named.camera.half_height;
  } else {
    element.at("type").fail("perspective or orthographic");
  }
}

}  // namespace

void add_cameras(const Document& document, Nodes& nodes, Scene& scene, Warnings& warnings) {
  for (const std::size_t index : nodes.in_scene()) {
    const Element node = nodes.node(index);
    const auto reference = node.find("camera");
    if (!reference) continue;
    const Element element = document.item("cameras", *reference);
    const Matrix& to_world = nodes.to_world(index);
    NamedCamera named;
    named.name = name_of(node, element, "camera " + std::to_string(scene.cameras.size()));
    const Vector forward = unit(column(to_world, 2));
    const Vector right = unit(cross(column(to_world, 1), forward));
    if (dot(right, right) == 0) {
      warnings.add(node.name(), "a camera under a node scaled to 0 sees nothing and was left out");
      continue;
    }
    store(relative(column(to_world, 3), scene.origin), named.camera.origin);
    store(right, named.camera.right);
    store(cross(forward, right), named.camera.up);
    store({-forward[0], -forward[1], -forward[2]}, named.camera.forward);
    for (const Element& holder : {element, node}) read_film(holder, named);
    read_lens(element, named);
    scene.cameras.push_back(std::move(named));
  }
}

}  // namespace gleaner::scene::gltf

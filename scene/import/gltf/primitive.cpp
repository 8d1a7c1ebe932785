#include "scene/import/gltf/primitive.h"

#include <algorithm>

namespace gleaner::scene::gltf {
namespace {

std::uint64_t mode_of(const Element& primitive) {
  const auto mode = primitive.find("mode");
  return mode ? mode->count(0, 6) : 4;
}

std::size_t count_of(const Document& document, const Element& reference) {
  return document.item("accessors", reference).at("count").count(1, 0xffffffffu);
}

std::size_t triangles_of(std::uint64_t mode, std::size_t corners) {
  if (corners < 3) return 0;
  return mode == 4 ? corners / 3 : corners - 2;
}

// "TEXCOORD_1" to 1; nothing for other words.
std::optional<std::size_t> set_of(const std::string& name) {
  constexpr std::string_view prefix = "TEXCOORD_";
  if (!name.starts_with(prefix) || name.size() != prefix.size() + 1) return std::nullopt;
  const char digit = name.back();
  if (digit < '0' || digit > '9') return std::nullopt;
  return static_cast<std::size_t>(digit - '0');
}

// Draco's values come as floats; joints are small whole numbers, which floats hold.
IndexView draco_joints(const DracoMesh::Attribute& attribute, const Element& reference) {
  if (attribute.components != 4) reference.fail("4 components", std::to_string(attribute.components));
  std::vector<std::uint32_t> joints;
  joints.reserve(attribute.values.size());
  for (const float value : attribute.values) {
    if (!(value >= 0 && value < 65536)) reference.fail("joints from 0 to 65535", std::to_string(value));
    joints.push_back(static_cast<std::uint32_t>(value));
  }
  return IndexView(std::move(joints), 4);
}

}  // namespace

PrimitiveSize size_of(const Document& document, const Element& primitive) {
  if (mode_of(primitive) < 4) return {};
  const auto position = primitive.at("attributes").find("POSITION");
  if (!position) return {};
  const std::size_t vertices = count_of(document, *position);
  const auto indices = primitive.find("indices");
  const std::size_t corners = indices ? count_of(document, *indices) : vertices;
  const std::size_t triangles = triangles_of(mode_of(primitive), corners);
  return {triangles, triangles == 0 ? 0 : std::min(vertices, corners)};
}

Primitive::Primitive(const Document& document, const Element& element, const std::vector<double>& weights,
                     DracoMeshes& decoded, Warnings& warnings)
    : document_(document), element_(element), warnings_(warnings), mode_(mode_of(element)) {
  const Element attributes = element_.at("attributes");
  if (element_.extension("KHR_draco_mesh_compression")) load_draco(decoded);
  if (draco_) {
    indices_.emplace(draco_->indices);
    mode_ = 4;
  } else if (const auto reference = element_.find("indices")) {
    indices_.emplace(accessor_of(document_, *reference, {"SCALAR"}), *reference);
  }
  position_ = *attribute(attributes, "POSITION", {"VEC3"});
  normal_ = attribute(attributes, "NORMAL", {"VEC3"});
  color_ = attribute(attributes, "COLOR_0", {"VEC3", "VEC4"});
  if (attributes.find("COLOR_1")) warnings_.add("further sets of vertex colours (COLOR_1) are not read");
  read_joints(attributes);
  read_targets(weights);
  const std::size_t corners = indices_ ? indices_->size() : vertices();
  if (mode_ == 4 && corners % 3 != 0)
    warnings_.add(element_.name(), std::to_string(corners) +
                                       " corners are no multiple of 3: what is left of the last triangle is not drawn");
}

void Primitive::load_draco(DracoMeshes& decoded) {
  const Element compression = *element_.extension("KHR_draco_mesh_compression");
  std::shared_ptr<const DracoMesh>& mesh = decoded[element_.name()];
  if (!mesh) {
    const std::size_t vertices = count_of(document_, element_.at("attributes").at("POSITION"));
    const auto indices = element_.find("indices");
    const std::size_t corners = indices ? count_of(document_, *indices) : vertices;
    mesh = std::make_shared<const DracoMesh>(draco_decoded(
        compression, document_.buffer_view(compression.at("bufferView")), vertices, triangles_of(mode_, corners)));
  }
  draco_ = mesh;
}

std::optional<FloatView> Primitive::attribute(const Element& attributes, const std::string& key,
                                              std::initializer_list<const char*> types) const {
  if (draco_)
    if (const auto found = draco_->attributes.find(key); found != draco_->attributes.end()) {
      const auto takes = [&](const char* type) { return type[3] == static_cast<char>('0' + found->second.components); };
      if (std::none_of(types.begin(), types.end(), takes))
        attributes.fail("another number of components of " + key, std::to_string(found->second.components));
      return FloatView(found->second.values, found->second.components);
    }
  const auto reference = attributes.find(key.c_str());
  if (!reference) return std::nullopt;
  FloatView view(accessor_of(document_, *reference, types));
  const std::size_t expected = key == "POSITION" && position_.size() == 0 ? view.size() : vertices();
  if (view.size() != expected)
    reference->fail("as many elements as POSITION: " + std::to_string(expected), std::to_string(view.size()));
  return view;
}

void Primitive::read_joints(const Element& attributes) {
  for (int set = 0;; ++set) {
    const std::string joints = "JOINTS_" + std::to_string(set), weights = "WEIGHTS_" + std::to_string(set);
    const auto reference = attributes.find(joints.c_str());
    if (!reference) return;
    auto weight = attribute(attributes, weights, {"VEC4"});
    if (!weight) attributes.fail(weights + " beside " + joints, "none");
    Influence influence{{}, std::move(*weight)};
    influence.joints = draco_ && draco_->attributes.contains(joints)
                           ? draco_joints(draco_->attributes.at(joints), *reference)
                           : IndexView(accessor_of(document_, *reference, {"VEC4"}), *reference);
    if (influence.joints.size() != vertices())
      reference->fail("as many elements as POSITION: " + std::to_string(vertices()),
                      std::to_string(influence.joints.size()));
    influences_.push_back(std::move(influence));
  }
}

void Primitive::read_targets(const std::vector<double>& weights) {
  const auto targets = element_.find("targets");
  for (std::size_t t = 0; targets && t < targets->size() && t < weights.size(); ++t) {
    if (weights[t] == 0) continue;
    const Element given = (*targets)[t];
    if (!given.is_object()) given.fail("an object");
    Target target{weights[t],
                  attribute(given, "POSITION", {"VEC3"}),
                  attribute(given, "NORMAL", {"VEC3"}),
                  attribute(given, "COLOR_0", {"VEC3", "VEC4"}),
                  {}};
    for (const auto& [name, unused] : given.json().items())
      if (const auto set = set_of(name)) target.uvs.emplace(*set, *attribute(given, name, {"VEC2"}));
    targets_.push_back(std::move(target));
  }
}

std::size_t Primitive::triangles() const { return triangles_of(mode_, indices_ ? indices_->size() : vertices()); }

std::array<std::uint32_t, 3> Primitive::triangle(std::size_t i) const {
  std::array<std::size_t, 3> at = {3 * i, 3 * i + 1, 3 * i + 2};
  if (mode_ == 5) at = {i, i + 1 + i % 2, i + 2 - i % 2};
  if (mode_ == 6) at = {i + 1, i + 2, 0};
  std::array<std::uint32_t, 3> corners;
  for (std::size_t k = 0; k < 3; ++k) {
    corners[k] = indices_ ? indices_->at(at[k]) : static_cast<std::uint32_t>(at[k]);
    if (corners[k] >= vertices())
      element_.at("indices").fail("vertices below " + std::to_string(vertices()),
                                  std::to_string(corners[k]) + " at index " + std::to_string(at[k]));
  }
  return corners;
}

namespace {

Vector vector_at(const FloatView& view, std::size_t v) {
  float p[3];
  view.load(v, p);
  return {p[0], p[1], p[2]};
}

}  // namespace

Vector Primitive::rest_position(std::size_t v) const { return vector_at(position_, v); }
Vector Primitive::rest_normal(std::size_t v) const { return vector_at(*normal_, v); }

std::size_t Primitive::targets() const {
  const auto targets = element_.find("targets");
  return targets ? targets->size() : 0;
}

std::optional<FloatView> Primitive::deltas(std::size_t target, const char* key) const {
  const Element given = element_.at("targets")[target];
  if (!given.is_object()) given.fail("an object");
  return attribute(given, key, {"VEC3"});
}

bool Primitive::morphs_looks() const {
  for (std::size_t t = 0; t < targets(); ++t) {
    const Element given = element_.at("targets")[t];
    for (const auto& [name, unused] : given.json().items())
      if (name == "COLOR_0" || set_of(name)) return true;
  }
  return false;
}

Vector Primitive::position(std::size_t v) const {
  Vector p = rest_position(v);
  for (const Target& target : targets_) {
    if (!target.position) continue;
    const Vector delta = vector_at(*target.position, v);
    for (int c = 0; c < 3; ++c) p[c] += target.weight * delta[c];
  }
  return p;
}

Vector Primitive::normal(std::size_t v) const {
  Vector n = rest_normal(v);
  for (const Target& target : targets_) {
    if (!target.normal) continue;
    const Vector delta = vector_at(*target.normal, v);
    for (int c = 0; c < 3; ++c) n[c] += target.weight * delta[c];
  }
  return n;
}

std::array<float, 4> Primitive::color(std::size_t v) const {
  std::array<float, 4> color{1, 1, 1, 1};
  color_->load(v, color.data());
  for (const Target& target : targets_) {
    if (!target.color) continue;
    float delta[4] = {};
    target.color->load(v, delta);
    for (std::size_t c = 0; c < 4; ++c) color[c] += static_cast<float>(target.weight * delta[c]);
  }
  return color;
}

std::optional<FloatView> Primitive::uvs(std::size_t set) const {
  return attribute(element_.at("attributes"), "TEXCOORD_" + std::to_string(set), {"VEC2"});
}

void Primitive::morph_uv(std::size_t set, std::size_t v, float (&uv)[2]) const {
  for (const Target& target : targets_) {
    const auto deltas = target.uvs.find(set);
    if (deltas == target.uvs.end()) continue;
    float delta[2];
    deltas->second.load(v, delta);
    for (int c = 0; c < 2; ++c) uv[c] += static_cast<float>(target.weight * delta[c]);
  }
}

}  // namespace gleaner::scene::gltf

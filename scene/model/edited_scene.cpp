#include "scene/model/edited_scene.h"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <utility>

#include "scene/model/error.h"

namespace gleaner::scene {
namespace {

constexpr Placement kUnmoved{1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0};
// Positions and intensities that single precision still computes with.
constexpr float kMost = 1e18f;

void check_index(const char* what, std::size_t index, std::size_t count) {
  if (index >= count)
    throw Error::bad_input("change", what, "below " + std::to_string(count) + ", those of the scene",
                           std::to_string(index));
}

void check_numbers(const char* what, const std::optional<Triple>& values, float least, float most) {
  if (!values) return;
  for (const float value : *values)
    if (!(value >= least && value <= most))
      throw Error::bad_input("change", what, "numbers from " + std::to_string(least) + " to " + std::to_string(most),
                             std::to_string(value));
}

void put(const std::optional<Triple>& values, float (&to)[3]) {
  if (values) std::ranges::copy(*values, to);
}

std::vector<std::uint32_t> all(std::size_t count) {
  std::vector<std::uint32_t> indices(count);
  std::iota(indices.begin(), indices.end(), 0u);
  return indices;
}

}  // namespace

EditedScene::EditedScene(std::shared_ptr<const Scene> base) : base_(std::move(base)) {
  state_.matrices.assign(base_->rig.matrices, kUnmoved);
  state_.morph_weights.assign(base_->rig.morph_weights, 0);
  state_.light_indices = all(base_->lights.size());
  state_.lights = base_->lights;
  state_.material_indices = all(base_->materials.size());
  state_.materials = base_->materials;
}

void EditedScene::apply(const LightChange& change) {
  check_index("light", change.light, state_.lights.size());
  check_numbers("position", change.position, -kMost, kMost);
  check_numbers("intensity", change.intensity, 0, kMost);
  std::optional<Triple> direction = change.direction;
  if (direction) {
    check_numbers("direction", direction, -kMost, kMost);
    const double length = std::hypot(double{(*direction)[0]}, double{(*direction)[1]}, double{(*direction)[2]});
    if (!(length > 0)) throw Error::bad_input("change", "direction", "a vector of some length", "none");
    for (float& x : *direction) x = static_cast<float>(x / length);
  }
  Light& light = state_.lights[change.light];
  put(change.position, light.position);
  put(direction, light.direction);
  put(change.intensity, light.intensity);
}

void EditedScene::apply(const MaterialChange& change) {
  check_index("material", change.material, state_.materials.size());
  check_numbers("base_color", change.base_color, 0, 1);
  check_numbers("emission", change.emission, 0, kMost);
  Material& material = state_.materials[change.material];
  put(change.base_color, material.base_color);
  put(change.emission, material.emission);
}

void EditedScene::apply(const ObjectChange& change) {
  check_index("object", change.matrix, state_.matrices.size());
  for (const double value : change.placement)
    if (!(std::abs(value) <= double{kMost}))
      throw Error::bad_input("change", "placement", "finite numbers", std::to_string(value));
  state_.matrices[change.matrix] = change.placement;
}

std::uint32_t make_movable(Scene& scene, const std::string& name) {
  const auto mesh = std::ranges::find(scene.meshes, name, &Mesh::name);
  if (mesh == scene.meshes.end()) {
    std::string known;
    for (const Mesh& one : scene.meshes) known += (known.empty() ? "" : ", ") + one.name;
    throw Error::bad_input(scene.name, "object \"" + name + "\"", "one of " + known);
  }
  if (mesh->instanced || mesh->deforming || mesh->triangle_count == 0)
    throw Error::bad_input(scene.name, "object \"" + name + "\"", "a mesh that stands still, stored once");
  const std::size_t corners = 3 * std::size_t{mesh->triangle_count}, first = scene.vertex_count();
  PosedMesh posed{};
  posed.first_triangle = mesh->first_triangle;
  posed.triangle_count = mesh->triangle_count;
  posed.first_vertex = static_cast<gl_uint>(first);
  posed.vertex_count = static_cast<gl_uint>(corners);
  posed.first_rest = static_cast<gl_uint>(scene.rig.positions.size() / 3);
  posed.first_weight = scene.rig.morph_weights;
  posed.first_matrix = scene.rig.matrices;
  posed.matrix_count = 1;
  for (std::size_t i = 0; i < corners; ++i) {
    std::uint32_t& index = scene.indices[3 * std::size_t{mesh->first_triangle} + i];
    const auto add_copy = [&](auto& values, std::size_t width) {
      if (values.empty()) return;
      values.reserve(values.size() + width);
      for (std::size_t c = 0; c < width; ++c) values.push_back(values[width * index + c]);
    };
    for (std::size_t c = 0; c < 3; ++c) {
      scene.rig.positions.push_back(scene.positions[3 * std::size_t{index} + c]);
      scene.rig.normals.push_back(scene.normals[3 * std::size_t{index} + c]);
    }
    add_copy(scene.positions, 3);
    add_copy(scene.normals, 3);
    add_copy(scene.uvs, 2);
    add_copy(scene.second_uvs, 2);
    add_copy(scene.colors, 4);
    index = static_cast<std::uint32_t>(first + i);
  }
  scene.rig.meshes.push_back(posed);
  mark_deforming(scene);
  return scene.rig.matrices++;
}

}  // namespace gleaner::scene

#include "coordinator/artifacts/scene_lineage.h"

#include <algorithm>
#include <array>
#include <cstring>
#include <span>
#include <vector>

#include "coordinator/blobs/sha256.h"

namespace gleaner::coordinator {
namespace {

template <typename... Values>
std::string digest_of(const std::vector<Values>&... values) {
  Sha256 hash;
  const auto add = [&](const auto& list) {
    // Behind its length, so that no two groups of lists give the same bytes.
    const std::string length = std::to_string(list.size()) + ":";
    hash.update(std::as_bytes(std::span(length)));
    hash.update(std::as_bytes(std::span(list)));
  };
  (add(values), ...);
  return hash.hex();
}

bool shines(const scene::Light& light) {
  return std::ranges::any_of(light.intensity, [](float channel) { return channel > 0; });
}

// Parts of a material, the others taken out.
scene::Material without_color_and_emission(scene::Material material) {
  std::ranges::fill(material.base_color, 0.0f);
  std::ranges::fill(material.emission, 0.0f);
  material.emission_texture = GLEANER_NONE;
  return material;
}
std::array<float, 3> color_of(const scene::Material& material) {
  return {material.base_color[0], material.base_color[1], material.base_color[2]};
}
struct Emission {
  std::array<float, 3> radiance;
  std::uint32_t texture;
};
Emission emission_of(const scene::Material& material) {
  return {{material.emission[0], material.emission[1], material.emission[2]}, material.emission_texture};
}
bool emits(const scene::Material& material) {
  return std::ranges::any_of(material.emission, [](float channel) { return channel > 0; });
}

// A digest of those parts of a state's materials or lights that are not the base's; empty where all are.
template <typename Record, typename PartOf>
std::string digest_of_changes(const std::vector<Record>& base, const std::vector<std::uint32_t>& indices,
                              const std::vector<Record>& shown, PartOf part_of) {
  using Part = decltype(part_of(base.front()));
  std::vector<std::uint32_t> changed;
  std::vector<Part> parts;
  for (std::size_t i = 0; i < shown.size(); ++i) {
    const Part part = part_of(shown[i]), before = part_of(base.at(indices[i]));
    if (std::memcmp(&part, &before, sizeof part) == 0) continue;
    changed.push_back(indices[i]);
    parts.push_back(part);
  }
  return changed.empty() ? std::string() : digest_of(changed, parts);
}

// Which lights shine, and which materials.
std::string shining_of(const scene::Scene& base, const scene::FrameState& state) {
  std::ptrdiff_t lights = std::ranges::count_if(base.lights, shines);
  for (std::size_t i = 0; i < state.lights.size(); ++i)
    lights += shines(state.lights[i]) - shines(base.lights.at(state.light_indices[i]));
  std::vector<std::uint32_t> others;  // materials that emit in one of both alone
  for (std::size_t i = 0; i < state.materials.size(); ++i)
    if (emits(state.materials[i]) != emits(base.materials.at(state.material_indices[i])))
      others.push_back(state.material_indices[i]);
  std::string shining = std::to_string(lights);
  if (!others.empty()) shining.append(" ").append(digest_of(others));
  return shining;
}

}  // namespace

SceneLineage lineage_of(const std::string& blob, const scene::Scene& base, const scene::FrameState& state) {
  SceneLineage lineage = blob;
  if (!state.matrices.empty() || !state.morph_weights.empty())
    lineage.geometry = digest_of(state.matrices, state.morph_weights);
  const auto of_materials = [&](auto part_of) {
    return digest_of_changes(base.materials, state.material_indices, state.materials, part_of);
  };
  lineage.materials = of_materials(without_color_and_emission);
  if (!state.albedo_tables.empty()) lineage.materials += digest_of(state.albedo_tables);
  lineage.colors = of_materials(color_of);
  lineage.emission = of_materials(emission_of);
  lineage.lights = digest_of_changes(base.lights, state.light_indices, state.lights,
                                     [](const scene::Light& light) { return light; });
  lineage.shining = shining_of(base, state);
  return lineage;
}

}  // namespace gleaner::coordinator

#include "coordinator/artifacts/scene_lineage.h"

#include <algorithm>
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

}  // namespace

SceneLineage lineage_of(const std::string& blob, const scene::Scene& base, const scene::FrameState& state) {
  SceneLineage lineage = blob;
  if (!state.matrices.empty() || !state.morph_weights.empty())
    lineage.geometry = digest_of(state.matrices, state.morph_weights);
  if (!state.materials.empty() || !state.albedo_tables.empty())
    lineage.materials = digest_of(state.material_indices, state.materials, state.albedo_tables);
  if (!state.lights.empty()) lineage.lights = digest_of(state.light_indices, state.lights);
  std::ptrdiff_t shining = std::ranges::count_if(base.lights, shines);
  for (std::size_t i = 0; i < state.lights.size(); ++i)
    shining += shines(state.lights[i]) - shines(base.lights.at(state.light_indices[i]));
  lineage.shining = std::to_string(shining);
  return lineage;
}

}  // namespace gleaner::coordinator

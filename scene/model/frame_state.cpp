#include "scene/model/frame_state.h"

#include <cmath>
#include <cstring>

#include "scene/model/error.h"
#include "scene/model/limits.h"
#include "scene/model/pose.h"
#include "scene/model/sections.h"

namespace gleaner::scene {
namespace {

std::string item(const char* array, std::size_t index) {
  return std::string(array) + "[" + std::to_string(index) + "]";
}

constexpr char kStateMagic[8] = {'G', 'L', 'F', 'R', 'A', 'M', 'E', 0};

enum StateSection : std::uint32_t {
  kMatrices,
  kMorphWeights,
  kLightIndices,
  kStateLights,
  kMaterialIndices,
  kStateMaterials,
  kStateAlbedoTables,
  kStateSections
};

void check_finite(double value, const std::string& origin, const char* array, std::size_t index) {
  if (!(std::abs(value) <= kMostPoseNumber))
    throw Error::bad_input(origin, item(array, index), "a finite value", std::to_string(value));
}

void check_indices(const std::vector<std::uint32_t>& indices, std::size_t records, const std::string& origin,
                   const char* array) {
  if (indices.size() != records)
    throw Error::bad_input(origin, array, std::to_string(indices.size()) + " records", std::to_string(records));
  for (std::size_t i = 1; i < indices.size(); ++i)
    if (indices[i] <= indices[i - 1])
      throw Error::bad_input(origin, item(array, i), "an index above " + std::to_string(indices[i - 1]),
                             std::to_string(indices[i]));
}

template <typename Record>
void replace(const std::vector<std::uint32_t>& indices, const std::vector<Record>& records, std::vector<Record>& in,
             const std::string& origin, const char* array) {
  for (std::size_t i = 0; i < indices.size(); ++i) {
    if (indices[i] >= in.size())
      throw Error::bad_input(origin, item(array, i), "an index below " + std::to_string(in.size()),
                             std::to_string(indices[i]));
    in[indices[i]] = records[i];
  }
}

void check_count(std::size_t found, std::size_t expected, const std::string& origin, const char* array) {
  if (found != expected)
    throw Error::bad_input(origin, array, std::to_string(expected) + ", as the base's rig", std::to_string(found));
}

template <typename Record>
void add_changes(const std::vector<Record>& base, const std::vector<Record>& shown, std::vector<std::uint32_t>& indices,
                 std::vector<Record>& records) {
  for (std::size_t i = 0; i < base.size(); ++i)
    if (std::memcmp(&base[i], &shown[i], sizeof base[i]) != 0) {
      indices.push_back(static_cast<std::uint32_t>(i));
      records.push_back(shown[i]);
    }
}

}  // namespace

Bytes serialize(const FrameState& state) {
  SectionWriter writer(kStateMagic, kStateSections);
  writer.add(kMatrices, state.matrices);
  writer.add(kMorphWeights, state.morph_weights);
  writer.add(kLightIndices, state.light_indices);
  writer.add(kStateLights, state.lights);
  writer.add(kMaterialIndices, state.material_indices);
  writer.add(kStateMaterials, state.materials);
  writer.add(kStateAlbedoTables, state.albedo_tables);
  return writer.finish();
}

FrameState parse_frame_state(std::span<const std::byte> bytes, const std::string& origin) {
  const SectionReader reader(bytes, kStateMagic, {kStateSections}, origin);
  FrameState state;
  state.matrices = reader.read<Placement>(kMatrices);
  state.morph_weights = reader.read<double>(kMorphWeights);
  state.light_indices = reader.read<std::uint32_t>(kLightIndices);
  state.lights = reader.read<Light>(kStateLights);
  state.material_indices = reader.read<std::uint32_t>(kMaterialIndices);
  state.materials = reader.read<Material>(kStateMaterials);
  state.albedo_tables = reader.read<float>(kStateAlbedoTables);
  for (std::size_t i = 0; i < state.matrices.size(); ++i)
    for (const double x : state.matrices[i]) check_finite(x, origin, "matrices", i);
  for (std::size_t i = 0; i < state.morph_weights.size(); ++i)
    check_finite(state.morph_weights[i], origin, "morph_weights", i);
  check_indices(state.light_indices, state.lights.size(), origin, "light_indices");
  check_indices(state.material_indices, state.materials.size(), origin, "material_indices");
  return state;
}

void check_counts(const FrameState& state, std::uint32_t matrices, std::uint32_t morph_weights,
                  const std::string& origin) {
  check_count(state.matrices.size(), matrices, origin, "matrices");
  check_count(state.morph_weights.size(), morph_weights, origin, "morph_weights");
}

Scene posed(const Scene& base, const FrameState& state, const std::string& origin) {
  check_counts(state, base.rig.matrices, base.rig.morph_weights, origin);
  Scene scene = base;
  scene.rig = {};
  for (const PosedMesh& mesh : base.rig.meshes) {
    const std::size_t first = 3 * std::size_t{mesh.first_vertex}, count = 3 * std::size_t{mesh.vertex_count};
    pose_mesh(base.rig, mesh, state, std::span(scene.positions).subspan(first, count),
              std::span(scene.normals).subspan(first, count));
  }
  replace(state.light_indices, state.lights, scene.lights, origin, "light_indices");
  replace(state.material_indices, state.materials, scene.materials, origin, "material_indices");
  if (!state.albedo_tables.empty()) scene.albedo_tables = state.albedo_tables;
  validate(scene, origin);
  return scene;
}

FrameState changes(const Scene& base, const Scene& shown) {
  FrameState state;
  add_changes(base.lights, shown.lights, state.light_indices, state.lights);
  add_changes(base.materials, shown.materials, state.material_indices, state.materials);
  if (shown.albedo_tables != base.albedo_tables) state.albedo_tables = shown.albedo_tables;
  return state;
}

}  // namespace gleaner::scene

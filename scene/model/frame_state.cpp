#include "scene/model/frame_state.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <thread>
#include <utility>

#include "scene/model/error.h"
#include "scene/model/instances.h"
#include "scene/model/limits.h"
#include "scene/model/pose.h"
#include "scene/model/sections.h"

namespace gleaner::scene {
namespace {

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

// Whether both states say the same of a mesh. `before` may be empty: nothing was shown.
bool is_same_pose(const PosedMesh& mesh, const FrameState& before, const FrameState& state) {
  if (before.matrices.size() != state.matrices.size()) return false;
  const auto same = [](const auto& a, const auto& b, std::size_t first, std::size_t count) {
    return count == 0 || std::memcmp(&a[first], &b[first], count * sizeof a[first]) == 0;
  };
  return same(before.matrices, state.matrices, mesh.first_matrix, mesh.matrix_count) &&
         same(before.morph_weights, state.morph_weights, mesh.first_weight, mesh.target_count);
}

// Calls `run(first, count)` for ranges that cover [0, count), in as many threads as are worth it.
template <typename Run>
void in_runs(std::size_t count, unsigned threads, const Run& run) {
  constexpr std::size_t kLeast = 4096;
  const std::size_t parts = std::clamp<std::size_t>(count / kLeast, 1, std::max(threads, 1u));
  std::vector<std::jthread> others;
  for (std::size_t i = 1; i < parts; ++i)
    others.emplace_back([&, i] { run(count * i / parts, count * (i + 1) / parts - count * i / parts); });
  run(0, count / parts);
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
  // A pointer to what the caller holds.
  PosedScene shown(std::shared_ptr<const Scene>(std::shared_ptr<void>(), &base));
  shown.show(state, origin);
  return std::move(shown).take();
}

PosedScene::PosedScene(std::shared_ptr<const Scene> base) : base_(std::move(base)) {
  mutable_ = std::make_shared<Scene>(*base_);
  mutable_->rig = {};
  shown_ = mutable_;
  if (!base_->rig.instances.empty()) instanced_boxes_ = boxes_of_instanced(*base_);
}

PosedScene::Changes PosedScene::show(const FrameState& state, const std::string& origin, unsigned threads) {
  const Scene& base = *base_;
  Scene& scene = *mutable_;
  check_counts(state, base.rig.matrices, base.rig.morph_weights, origin);
  const FrameState& before = state_ ? *state_ : state_.emplace();
  Changes changes;
  changes.meshes = pose(state, origin, threads);
  place(state, origin);
  changes.lights = before.light_indices != state.light_indices || !same_bytes(before.lights, state.lights);
  if (changes.lights) {
    scene.lights = base.lights;
    replace(state.light_indices, state.lights, scene.lights, origin, "light_indices");
    validate_lights(scene, origin);
  }
  changes.materials = before.material_indices != state.material_indices ||
                      !same_bytes(before.materials, state.materials) ||
                      !same_bytes(before.albedo_tables, state.albedo_tables);
  if (changes.materials) {
    scene.materials = base.materials;
    replace(state.material_indices, state.materials, scene.materials, origin, "material_indices");
    scene.albedo_tables = state.albedo_tables.empty() ? base.albedo_tables : state.albedo_tables;
    validate_materials(scene, origin);
  }
  state_ = state;
  return changes;
}

PosedScene::Changes PosedScene::show_rest() {
  Changes changes;
  if (!state_) return changes;
  for (const PosedMesh& mesh : base_->rig.meshes) {
    add_meshes_of(mesh, changes.meshes);
    const auto take_back = [&](const std::vector<float>& from, std::vector<float>& to) {
      if (!from.empty())
        std::copy_n(&from[std::size_t{3} * mesh.first_vertex], std::size_t{3} * mesh.vertex_count,
                    &to[std::size_t{3} * mesh.first_vertex]);
    };
    take_back(base_->positions, mutable_->positions);
    take_back(base_->normals, mutable_->normals);
  }
  mutable_->instances = base_->instances;
  mutable_->lights = base_->lights;
  mutable_->materials = base_->materials;
  mutable_->albedo_tables = base_->albedo_tables;
  changes.lights = changes.materials = true;
  state_.reset();
  return changes;
}

// The scene's meshes that hold a posed mesh's triangles, at the end of `moved`.
void PosedScene::add_meshes_of(const PosedMesh& mesh, std::vector<std::uint32_t>& moved) const {
  for (const std::uint32_t m : meshes_of(*base_, mesh))
    if (base_->meshes[m].triangle_count > 0 && (moved.empty() || moved.back() != m)) moved.push_back(m);
}

// A mesh's vertices follow from its matrices and weights: where these are what they were, it stands.
std::vector<std::uint32_t> PosedScene::pose(const FrameState& state, const std::string& origin, unsigned threads) {
  const Rig& rig = base_->rig;
  std::vector<std::uint32_t> moved;
  for (const PosedMesh& mesh : rig.meshes) {
    if (is_same_pose(mesh, *state_, state)) continue;
    add_meshes_of(mesh, moved);
    in_runs(mesh.vertex_count, threads, [&](std::size_t first, std::size_t count) {
      pose_vertices(rig, mesh, state, first, count, mutable_->positions, mutable_->normals);
    });
    validate_vertices(*mutable_, mesh.first_vertex, mesh.vertex_count, origin);
  }
  return moved;
}

void PosedScene::place(const FrameState& state, const std::string& origin) {
  for (const PosedInstance& posed : base_->rig.instances) {
    Instance& instance = mutable_->instances[posed.instance];
    Instance moved = instance;
    place_instance(state.matrices[posed.matrix].data(), moved.transform);
    if (std::memcmp(&moved, &instance, sizeof moved) == 0) continue;
    instance = moved;
    validate_placement(*mutable_, posed.instance, instanced_boxes_[moved.mesh], origin);
  }
}

FrameState changes(const Scene& base, const Scene& shown) {
  FrameState state;
  add_changes(base.lights, shown.lights, state.light_indices, state.lights);
  add_changes(base.materials, shown.materials, state.material_indices, state.materials);
  if (shown.albedo_tables != base.albedo_tables) state.albedo_tables = shown.albedo_tables;
  return state;
}

}  // namespace gleaner::scene

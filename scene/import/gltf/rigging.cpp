#include "scene/import/gltf/rigging.h"

#include <algorithm>
#include <cmath>

#include "scene/model/instances.h"
#include "scene/model/limits.h"
#include "scene/model/pose.h"

namespace gleaner::scene::gltf {
namespace {

std::string pointer_to(const char* array, std::size_t index) {
  return "/" + std::string(array).append("/") + std::to_string(index);
}

}  // namespace

Placement placement_of(const Matrix& m, const Point3& origin) {
  Placement rows;
  for (std::size_t r = 0; r < 3; ++r) {
    for (std::size_t c = 0; c < 4; ++c) rows[r * 4 + c] = m[c * 4 + r];
    rows[r * 4 + 3] -= origin[r];
  }
  return rows;
}

std::vector<double> morph_weights(const Document& document, std::size_t node) {
  const Element element = document.item("nodes", node);
  std::optional<Element> weights = element.find("weights");
  if (!weights) weights = document.item("meshes", element.at("mesh")).find("weights");
  std::vector<double> values;
  for (std::size_t i = 0; weights && i < weights->size(); ++i)
    values.push_back((*weights)[i].number(-kAnyNumber, kAnyNumber));
  return values;
}

Rigging::Rigging(const Document& document, const Animations& animations, bool is_base, Nodes& nodes, Scene& scene)
    : document_(document),
      animations_(animations),
      is_base_(is_base),
      rig_(scene.rig),
      moving_(document.size("nodes")),
      vanishing_(document.size("nodes")) {
  // Parents come before their children.
  for (const std::size_t node : nodes.in_scene()) {
    const std::string name = pointer_to("nodes", node);
    for (const char* path : {"/translation", "/rotation", "/scale"})
      if (animations_.animates(name + path)) moving_[node] = true;
    vanishing_[node] = animations_.may_vanish(name + "/scale", 1 / kMaxInstanceScale);
    const auto parent = nodes.parent(node);
    if (parent && moving_[*parent]) moving_[node] = true;
    if (parent && vanishing_[*parent]) vanishing_[node] = true;
  }
}

bool Rigging::has_moving_weights(std::size_t node) const {
  const Element element = document_.item("nodes", node);
  if (animations_.animates(pointer_to("nodes", node) + "/weights")) return true;
  const std::size_t mesh = element.at("mesh").index(document_.size("meshes"));
  return !element.find("weights") && animations_.animates(pointer_to("meshes", mesh) + "/weights");
}

bool Rigging::keeps_shape(std::size_t node) const { return !vanishing_[node] && !has_moving_weights(node); }

bool Rigging::may_be_instanced(const Material& material, std::size_t index) const {
  const std::string name = pointer_to("materials", index);
  for (const char* light : {"/emissiveFactor", "/extensions/KHR_materials_emissive_strength",
                            "/extensions/KHR_materials_transmission", "/extensions/KHR_materials_volume"})
    if (animations_.animates(name + light)) return false;
  // A solid of metal may become glass.
  if ((material.flags & GLEANER_MATERIAL_SOLID) && animations_.animates(name)) return false;
  return scene::may_be_instanced(material);
}

bool Rigging::is_posed(const Instance& instance, const Primitive& primitive) const {
  if (!is_base_) return false;
  if (primitive.targets() > 0 && has_moving_weights(instance.node)) return true;
  if (!instance.skin) return moving_[instance.node] && instance.instances.empty();
  return std::ranges::any_of(instance.skin->joints, [&](std::size_t joint) { return moving_[joint]; });
}

std::uint32_t Rigging::matrices_of(const Instance& instance) {
  auto& known = instance.skin ? matrices_of_skin_ : matrices_of_node_;
  const auto [place, is_new] = known.try_emplace(instance.skin ? instance.skin->index : instance.node, rig_.matrices);
  if (is_new) {
    matrices_.push_back(
        {instance.node, instance.skin ? std::vector<Matrix>{} : instance.locals, instance.skin, rig_.matrices});
    rig_.matrices += static_cast<std::uint32_t>(instance.skin ? instance.placements.size() : instance.locals.size());
  }
  return place->second;
}

std::uint32_t Rigging::weights_of(std::size_t node, std::uint32_t targets) {
  if (targets == 0) return 0;
  const auto [place, is_new] = weights_of_node_.try_emplace(node, rig_.morph_weights);
  if (is_new) {
    // Of the mesh's primitives all have as many targets; what a file says otherwise is bounded here.
    std::uint32_t most = targets;
    const Element primitives = document_.item("meshes", document_.item("nodes", node).at("mesh")).at("primitives");
    for (std::size_t p = 0; p < primitives.size(); ++p)
      if (const auto given = primitives[p].find("targets"))
        most = std::max(most, static_cast<std::uint32_t>(std::min<std::size_t>(given->size(), kMostPoseValues)));
    weights_.push_back({node, rig_.morph_weights, most});
    rig_.morph_weights += most;
  }
  return place->second;
}

std::uint32_t Rigging::add_deltas(const AddedPrimitive& added, std::size_t target, const char* attribute) {
  const std::optional<FloatView> deltas = added.primitive.deltas(target, attribute);
  if (!deltas) return GLEANER_NONE;
  const std::size_t first = rig_.deltas.size();
  if (first + 3 * std::size_t{added.vertex_count} >= GLEANER_NONE)
    added.primitive.element().at("targets").fail("at most 2^32 numbers of all morph targets", "more");
  rig_.deltas.resize(first + 3 * std::size_t{added.vertex_count});
  for (std::size_t i = 0; i < added.vertex_count; ++i) {
    const std::size_t vertex = added.kept.empty() ? i : added.kept[i];
    float* delta = &rig_.deltas[first + 3 * i];
    deltas->load(vertex, delta);
    for (std::size_t c = 0; c < 3; ++c)
      if (!std::isfinite(delta[c]))
        added.primitive.element().at("targets")[target].at(attribute).fail(
            "finite numbers", std::to_string(delta[c]) + " at vertex " + std::to_string(vertex));
  }
  return static_cast<std::uint32_t>(first);
}

void Rigging::add_influences(const AddedPrimitive& added) {
  for (std::size_t i = 0; i < added.vertex_count; ++i) {
    const std::size_t vertex = added.kept.empty() ? i : added.kept[i];
    added.primitive.each_influence(vertex, [&](std::uint32_t joint, float weight) {
      if (!(weight >= 0 && std::isfinite(weight)))
        added.primitive.element()
            .at("attributes")
            .at("WEIGHTS_0")
            .fail("finite weights of at least 0", std::to_string(weight) + " at vertex " + std::to_string(vertex));
      rig_.joints.push_back(weight != 0 ? joint : 0);
      rig_.joint_weights.push_back(weight);
    });
  }
}

Rigging::Rest Rigging::rest_of(const AddedPrimitive& added, bool skinned) {
  const Primitive& primitive = added.primitive;
  const auto [place, is_new] = rest_.try_emplace(primitive.element().name() + (skinned ? " skinned" : ""), Rest{});
  if (!is_new) return place->second;
  const std::size_t first = rig_.positions.size() / 3;
  place->second = {static_cast<std::uint32_t>(first), static_cast<std::uint32_t>(rig_.targets.size()),
                   static_cast<std::uint32_t>(rig_.joints.size())};
  rig_.positions.resize(3 * (first + added.vertex_count));
  rig_.normals.resize(rig_.positions.size());
  for (std::size_t i = 0; i < added.vertex_count; ++i) {
    const std::size_t v = added.kept.empty() ? i : added.kept[i];
    const Vector p = primitive.rest_position(v), n = primitive.has_normals() ? primitive.rest_normal(v) : Vector{};
    for (std::size_t c = 0; c < 3; ++c) {
      rig_.positions[3 * (first + i) + c] = static_cast<float>(p[c]);
      rig_.normals[3 * (first + i) + c] = static_cast<float>(n[c]);
    }
  }
  for (std::size_t t = 0; t < primitive.targets(); ++t) {
    MorphTarget target{};
    target.positions = add_deltas(added, t, "POSITION");
    target.normals = primitive.has_normals() ? add_deltas(added, t, "NORMAL") : GLEANER_NONE;
    rig_.targets.push_back(target);
  }
  if (skinned) add_influences(added);
  return place->second;
}

void Rigging::add(const Instance& instance, const AddedPrimitive& added) {
  const Primitive& primitive = added.primitive;
  const auto targets = static_cast<std::uint32_t>(primitive.targets());
  if (primitive.morphs_looks() && has_moving_weights(instance.node)) needs_own_scenes_ = true;
  const Rest rest = rest_of(added, instance.skin.has_value());
  PosedMesh mesh{};
  mesh.first_vertex = added.first_vertex;
  mesh.vertex_count = added.vertex_count;
  mesh.first_triangle = added.first_triangle;
  mesh.triangle_count = added.triangle_count;
  mesh.first_rest = rest.first_rest;
  mesh.first_target = rest.first_target;
  mesh.target_count = targets;
  mesh.first_weight = weights_of(instance.node, targets);
  mesh.first_matrix = matrices_of(instance) + (instance.skin ? 0 : static_cast<std::uint32_t>(added.local));
  mesh.matrix_count = instance.skin ? static_cast<std::uint32_t>(instance.placements.size()) : 1;
  mesh.influences = instance.skin ? static_cast<std::uint32_t>(primitive.influences()) : 0;
  mesh.first_influence = instance.skin ? rest.first_influence : 0;
  for (std::size_t i = mesh.first_influence;
       i < mesh.first_influence + std::size_t{mesh.influences} * mesh.vertex_count; ++i)
    if (rig_.joints[i] >= mesh.matrix_count)
      primitive.element()
          .at("attributes")
          .at("JOINTS_0")
          .fail("joints below " + std::to_string(mesh.matrix_count), std::to_string(rig_.joints[i]));
  rig_.meshes.push_back(mesh);
  mirrored_.push_back(added.mirrored);
}

void Rigging::add_instances(const Instance& instance, std::uint32_t first) {
  if (!is_base_ || !moving_[instance.node]) return;
  const std::uint32_t matrix = matrices_of(instance);
  for (std::uint32_t i = 0; i < instance.locals.size(); ++i) rig_.instances.push_back({first + i, matrix + i});
}

bool Rigging::pose(Nodes& nodes, const Scene& base, FrameState& state) const {
  state.matrices.assign(base.rig.matrices, Placement{});
  state.morph_weights.assign(base.rig.morph_weights, 0.0);
  for (const Matrices& run : matrices_) {
    const std::size_t count = run.skin ? run.skin->joints.size() : run.locals.size();
    for (std::size_t i = 0; i < count; ++i) {
      const Matrix m = run.skin ? product(nodes.to_world(run.skin->joints[i]), run.skin->binds[i])
                                : product(nodes.to_world(run.node), run.locals[i]);
      if (!is_finite(m)) nodes.node(run.skin ? run.skin->joints[i] : run.node).fail("a finite transform", "another");
      state.matrices[run.first + i] = placement_of(m, base.origin);
    }
  }
  for (const Weights& run : weights_) {
    const std::vector<double> weights = morph_weights(document_, run.node);
    std::copy_n(weights.begin(), std::min<std::size_t>(weights.size(), run.count),
                state.morph_weights.begin() + run.first);
  }
  for (std::size_t i = 0; i < mirrored_.size(); ++i) {
    const PosedMesh& mesh = base.rig.meshes[i];
    const std::size_t vertex = base.indices[3 * std::size_t{mesh.first_triangle}] - mesh.first_vertex;
    if (is_mirror(placement_at(base.rig, mesh, state, vertex)) != mirrored_[i]) return false;
  }
  for (const PosedInstance& posed : base.rig.instances) {
    gl_float transform[12];
    place_instance(state.matrices[posed.matrix].data(), transform);
    if (refused_transform(transform)) return false;
  }
  return true;
}

}  // namespace gleaner::scene::gltf

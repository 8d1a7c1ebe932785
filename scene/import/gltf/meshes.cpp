#include "scene/import/gltf/meshes.h"

#include <algorithm>
#include <cmath>
#include <numeric>

#include "scene/model/instances.h"
#include "scene/model/limits.h"

namespace gleaner::scene::gltf {
namespace {

// Calls with(view) for the buffer views that a primitive's accessors name: of its corners, or of its vertices.
template <typename With>
void each_view(const Document& document, const Element& primitive, bool corners, const With& with) {
  const std::size_t views = document.size("bufferViews");
  const auto accessor = [&](const Element& reference) {
    const Element element = document.item("accessors", reference);
    if (const auto view = element.find("bufferView")) with(view->index(views));
    if (const auto sparse = element.find("sparse"))
      for (const char* part : {"indices", "values"}) with(sparse->at(part).at("bufferView").index(views));
  };
  if (corners) {
    if (const auto indices = primitive.find("indices")) accessor(*indices);
    return;
  }
  const auto all_of = [&](const Element& attributes) {
    for (const auto& [name, unused] : attributes.json().items()) accessor(attributes.at(name.c_str()));
  };
  all_of(primitive.at("attributes"));
  const auto targets = primitive.find("targets");
  for (std::size_t t = 0; targets && t < targets->size(); ++t) all_of((*targets)[t]);
}

std::size_t vertex_at(const std::vector<std::uint32_t>& kept, std::size_t i) { return kept.empty() ? i : kept[i]; }

// The vertices that triangles name, in order, where those are few: files may share one long accessor among many
// primitives. Empty: all of them.
std::vector<std::uint32_t> kept_vertices(const Primitive& primitive) {
  std::vector<std::uint32_t> kept;
  if (primitive.vertices() <= 3 * primitive.triangles()) return kept;
  for (std::size_t i = 0; i < primitive.triangles(); ++i)
    for (const std::uint32_t corner : primitive.triangle(i)) kept.push_back(corner);
  std::sort(kept.begin(), kept.end());
  kept.erase(std::unique(kept.begin(), kept.end()), kept.end());
  if (kept.size() == primitive.vertices()) kept.clear();
  return kept;
}

scene::Instance instance_at(const Matrix& placement, const Point3& origin, std::uint32_t mesh) {
  scene::Instance instance{};
  instance.mesh = mesh;
  place_instance(placement_of(placement, origin).data(), instance.transform);
  return instance;
}

// Whether it may place an instance, wherever that stands.
bool places_instance(const Matrix& placement) {
  return !refused_transform(instance_at(placement, column(placement, 3), 0).transform);
}

std::uint16_t to_16_bits(float x) { return static_cast<std::uint16_t>(std::lround(std::clamp(x, 0.0f, 1.0f) * 65535)); }

}  // namespace

Element Meshes::mesh_of(const Instance& instance) const {
  return document_.item("meshes", nodes_.node(instance.node).at("mesh"));
}

Box Meshes::place() {
  for (const std::size_t index : nodes_.in_scene()) place_node(index);
  if (may_instance_) choose_instanced();
  for (const Instance& instance : instances_) total_ = counted(instance, total_);
  Box all;
  for (const Instance& instance : instances_) {
    const Element primitives = mesh_of(instance).at("primitives");
    for (std::size_t p = 0; p < primitives.size(); ++p) {
      if (size_of(document_, primitives[p]).triangles == 0) continue;
      const Primitive primitive(document_, primitives[p], morph_weights(document_, instance.node), draco_meshes_,
                                warnings_);
      count_uses(primitives[p]);
      all.enclose(box_of(primitive, instance));
    }
  }
  return all;
}

void Meshes::place_node(std::size_t index) {
  const Element node = nodes_.node(index);
  const auto reference = node.find("mesh");
  if (!reference) return;
  const Element mesh = document_.item("meshes", *reference);
  Instance instance{index, {kIdentity}, {}, {}, {}, false};
  if (const auto skin = node.find("skin")) {
    instance.skin = skin_of(*skin);
    for (std::size_t j = 0; j < instance.skin->joints.size(); ++j)
      instance.placements.push_back(product(nodes_.to_world(instance.skin->joints[j]), instance.skin->binds[j]));
  } else {
    if (const auto instancing = node.extension("EXT_mesh_gpu_instancing")) instance.locals = repeated(*instancing);
    for (const Matrix& local : instance.locals) instance.placements.push_back(product(nodes_.to_world(index), local));
  }
  for (const Matrix& placement : instance.placements)
    if (!is_finite(placement)) node.fail("finite transforms", "another");
  instances_.push_back(std::move(instance));
}

// A mesh may stand under many nodes; those that show it in one shape at all times may share it.
void Meshes::choose_instanced() {
  std::map<std::string, std::vector<Instance*>> by_mesh;
  for (Instance& instance : instances_)
    if (!instance.skin && !nodes_.node(instance.node).find("weights") && rigging_.keeps_shape(instance.node))
      by_mesh[mesh_of(instance).name()].push_back(&instance);
  std::size_t total = 0;
  for (const auto& [name, nodes] : by_mesh) {
    const bool shared = pays(nodes);
    const bool moving = std::ranges::any_of(nodes, [&](const Instance* node) { return rigging_.moves(node->node); });
    if (!(shared || moving) || !may_be_instanced(mesh_of(*nodes.front()))) continue;
    bool is_stored = false;
    for (Instance* node : nodes) {
      const bool moves = rigging_.moves(node->node);
      // What moves follows its node as instances alone, or as copies alone.
      if (moves ? !std::ranges::all_of(node->placements, places_instance) : !shared) continue;
      std::vector<Matrix> copies;
      for (const Matrix& m : node->placements) (places_instance(m) ? node->instances : copies).push_back(m);
      node->placements = std::move(copies);
      node->stores_mesh = !is_stored && !node->instances.empty();
      is_stored = is_stored || node->stores_mesh;
      total += node->instances.size();
      if (total > kMaxInstances)
        nodes_.node(node->node).fail("at most " + std::to_string(kMaxInstances) + " instances in all", "more");
    }
  }
}

bool Meshes::may_be_instanced(const Element& mesh) {
  const Element primitives = mesh.at("primitives");
  std::size_t triangles = 0;
  for (std::size_t p = 0; p < primitives.size(); ++p) {
    const std::size_t count = size_of(document_, primitives[p]).triangles;
    triangles += count;
    if (count == 0) continue;
    const std::uint32_t material = materials_.material_of(primitives[p], variant_);
    if (!rigging_.may_be_instanced(scene_.materials[material], material)) return false;
  }
  return triangles > 0;
}

// `nodes`: of one mesh.
bool Meshes::pays(const std::vector<Instance*>& nodes) const {
  const Element primitives = mesh_of(*nodes.front()).at("primitives");
  std::size_t triangles = 0, places = 0;
  for (const Instance* node : nodes)
    places += static_cast<std::size_t>(std::ranges::count_if(node->placements, places_instance));
  for (std::size_t p = 0; p < primitives.size(); ++p) triangles += size_of(document_, primitives[p]).triangles;
  return places >= 2 && triangles >= kLeastInstancedTriangles && (places - 1) * triangles >= kLeastSparedTriangles;
}

// EXT_mesh_gpu_instancing: each instance's transform, which comes before the node's.
std::vector<Matrix> Meshes::repeated(const Element& instancing) const {
  const Element attributes = instancing.at("attributes");
  // All attributes say how many instances there are, also those of whoever wrote the file (_ID).
  std::size_t count = 0;
  for (const auto& [key, value] : attributes.json().items()) {
    const Element reference = attributes.at(key.c_str());
    const std::size_t here = document_.item("accessors", reference).at("count").count(1, 0xffffffffu);
    if (here > kMaxInstances)
      reference.fail("at most " + std::to_string(kMaxInstances) + " instances", std::to_string(here));
    if (count != 0 && here != count)
      attributes.fail("as many elements in each: " + std::to_string(count), std::to_string(here));
    count = here;
  }
  if (count == 0) return {kIdentity};
  const auto view = [&](const char* key, const char* type) -> std::optional<FloatView> {
    const auto reference = attributes.find(key);
    if (!reference) return std::nullopt;
    return FloatView(accessor_of(document_, *reference, {type}));
  };
  const auto translation = view("TRANSLATION", "VEC3"), rotation = view("ROTATION", "VEC4"),
             scale = view("SCALE", "VEC3");
  std::vector<Matrix> placements;
  for (std::size_t i = 0; i < count; ++i) {
    float values[3][4] = {{0, 0, 0, 0}, {0, 0, 0, 1}, {1, 1, 1, 0}};
    if (translation) translation->load(i, values[0]);
    if (rotation) rotation->load(i, values[1]);
    if (scale) scale->load(i, values[2]);
    const std::array<double, 3> t{values[0][0], values[0][1], values[0][2]},
        s{values[2][0], values[2][1], values[2][2]};
    const std::array<double, 4> r{values[1][0], values[1][1], values[1][2], values[1][3]};
    placements.push_back(composed(t.data(), r.data(), s.data()));
    if (!is_finite(placements.back())) attributes.fail("finite transforms", "another of instance " + std::to_string(i));
  }
  return placements;
}

// A joint's inverse bind matrix comes before its world transform; the skinned node's own transform does not count (glTF
// 2.0, 3.7.3.3).
Skin Meshes::skin_of(const Element& reference) const {
  const Element element = document_.item("skins", reference), joints = element.at("joints");
  Skin skin{reference.index(document_.size("skins")), {}, {}};
  std::optional<FloatView> inverse;
  if (const auto given = element.find("inverseBindMatrices")) {
    inverse.emplace(accessor_of(document_, *given, {"MAT4"}));
    if (inverse->size() < joints.size())
      given->fail("a matrix for each of " + std::to_string(joints.size()) + " joints", std::to_string(inverse->size()));
  }
  if (joints.size() == 0) joints.fail("at least one joint", "none");
  for (std::size_t j = 0; j < joints.size(); ++j) {
    skin.joints.push_back(joints[j].index(document_.size("nodes")));
    Matrix bind = kIdentity;
    if (inverse) {
      float values[16];
      inverse->load(j, values);
      std::copy(values, values + 16, bind.begin());
      bind[3] = bind[7] = bind[11] = 0;  // exporters' rounding; a bind matrix is affine
      bind[15] = 1;
    }
    if (!is_finite(bind))
      element.at("inverseBindMatrices").fail("finite matrices", "another of joint " + std::to_string(j));
    skin.binds.push_back(bind);
  }
  return skin;
}

void Meshes::count_uses(const Element& primitive) {
  uses_of_view_.resize(document_.size("bufferViews"));
  for (const bool corners : {false, true})
    each_view(document_, primitive, corners, [&](std::size_t view) { ++uses_of_view_[view]; });
}

// A file's memory goes as the scene's comes.
void Meshes::release(const Element& primitive, bool corners) {
  each_view(document_, primitive, corners, [&](std::size_t view) {
    if (--uses_of_view_[view] == 0) document_.release(view, uses_of_view_);
  });
}

Box Meshes::box_of(const Primitive& primitive, const Instance& instance) {
  Box box;
  if (instance.skin) {
    for (std::size_t v = 0; v < primitive.vertices(); ++v)
      box.add(transformed(skinned(primitive, instance, v), primitive.position(v)));
    return box;
  }
  const std::string& name = primitive.element().name();
  const auto [place, is_new] = box_of_primitive_.try_emplace(name);
  Box& local = place->second;
  // A node's own weights of morph targets may make another shape of it.
  if (is_new || nodes_.node(instance.node).find("weights")) {
    local = {};
    for (std::size_t v = 0; v < primitive.vertices(); ++v) local.add(primitive.position(v));
    warn_of_coarse_floats(local, name, "the file's coordinates", warnings_);
  }
  if (local.empty()) return box;
  for (const std::vector<Matrix>* placements : {&instance.placements, &instance.instances})
    for (const Matrix& placement : *placements)
      for (int corner = 0; corner < 8; ++corner) {
        const auto side = [&](int c) { return corner >> c & 1 ? local.upper[c] : local.lower[c]; };
        box.add(transformed(placement, {side(0), side(1), side(2)}));
      }
  return box;
}

// Adds an instance's size to `total`, or fails where that is too much.
PrimitiveSize Meshes::counted(const Instance& instance, PrimitiveSize total) const {
  const Element primitives = mesh_of(instance).at("primitives");
  const std::size_t times = instance.skin ? 1 : instance.placements.size() + (instance.stores_mesh ? 1 : 0);
  for (std::size_t p = 0; p < primitives.size(); ++p) {
    const PrimitiveSize size = size_of(document_, primitives[p]);
    total.triangles += times * size.triangles;
    total.vertices += times * size.vertices;
    if (total.triangles > kMaxTriangles)
      primitives[p].fail("at most " + std::to_string(kMaxTriangles) + " triangles in all", "more");
    if (total.vertices > kMaxVertices)
      primitives[p].fail("at most " + std::to_string(kMaxVertices) + " vertices in all", "more");
  }
  return total;
}

void Meshes::add() {
  scene_.positions.reserve(3 * total_.vertices);
  scene_.normals.reserve(3 * total_.vertices);
  if (materials_.needs_channel(0)) scene_.uvs.reserve(2 * total_.vertices);
  if (materials_.needs_channel(1)) scene_.second_uvs.reserve(2 * total_.vertices);
  scene_.indices.reserve(3 * total_.triangles);
  scene_.triangle_material.reserve(total_.triangles);
  for (const Instance& instance : instances_) add_instance(instance);
  const bool all_white = std::all_of(scene_.colors.begin(), scene_.colors.end(), [](auto c) { return c == 65535; });
  if (all_white) std::vector<std::uint16_t>().swap(scene_.colors);
}

void Meshes::add_instance(const Instance& instance) {
  const bool has_copies = instance.skin || !instance.placements.empty();
  if (instance.stores_mesh) {
    add_mesh(instance, true, !has_copies);
    stored_meshes_[mesh_of(instance).name()] = static_cast<std::uint32_t>(scene_.meshes.size() - 1);
  }
  if (has_copies) add_mesh(instance, false, true);
  if (instance.instances.empty()) return;
  const std::uint32_t mesh = stored_meshes_.at(mesh_of(instance).name());
  rigging_.add_instances(instance, static_cast<std::uint32_t>(scene_.instances.size()));
  for (const Matrix& placement : instance.instances)
    scene_.instances.push_back(instance_at(placement, scene_.origin, mesh));
  if (instance.stores_mesh || has_copies) return;
  const Element primitives = mesh_of(instance).at("primitives");
  for (std::size_t p = 0; p < primitives.size(); ++p)
    for (const bool corners : {false, true})
      if (size_of(document_, primitives[p]).triangles > 0) release(primitives[p], corners);
}

void Meshes::add_mesh(const Instance& instance, bool in_own_space, bool is_last) {
  const Element mesh = mesh_of(instance), primitives = mesh.at("primitives");
  const std::size_t first = scene_.triangle_count();
  for (std::size_t p = 0; p < primitives.size(); ++p) {
    const Element element = primitives[p];
    const auto mode = element.find("mode");
    if (mode && mode->count(0, 6) < 4) {
      warnings_.add(element.name(), "points and lines are not drawn");
      continue;
    }
    if (!element.at("attributes").find("POSITION")) {
      warnings_.add(element.name(), "a primitive without POSITION is not drawn");
      continue;
    }
    if (size_of(document_, element).triangles == 0) continue;
    const Primitive primitive(document_, element, morph_weights(document_, instance.node), draco_meshes_, warnings_);
    if (instance.skin && !primitive.has_joints())
      warnings_.add(element.name(), "under a skin but without JOINTS_0: it stands where its node does");
    if (!instance.skin && primitive.has_joints())
      warnings_.add(element.name(), "JOINTS_0 without a skin: it stands where its node does");
    const std::uint32_t material = materials_.material_of(element, variant_);
    if (instance.skin && primitive.has_joints())
      add_primitive(primitive, material, instance, 0, scene_.origin, true);
    else if (instance.skin)
      add_primitive(primitive, material, {instance.node, {kIdentity}, {}, {nodes_.to_world(instance.node)}, {}, false},
                    0, scene_.origin, true);
    else if (in_own_space)
      add_primitive(primitive, material, {instance.node, {kIdentity}, {}, {kIdentity}, instance.instances, true}, 0, {},
                    is_last);
    else
      for (std::size_t i = 0; i < instance.placements.size(); ++i)
        add_primitive(primitive, material, instance, i, scene_.origin, i + 1 == instance.placements.size());
  }
  const std::size_t count = scene_.triangle_count() - first;
  if (count == 0) return;
  const Element node = nodes_.node(instance.node);
  Mesh added{in_own_space ? name_of(mesh, node, mesh.name()) : name_of(node, mesh, mesh.name()), std::uint32_t(first),
             std::uint32_t(count)};
  added.instanced = in_own_space;
  scene_.meshes.push_back(std::move(added));
}

void Meshes::add_primitive(const Primitive& primitive, std::uint32_t material, const Instance& instance,
                           std::size_t local, const Point3& origin, bool is_last) {
  const std::vector<std::uint32_t> kept = kept_vertices(primitive);
  const std::size_t count = kept.empty() ? primitive.vertices() : kept.size();
  const auto first = static_cast<std::uint32_t>(scene_.vertex_count());
  const auto first_triangle = static_cast<std::uint32_t>(scene_.triangle_count());
  const Matrix placement =
      instance.skin ? skinned(primitive, instance, primitive.triangle(0)[0]) : instance.placements[local];
  const bool mirrored = is_mirror(placement);
  add_vertices(primitive, kept, count, instance, placement, origin);
  add_colors(primitive, kept, count);
  if (materials_.needs_channel(0)) add_uvs(primitive, kept, count, material, 0, scene_.uvs);
  if (materials_.needs_channel(1)) add_uvs(primitive, kept, count, material, 1, scene_.second_uvs);
  if (rigging_.is_posed(instance, primitive))
    rigging_.add(instance, {primitive, kept, local, first, static_cast<std::uint32_t>(count), first_triangle,
                            static_cast<std::uint32_t>(primitive.triangles()), mirrored});
  if (is_last) release(primitive.element(), false);
  add_triangles(primitive, kept, first, mirrored);
  if (is_last) release(primitive.element(), true);
  scene_.triangle_material.resize(scene_.triangle_count(), material);
}

// A transform that mirrors turns triangles inside out; swapping two corners keeps the front in front.
void Meshes::add_triangles(const Primitive& primitive, const std::vector<std::uint32_t>& kept, std::uint32_t first,
                           bool mirrored) {
  for (std::size_t i = 0; i < primitive.triangles(); ++i) {
    std::array<std::uint32_t, 3> corners = primitive.triangle(i);
    if (mirrored) std::swap(corners[1], corners[2]);
    for (std::uint32_t corner : corners) {
      if (!kept.empty())
        corner = static_cast<std::uint32_t>(std::lower_bound(kept.begin(), kept.end(), corner) - kept.begin());
      scene_.indices.push_back(first + corner);
    }
  }
}

Matrix Meshes::skinned(const Primitive& primitive, const Instance& instance, std::size_t vertex) const {
  Matrix sum{};
  double weights = 0;
  primitive.each_joint(vertex, [&](std::uint32_t joint, double weight) {
    if (joint >= instance.placements.size())
      primitive.element()
          .at("attributes")
          .at("JOINTS_0")
          .fail("joints below " + std::to_string(instance.placements.size()),
                std::to_string(joint) + " at vertex " + std::to_string(vertex));
    for (std::size_t i = 0; i < 16; ++i) sum[i] += weight * instance.placements[joint][i];
    weights += weight;
  });
  if (!(weights > 0) || !is_finite(sum)) {
    warnings_.add(primitive.element().name(), "vertices whose skin weights do not add up follow the first joint");
    return instance.placements.empty() ? kIdentity : instance.placements.front();
  }
  for (double& x : sum) x /= weights;
  return sum;
}

void Meshes::add_vertices(const Primitive& primitive, const std::vector<std::uint32_t>& kept, std::size_t count,
                          const Instance& instance, const Matrix& placement, const Point3& origin) {
  const Element attributes = primitive.element().at("attributes");
  const bool moved_by_skin = instance.skin.has_value();
  Matrix m = placement;
  NormalTransform turn(m);
  bool has_zero = false;
  for (std::size_t i = 0; i < count; ++i) {
    const std::size_t v = vertex_at(kept, i);
    if (moved_by_skin) {
      m = skinned(primitive, instance, v);
      turn = NormalTransform(m);
    }
    Vector p = transformed(m, primitive.position(v));
    for (int c = 0; c < 3; ++c) {
      p[c] -= origin[c];
      if (!(std::abs(p[c]) <= kMaxCoordinate))
        attributes.at("POSITION")
            .fail("finite coordinates within 1e9 m of the scene's centre",
                  std::to_string(p[c]) + " at vertex " + std::to_string(v));
      scene_.positions.push_back(static_cast<float>(p[c]));
    }
    if (!primitive.has_normals()) continue;
    const Vector n = primitive.normal(v);
    for (const double c : n)
      if (!std::isfinite(c))
        attributes.at("NORMAL").fail("finite normals", std::to_string(c) + " at vertex " + std::to_string(v));
    const Vector world = turn(n);
    has_zero |= dot(world, world) == 0;
    for (const double c : world) scene_.normals.push_back(static_cast<float>(c));
  }
  scene_.normals.resize(scene_.positions.size());
  if (has_zero)
    warnings_.add(attributes.name() + ".NORMAL", "normals of length 0 are replaced by those of the triangles");
}

void Meshes::add_colors(const Primitive& primitive, const std::vector<std::uint32_t>& kept, std::size_t count) {
  if (!primitive.has_colors()) {
    // White, once a primitive before had colours.
    if (!scene_.colors.empty()) scene_.colors.resize(4 * scene_.vertex_count(), 65535);
    return;
  }
  scene_.colors.resize(4 * (scene_.vertex_count() - count), 65535);
  for (std::size_t i = 0; i < count; ++i) {
    const std::size_t v = vertex_at(kept, i);
    for (const float c : primitive.color(v)) {
      if (!std::isfinite(c))
        primitive.element()
            .at("attributes")
            .at("COLOR_0")
            .fail("finite colours", "another at vertex " + std::to_string(v));
      if (c < 0 || c > 1) warnings_.add(primitive.element().name(), "vertex colours outside 0 to 1 are clamped");
      scene_.colors.push_back(to_16_bits(c));
    }
  }
}

void Meshes::add_uvs(const Primitive& primitive, const std::vector<std::uint32_t>& kept, std::size_t count,
                     std::uint32_t material, std::size_t channel, std::vector<float>& to) {
  const std::optional<UvSource>& source = materials_.uvs(material).channels[channel];
  const std::optional<FloatView> values = source ? primitive.uvs(source->set) : std::nullopt;
  if (!values) {
    if (source)
      warnings_.add(primitive.element().name() + ".attributes",
                    "no TEXCOORD_" + std::to_string(source->set) +
                        " for a material with textures or anisotropy: a texture's corner is taken, and any direction");
    to.resize(2 * scene_.vertex_count());
    return;
  }
  const double cosine = std::cos(source->rotation), sine = std::sin(source->rotation);
  for (std::size_t i = 0; i < count; ++i) {
    const std::size_t v = vertex_at(kept, i);
    float pair[2];
    values->load(v, pair);
    primitive.morph_uv(source->set, v, pair);
    if (!source->is_plain()) {
      const double u = source->scale[0] * pair[0], w = source->scale[1] * pair[1];
      pair[0] = static_cast<float>(cosine * u + sine * w + source->offset[0]);
      pair[1] = static_cast<float>(-sine * u + cosine * w + source->offset[1]);
    }
    for (const float c : pair) {
      if (!std::isfinite(c))
        primitive.element()
            .at("attributes")
            .at(("TEXCOORD_" + std::to_string(source->set)).c_str())
            .fail("finite coordinates", std::to_string(c) + " at vertex " + std::to_string(v));
      to.push_back(c);
    }
  }
}

}  // namespace gleaner::scene::gltf

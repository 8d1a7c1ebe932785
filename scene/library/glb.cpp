// Binary glTF 2.0: a JSON chunk and one buffer. Everything stands in world space; one node a mesh, light and camera. Of
// instanced meshes, which stand in their own space, one node an instance. What moves hangs from the nodes of a motion,
// each of which stands at its pivot.

#include <fcntl.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <filesystem>
#include <limits>
#include <map>
#include <memory>
#include <nlohmann/json.hpp>
#include <optional>
#include <set>
#include <span>
#include <system_error>

#include "scene/images/write.h"
#include "scene/library/library.h"
#include "scene/model/error.h"

namespace gleaner::scene {
namespace {

using Json = nlohmann::ordered_json;

enum : int {
  kFloat = 5126,
  kUnsignedInt = 5125,
  kUnsignedShort = 5123,
  kArrayBuffer = 34962,
  kElementArrayBuffer = 34963,
  kLinear = 9729
};

[[noreturn]] void cannot_write(const std::string& path, const std::string& why) {
  throw Error::failed(path + ": cannot be written: " + why);
}

// A file that appears under its name when commit() returns, whole and on disk; without commit() it leaves nothing.
class AtomicFile {
 public:
  explicit AtomicFile(const std::string& path) : path_(path), temporary_(path + ".part" + std::to_string(getpid())) {}
  AtomicFile(const AtomicFile&) = delete;
  AtomicFile& operator=(const AtomicFile&) = delete;
  ~AtomicFile() {
    if (!committed_) unlink(temporary_.c_str());
  }

  const std::string& temporary() const { return temporary_; }

  void commit() {
    sync(temporary_, O_RDONLY);
    if (rename(temporary_.c_str(), path_.c_str()) != 0) fail();
    committed_ = true;
    const std::string folder = std::filesystem::path(path_).parent_path().string();
    sync(folder.empty() ? "." : folder, O_RDONLY | O_DIRECTORY);
  }

  [[noreturn]] void fail() const { cannot_write(path_, std::generic_category().message(errno)); }

 private:
  void sync(const std::string& name, int flags) const {
    const int file = open(name.c_str(), flags | O_CLOEXEC);
    if (file < 0) fail();
    const int result = fsync(file);
    const int error = errno;
    close(file);
    errno = error;
    if (result != 0) fail();
  }

  std::string path_, temporary_;
  bool committed_ = false;
};

// The radiometric values of glTF are a colour of at most 1 and a strength. A power of two as strength loses no bit.
struct ColourAndStrength {
  Json colour;
  float strength;
};

ColourAndStrength split(const float value[3]) {
  const float largest = std::max({value[0], value[1], value[2]});
  float strength = 1;
  while (strength < largest) strength *= 2;
  return {Json::array({value[0] / strength, value[1] / strength, value[2] / strength}), strength};
}

Json numbers(const float* values, std::size_t count) { return Json(std::vector<float>(values, values + count)); }

class GlbWriter {
 public:
  GlbWriter(const Scene& scene, const Motion& motion, const std::string& path)
      : scene_(scene), motion_(motion), path_(path), instances_of_(scene.meshes.size()) {
    for (const Instance& instance : scene.instances) instances_of_[instance.mesh].push_back(&instance);
  }

  void write() {
    json_["asset"] = {{"version", "2.0"}, {"generator", "Gleaner"}};
    json_["scene"] = 0;
    json_["scenes"] = Json::array({Json{{"name", scene_.name}}});
    for (const MotionNode& node : motion_.nodes) add_motion_node(node);
    for (std::size_t i = 0; i < scene_.meshes.size(); ++i) add_mesh(i);
    add_textures();
    for (std::size_t i = 0; i < scene_.materials.size(); ++i) add_material(i);
    for (const Light& light : scene_.lights) add_light(light);
    for (std::size_t i = 0; i < scene_.cameras.size(); ++i) add_camera(i);
    add_animation();
    finish();
  }

 private:
  // Views begin at multiples of 4: PNGs may end anywhere, what follows them must not.
  std::size_t add_view(const void* data, std::size_t bytes, std::optional<int> target = {}) {
    buffer_.resize((buffer_.size() + 3) / 4 * 4);
    Json view{{"buffer", 0}, {"byteOffset", buffer_.size()}, {"byteLength", bytes}};
    if (target) view["target"] = *target;
    const auto* first = static_cast<const std::byte*>(data);
    buffer_.insert(buffer_.end(), first, first + bytes);
    return add("bufferViews", std::move(view));
  }

  template <class T>
  std::size_t add_accessor(const std::vector<T>& values, int components, const char* type,
                           std::optional<int> target = {}) {
    constexpr int component_type = std::is_same_v<T, float>           ? kFloat
                                   : std::is_same_v<T, std::uint16_t> ? kUnsignedShort
                                                                      : kUnsignedInt;
    return add("accessors", {{"bufferView", add_view(values.data(), values.size() * sizeof(T), target)},
                             {"componentType", component_type},
                             {"count", values.size() / static_cast<std::size_t>(components)},
                             {"type", type}});
  }

  // glTF demands the bounds of positions and of times.
  std::size_t add_bounded(const std::vector<float>& values, std::size_t components, const char* type,
                          std::optional<int> target = {}) {
    const std::size_t accessor = add_accessor(values, static_cast<int>(components), type, target);
    std::vector<float> lower(values.begin(), values.begin() + static_cast<std::ptrdiff_t>(components)), upper = lower;
    for (std::size_t i = 0; i < values.size(); ++i) {
      lower[i % components] = std::min(lower[i % components], values[i]);
      upper[i % components] = std::max(upper[i % components], values[i]);
    }
    json_["accessors"][accessor]["min"] = lower;
    json_["accessors"][accessor]["max"] = upper;
    return accessor;
  }

  // Returns the new element's index.
  std::size_t add(const char* array, Json element) {
    json_[array].push_back(std::move(element));
    return json_[array].size() - 1;
  }

  std::size_t add_node(Json node) {
    const std::size_t index = add("nodes", std::move(node));
    json_["scenes"][0]["nodes"].push_back(index);
    return index;
  }

  // Stands in world space as every node, but moves with the motion node that `carriers` names for it, if any.
  void add_carried(Json node, const std::map<std::size_t, std::uint32_t>& carriers, std::size_t number) {
    const auto carrier = carriers.find(number);
    if (carrier == carriers.end()) {
      add_node(std::move(node));
      return;
    }
    // Takes the pivot back, exactly: what is carried keeps its place in the world.
    const std::array<float, 3>& pivot = motion_.nodes[carrier->second].pivot;
    const std::size_t index = add("nodes", std::move(node));
    const std::size_t back = add("nodes", {{"translation", {-pivot[0], -pivot[1], -pivot[2]}}, {"children", {index}}});
    json_["nodes"][motion_nodes_[carrier->second]]["children"].push_back(back);
  }

  std::array<float, 3> rest_of(const MotionNode& node) const {
    std::array<float, 3> rest = node.pivot;
    if (node.parent >= 0)
      for (std::size_t c = 0; c < 3; ++c) rest[c] -= motion_.nodes[static_cast<std::size_t>(node.parent)].pivot[c];
    return rest;
  }

  void add_motion_node(const MotionNode& node) {
    Json json{{"name", node.name}, {"translation", rest_of(node)}};
    if (node.parent < 0) {
      motion_nodes_.push_back(add_node(std::move(json)));
      return;
    }
    motion_nodes_.push_back(add("nodes", std::move(json)));
    json_["nodes"][motion_nodes_[static_cast<std::size_t>(node.parent)]]["children"].push_back(motion_nodes_.back());
  }

  std::size_t add_skin(const MotionSkin& skin) {
    std::vector<float> inverse_binds;
    Json joints = Json::array();
    for (const std::uint32_t joint : skin.joints) {
      const std::array<float, 3>& p = motion_.nodes[joint].pivot;
      const float matrix[16] = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, -p[0], -p[1], -p[2], 1};
      inverse_binds.insert(inverse_binds.end(), matrix, matrix + 16);
      joints.push_back(motion_nodes_[joint]);
    }
    return add("skins", {{"joints", joints}, {"inverseBindMatrices", add_accessor(inverse_binds, 16, "MAT4")}});
  }

  void add_channel(const Keys& keys, std::size_t node, const char* path, int components, const char* type) {
    if (keys.times.empty()) return;
    const std::size_t input = add_bounded(keys.times, 1, "SCALAR"),
                      output = add_accessor(keys.values, components, type);
    channels_.push_back({{"sampler", samplers_of_keys_.size()}, {"target", {{"node", node}, {"path", path}}}});
    samplers_of_keys_.push_back(
        {{"input", input},
         {"output", output},
         {"interpolation", keys.interpolation == Interpolation::linear ? "LINEAR" : "CUBICSPLINE"}});
  }

  void add_animation() {
    for (std::size_t i = 0; i < motion_.nodes.size(); ++i) {
      const MotionNode& node = motion_.nodes[i];
      Keys placed = node.moved;
      const std::array<float, 3> rest = rest_of(node);
      const bool spline = placed.interpolation == Interpolation::cubic_spline;
      for (std::size_t k = 0; k < placed.values.size(); ++k)
        if (!spline || k / 3 % 3 == 1) placed.values[k] += rest[k % 3];  // tangents stay
      add_channel(placed, motion_nodes_[i], "translation", 3, "VEC3");
      add_channel(node.turned, motion_nodes_[i], "rotation", 4, "VEC4");
    }
    for (const auto& [mesh, morph] : motion_.morphs)
      add_channel(morph.weights, mesh_nodes_.at(mesh), "weights", 1, "SCALAR");
    if (!channels_.empty())
      add("animations", {{"name", scene_.name}, {"channels", channels_}, {"samplers", samplers_of_keys_}});
  }

  bool has_normals(std::size_t triangle) const {
    for (int corner = 0; corner < 3; ++corner) {
      const float* n = &scene_.normals[3 * std::size_t{scene_.indices[3 * triangle + corner]}];
      if (n[0] != 0 || n[1] != 0 || n[2] != 0) return true;
    }
    return false;
  }

  // A primitive for every run of triangles of one material that all have normals, or all lack them.
  void add_mesh(std::size_t number) {
    const Mesh& mesh = scene_.meshes[number];
    if (mesh.triangle_count == 0) return;
    Json primitives = Json::array();
    const std::size_t end = std::size_t{mesh.first_triangle} + mesh.triangle_count;
    for (std::size_t first = mesh.first_triangle; first < end;) {
      const std::uint32_t material = scene_.triangle_material[first];
      const bool normals = has_normals(first);
      std::size_t last = first + 1;
      while (last < end && scene_.triangle_material[last] == material && has_normals(last) == normals) ++last;
      primitives.push_back(primitive(first, last, material, normals));
      add_deformation(number, used_vertices(first, last), primitives.back());
      first = last;
    }
    Json json{{"name", mesh.name}, {"primitives", primitives}};
    Json node{{"name", mesh.name}};
    if (const auto skin = motion_.skins.find(number); skin != motion_.skins.end())
      node["skin"] = add_skin(skin->second);
    if (const auto morph = motion_.morphs.find(number); morph != motion_.morphs.end()) {
      json["weights"] = std::vector<float>(morph->second.positions.size());
      mesh_nodes_[number] = json_["nodes"].size();
    }
    const std::size_t written = add("meshes", std::move(json));
    node["mesh"] = written;
    if (!mesh.instanced) add_carried(std::move(node), motion_.meshes, number);
    for (const Instance* instance : instances_of_[number]) {
      const gl_float* t = instance->transform;
      const float x[3] = {t[0], t[4], t[8]}, y[3] = {t[1], t[5], t[9]}, z[3] = {t[2], t[6], t[10]},
                  origin[3] = {t[3], t[7], t[11]};
      add_node({{"name", mesh.name}, {"mesh", written}, {"matrix", matrix(x, y, z, origin)}});
    }
  }

  // The vertices in use, in the scene's order, so that a reader gets the scene's arrays back.
  std::vector<std::uint32_t> used_vertices(std::size_t first, std::size_t last) const {
    const std::span<const std::uint32_t> corners(&scene_.indices[3 * first], 3 * (last - first));
    const auto [least, greatest] = std::minmax_element(corners.begin(), corners.end());
    std::vector<bool> is_used(std::size_t{*greatest - *least} + 1);
    for (const std::uint32_t corner : corners) is_used[corner - *least] = true;
    std::vector<std::uint32_t> used;
    for (std::size_t i = 0; i < is_used.size(); ++i)
      if (is_used[i]) used.push_back(static_cast<std::uint32_t>(*least + i));
    return used;
  }

  void add_deformation(std::size_t mesh, const std::vector<std::uint32_t>& vertices, Json& primitive) {
    const auto first = *std::min_element(&scene_.indices[3 * std::size_t{scene_.meshes[mesh].first_triangle}],
                                         &scene_.indices[3 * std::size_t{scene_.meshes[mesh].first_triangle}] +
                                             3 * std::size_t{scene_.meshes[mesh].triangle_count});
    if (const auto skin = motion_.skins.find(mesh); skin != motion_.skins.end()) {
      std::vector<std::uint16_t> joints;
      std::vector<float> weights;
      for (const std::uint32_t v : vertices) {
        const MotionSkin::Influence& influence = skin->second.influences[v - first];
        joints.insert(joints.end(), {influence.joints[0], influence.joints[1], 0, 0});
        weights.insert(weights.end(), {influence.weights[0], influence.weights[1], 0, 0});
      }
      primitive["attributes"]["JOINTS_0"] = add_accessor(joints, 4, "VEC4", kArrayBuffer);
      primitive["attributes"]["WEIGHTS_0"] = add_accessor(weights, 4, "VEC4", kArrayBuffer);
    }
    const auto morph = motion_.morphs.find(mesh);
    if (morph == motion_.morphs.end()) return;
    const auto of_vertices = [&](const std::vector<float>& all) {
      std::vector<float> some;
      for (const std::uint32_t v : vertices)
        some.insert(some.end(), &all[3 * std::size_t{v - first}], &all[3 * std::size_t{v - first}] + 3);
      return some;
    };
    for (std::size_t t = 0; t < morph->second.positions.size(); ++t)
      primitive["targets"].push_back(
          {{"POSITION", add_bounded(of_vertices(morph->second.positions[t]), 3, "VEC3", kArrayBuffer)},
           {"NORMAL", add_accessor(of_vertices(morph->second.normals[t]), 3, "VEC3", kArrayBuffer)}});
  }

  Json primitive(std::size_t first, std::size_t last, std::uint32_t material, bool with_normals) {
    const std::span<const std::uint32_t> corners(&scene_.indices[3 * first], 3 * (last - first));
    std::vector<float> positions, normals, uvs;
    const std::vector<std::uint32_t> vertices = used_vertices(first, last);
    for (const std::size_t v : vertices) {
      positions.insert(positions.end(), &scene_.positions[3 * v], &scene_.positions[3 * v] + 3);
      if (with_normals) normals.insert(normals.end(), &scene_.normals[3 * v], &scene_.normals[3 * v] + 3);
      if (!scene_.uvs.empty()) uvs.insert(uvs.end(), &scene_.uvs[2 * v], &scene_.uvs[2 * v] + 2);
    }
    std::vector<std::uint32_t> number(std::size_t{vertices.back() - vertices.front()} + 1);
    for (std::uint32_t i = 0; i < vertices.size(); ++i) number[vertices[i] - vertices.front()] = i;
    std::vector<std::uint32_t> indices;
    indices.reserve(corners.size());
    for (const std::uint32_t corner : corners) indices.push_back(number[corner - vertices.front()]);

    const std::size_t position = add_bounded(positions, 3, "VEC3", kArrayBuffer);
    Json attributes{{"POSITION", position}};
    if (with_normals) attributes["NORMAL"] = add_accessor(normals, 3, "VEC3", kArrayBuffer);
    if (!uvs.empty()) attributes["TEXCOORD_0"] = add_accessor(uvs, 2, "VEC2", kArrayBuffer);
    return {{"attributes", attributes},
            {"indices", add_accessor(indices, 1, "SCALAR", kElementArrayBuffer)},
            {"material", material}};
  }

  void add_textures() {
    std::map<std::array<std::uint32_t, 3>, std::size_t> images;
    std::map<std::array<std::uint32_t, 2>, std::size_t> samplers;
    constexpr int wrap[] = {10497, 33071, 33648};  // repeat, clamp, mirror
    for (const Texture& t : scene_.textures) {
      const auto [image, new_image] = images.try_emplace({t.first_texel, t.width, t.height}, images.size());
      if (new_image) {
        const std::vector<unsigned char> bytes = png(t);
        add("images", {{"bufferView", add_view(bytes.data(), bytes.size())}, {"mimeType", "image/png"}});
      }
      const auto [sampler, new_sampler] = samplers.try_emplace({t.wrap_u, t.wrap_v}, samplers.size());
      if (new_sampler)
        add("samplers",
            {{"magFilter", kLinear}, {"minFilter", kLinear}, {"wrapS", wrap[t.wrap_u]}, {"wrapT", wrap[t.wrap_v]}});
      add("textures", {{"sampler", sampler->second}, {"source", image->second}});
    }
  }

  std::vector<unsigned char> png(const Texture& t) const {
    try {
      return png_bytes(t.width, t.height,
                       std::span(scene_.texels).subspan(t.first_texel, std::size_t{t.width} * t.height));
    } catch (const Error& error) {
      cannot_write(path_, error.what());
    }
  }

  void use(const char* extension) { extensions_.insert(extension); }

  static void set_texture(Json& object, const char* key, std::uint32_t texture) {
    if (texture != GLEANER_NONE) object[key] = {{"index", texture}};
  }

  void add_material(std::size_t index) {
    const Material& m = scene_.materials[index];
    Json pbr{{"baseColorFactor", {m.base_color[0], m.base_color[1], m.base_color[2], m.alpha}},
             {"metallicFactor", m.metallic},
             {"roughnessFactor", m.roughness}};
    set_texture(pbr, "baseColorTexture", m.base_color_texture);
    set_texture(pbr, "metallicRoughnessTexture", m.metallic_roughness_texture);
    Json json{{"name", scene_.material_names[index]}, {"pbrMetallicRoughness", pbr}};
    if (m.normal_texture != GLEANER_NONE)
      json["normalTexture"] = {{"index", m.normal_texture}, {"scale", m.normal_scale}};
    if (m.flags & GLEANER_MATERIAL_ALPHA_BLEND) json["alphaMode"] = "BLEND";
    if (m.flags & GLEANER_MATERIAL_ALPHA_MASK) {
      json["alphaMode"] = "MASK";
      json["alphaCutoff"] = m.alpha_cutoff;
    }

    Json extensions = Json::object();
    const bool emits = m.emission[0] > 0 || m.emission[1] > 0 || m.emission[2] > 0;
    if (emits) {
      const auto [colour, strength] = split(m.emission);
      json["emissiveFactor"] = colour;
      if (strength > 1) extensions["KHR_materials_emissive_strength"]["emissiveStrength"] = strength;
    }
    set_texture(json, "emissiveTexture", m.emission_texture);
    // An emitter that shines from its front alone has one side.
    json["doubleSided"] = !emits || (m.flags & GLEANER_MATERIAL_DOUBLE_SIDED);

    Json specular = Json::object();
    if (m.specular != 1) specular["specularFactor"] = m.specular;
    if (m.specular_color[0] != 1 || m.specular_color[1] != 1 || m.specular_color[2] != 1)
      specular["specularColorFactor"] = numbers(m.specular_color, 3);
    set_texture(specular, "specularTexture", m.specular_texture);
    set_texture(specular, "specularColorTexture", m.specular_color_texture);
    if (!specular.empty()) extensions["KHR_materials_specular"] = specular;
    if (m.ior != 1.5f) extensions["KHR_materials_ior"]["ior"] = m.ior;
    if (m.transmission != 0 || m.transmission_texture != GLEANER_NONE) {
      Json transmission{{"transmissionFactor", m.transmission}};
      set_texture(transmission, "transmissionTexture", m.transmission_texture);
      extensions["KHR_materials_transmission"] = transmission;
    }
    if (m.flags & GLEANER_MATERIAL_SOLID) {
      // The surface is a closed mesh: its thickness only has to differ from 0.
      Json volume{{"thicknessFactor", 1}};
      const double most = std::max({m.attenuation[0], m.attenuation[1], m.attenuation[2]});
      if (most > 0) {
        volume["attenuationDistance"] = 1 / most;
        for (float a : m.attenuation) volume["attenuationColor"].push_back(std::exp(-a / most));
      }
      extensions["KHR_materials_volume"] = volume;
    }
    if (m.diffuse_transmission > 0) {
      Json shining{{"diffuseTransmissionFactor", m.diffuse_transmission},
                   {"diffuseTransmissionColorFactor", numbers(m.diffuse_transmission_color, 3)}};
      set_texture(shining, "diffuseTransmissionTexture", m.diffuse_transmission_texture);
      set_texture(shining, "diffuseTransmissionColorTexture", m.diffuse_transmission_color_texture);
      extensions["KHR_materials_diffuse_transmission"] = shining;
    }
    add_layers(m, extensions);
    if (m.flags & GLEANER_MATERIAL_UNLIT) extensions["KHR_materials_unlit"] = Json::object();
    if (!extensions.empty()) json["extensions"] = extensions;
    for (const auto& [name, value] : extensions.items()) use(name.c_str());
    add("materials", std::move(json));
  }

  // Coat, sheen, grain and film, where there is one.
  static void add_layers(const Material& m, Json& extensions) {
    if (m.clearcoat > 0) {
      Json coat{{"clearcoatFactor", m.clearcoat}, {"clearcoatRoughnessFactor", m.clearcoat_roughness}};
      set_texture(coat, "clearcoatTexture", m.clearcoat_texture);
      set_texture(coat, "clearcoatRoughnessTexture", m.clearcoat_roughness_texture);
      if (m.clearcoat_normal_texture != GLEANER_NONE)
        coat["clearcoatNormalTexture"] = {{"index", m.clearcoat_normal_texture}, {"scale", m.clearcoat_normal_scale}};
      extensions["KHR_materials_clearcoat"] = coat;
    }
    if (*std::max_element(m.sheen_color, m.sheen_color + 3) > 0) {
      Json sheen{{"sheenColorFactor", numbers(m.sheen_color, 3)}, {"sheenRoughnessFactor", m.sheen_roughness}};
      set_texture(sheen, "sheenColorTexture", m.sheen_color_texture);
      set_texture(sheen, "sheenRoughnessTexture", m.sheen_roughness_texture);
      extensions["KHR_materials_sheen"] = sheen;
    }
    if (m.anisotropy > 0) {
      Json grain{{"anisotropyStrength", m.anisotropy}, {"anisotropyRotation", m.anisotropy_rotation}};
      set_texture(grain, "anisotropyTexture", m.anisotropy_texture);
      extensions["KHR_materials_anisotropy"] = grain;
    }
    if (m.iridescence > 0) {
      Json film{{"iridescenceFactor", m.iridescence},
                {"iridescenceIor", m.iridescence_ior},
                {"iridescenceThicknessMinimum", m.iridescence_minimum},
                {"iridescenceThicknessMaximum", m.iridescence_maximum}};
      set_texture(film, "iridescenceTexture", m.iridescence_texture);
      set_texture(film, "iridescenceThicknessTexture", m.iridescence_thickness_texture);
      extensions["KHR_materials_iridescence"] = film;
    }
  }

  // Columns of a node's matrix.
  static Json matrix(const float x[3], const float y[3], const float z[3], const float origin[3]) {
    return {x[0], x[1], x[2], 0, y[0], y[1], y[2], 0, z[0], z[1], z[2], 0, origin[0], origin[1], origin[2], 1};
  }

  void add_light(const Light& light) {
    constexpr const char* types[] = {"point", "spot", "directional"};
    const auto [colour, strength] = split(light.intensity);
    Json json{{"type", types[light.type]}, {"color", colour}, {"intensity", strength}};
    if (light.range > 0) json["range"] = light.range;
    if (light.type == GLEANER_LIGHT_SPOT)
      json["spot"] = {{"innerConeAngle", std::acos(static_cast<double>(light.cos_inner))},
                      {"outerConeAngle", std::acos(static_cast<double>(light.cos_outer))}};
    Json& lights = json_["extensions"]["KHR_lights_punctual"]["lights"];
    const std::string name = std::string(types[light.type]) + " light " + std::to_string(lights.size() + 1);
    json["name"] = name;
    Json node{{"name", name}};
    if (light.type == GLEANER_LIGHT_POINT) {
      node["translation"] = numbers(light.position, 3);
    } else {
      const float z[3] = {-light.direction[0], -light.direction[1], -light.direction[2]};
      // Any x and y will do that make a rotation (Duff et al. 2017, Building an Orthonormal Basis, Revisited).
      const double sign = std::copysign(1.0, z[2]), a = -1 / (sign + z[2]), b = double{z[0]} * z[1] * a;
      const float x[3] = {static_cast<float>(1 + sign * z[0] * z[0] * a), static_cast<float>(sign * b),
                          static_cast<float>(-sign * z[0])};
      const float y[3] = {static_cast<float>(b), static_cast<float>(sign + double{z[1]} * z[1] * a), -z[1]};
      node["matrix"] = matrix(x, y, z, light.position);
    }
    node["extensions"]["KHR_lights_punctual"]["light"] = lights.size();
    lights.push_back(std::move(json));
    add_node(std::move(node));
    use("KHR_lights_punctual");
  }

  void add_camera(std::size_t number) {
    const NamedCamera& named = scene_.cameras[number];
    const Camera& c = named.camera;
    // glTF demands planes; nothing here is clipped by them.
    constexpr double near = 0.001, far = 1e6;
    Json json{{"name", named.name}};
    if (c.type == GLEANER_CAMERA_PERSPECTIVE) {
      json["type"] = "perspective";
      json["perspective"] = {
          {"yfov", 2 * std::atan(static_cast<double>(c.half_height))}, {"znear", near}, {"zfar", far}};
      if (named.aspect > 0) json["perspective"]["aspectRatio"] = named.aspect;
    } else {
      json["type"] = "orthographic";
      json["orthographic"] = {{"xmag", c.half_width}, {"ymag", c.half_height}, {"znear", near}, {"zfar", far}};
    }
    const float back[3] = {-c.forward[0], -c.forward[1], -c.forward[2]};
    Json node{{"name", named.name},
              {"camera", add("cameras", std::move(json))},
              {"matrix", matrix(c.right, c.up, back, c.origin)}};
    if (named.width > 0 && named.height > 0) node["extras"] = {{"width", named.width}, {"height", named.height}};
    add_carried(std::move(node), motion_.cameras, number);
  }

  void finish() {
    if (!extensions_.empty()) json_["extensionsUsed"] = extensions_;
    buffer_.resize((buffer_.size() + 3) / 4 * 4);
    if (!buffer_.empty()) json_["buffers"] = Json::array({Json{{"byteLength", buffer_.size()}}});
    std::string text = json_.dump();
    text.resize((text.size() + 3) / 4 * 4, ' ');
    const std::uint64_t bytes = 12 + 8 + text.size() + (buffer_.empty() ? 0 : 8 + buffer_.size());
    if (bytes > std::numeric_limits<std::uint32_t>::max())
      cannot_write(path_, "a binary glTF holds at most 4 GiB, the scene takes " + std::to_string(bytes) + " bytes");

    AtomicFile file(path_);
    const int descriptor = open(file.temporary().c_str(), O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0644);
    if (descriptor < 0) file.fail();
    const auto put = [&](const void* data, std::size_t count) {
      const auto* next = static_cast<const char*>(data);
      while (count > 0) {
        const ssize_t written = ::write(descriptor, next, count);
        if (written < 0 && errno == EINTR) continue;
        if (written < 0) {
          const int error = errno;
          close(descriptor);
          errno = error;
          file.fail();
        }
        next += written;
        count -= static_cast<std::size_t>(written);
      }
    };
    constexpr std::uint32_t magic = 0x46546c67, version = 2, json_chunk = 0x4e4f534a, binary_chunk = 0x004e4942;
    const std::uint32_t head[] = {magic, version, static_cast<std::uint32_t>(bytes),
                                  static_cast<std::uint32_t>(text.size()), json_chunk};
    put(head, sizeof head);
    put(text.data(), text.size());
    if (!buffer_.empty()) {
      const std::uint32_t chunk[] = {static_cast<std::uint32_t>(buffer_.size()), binary_chunk};
      put(chunk, sizeof chunk);
      put(buffer_.data(), buffer_.size());
    }
    if (close(descriptor) != 0) file.fail();
    file.commit();
  }

  const Scene& scene_;
  const Motion& motion_;
  const std::string& path_;
  std::vector<std::vector<const Instance*>> instances_of_;  // by mesh
  Json json_;
  std::vector<std::size_t> motion_nodes_;                             // in the file, by their number in the motion
  std::map<std::size_t, std::size_t> mesh_nodes_;                     // of meshes with morph targets
  Json channels_ = Json::array(), samplers_of_keys_ = Json::array();  // of the animation
  std::vector<std::byte> buffer_;
  std::set<std::string> extensions_;
};

void write_environment(const Environment& environment, const std::string& path) {
  AtomicFile file(path);
  try {
    write_exr(file.temporary(), environment.width, environment.height, environment.radiance);
  } catch (const Error& error) {
    cannot_write(path, error.what());
  }
  file.commit();
}

void write_file(const Scene& scene, const Motion& motion, const std::string& path) {
  // The environment first: once the scene is there, all of it is.
  if (!scene.environment.empty()) write_environment(scene.environment, environment_path(path));
  GlbWriter(scene, motion, path).write();
}

}  // namespace

void write_glb(const Scene& scene, const std::string& path) { write_file(scene, {}, path); }

void write_glb(const AnimatedScene& animated, const std::string& path) {
  write_file(animated.scene, animated.motion, path);
}

std::string environment_path(const std::string& glb_path) {
  return std::filesystem::path(glb_path).replace_extension(".env.exr").string();
}

}  // namespace gleaner::scene

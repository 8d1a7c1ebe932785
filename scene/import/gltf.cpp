// glTF 2.0 to flat arrays in world space. Transforms are composed in double precision.

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <numbers>
#include <numeric>
#include <set>
#include <tuple>

#include "scene/import/files.h"
#include "scene/import/formats.h"
#include "scene/import/gltf_document.h"
#include "scene/import/images.h"
#include "scene/model/error.h"
#include "scene/model/limits.h"

namespace gleaner::scene {
namespace {

using Vector = std::array<double, 3>;
using Matrix = std::array<double, 16>;  // column by column, as in the file

constexpr Matrix kIdentity = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1};

Matrix product(const Matrix& a, const Matrix& b) {
  Matrix m{};
  for (int c = 0; c < 4; ++c)
    for (int r = 0; r < 4; ++r)
      for (int k = 0; k < 4; ++k) m[c * 4 + r] += a[k * 4 + r] * b[c * 4 + k];
  return m;
}

Vector column(const Matrix& m, int c) { return {m[c * 4], m[c * 4 + 1], m[c * 4 + 2]}; }

Vector cross(const Vector& a, const Vector& b) {
  return {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
}

double dot(const Vector& a, const Vector& b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

// Unit length, or zero where there is none to give.
Vector unit(const Vector& a) {
  const double length = std::hypot(a[0], a[1], a[2]);
  return length > 0 && std::isfinite(length) ? Vector{a[0] / length, a[1] / length, a[2] / length} : Vector{};
}

// Where a material's texture coordinates come from: a set of the mesh, and KHR_texture_transform.
struct UvSource {
  std::size_t set = 0;
  double offset[2] = {0, 0}, rotation = 0, scale[2] = {1, 1};
  auto key() const { return std::tuple(set, offset[0], offset[1], rotation, scale[0], scale[1]); }
  bool is_plain() const {
    return key() == UvSource{0, {0, 0}, 0, {1, 1}}.key() || key() == UvSource{set, {0, 0}, 0, {1, 1}}.key();
  }
};

struct Instance {
  Element node;
  Element mesh;
  Matrix to_world;
};

class Reader {
 public:
  explicit Reader(const std::string& path) : document_(path) {}

  Scene read() {
    check_extensions();
    for (const char* unread : {"skins", "animations"})
      if (document_.size(unread)) warn(std::string(unread) + " are not read: every mesh stands as its nodes place it");
    for (std::size_t i = 0; i < document_.size("materials"); ++i) add_material(document_.root().at("materials")[i]);
    decode_textures();
    walk_nodes();
    add_meshes();
    return std::move(scene_);
  }

 private:
  void warn(const std::string& text) {
    if (warned_.insert(text).second) scene_.warnings.push_back(text);
  }

  void check_extensions() {
    static const std::set<std::string> known = {
        "KHR_lights_punctual",    "KHR_materials_emissive_strength", "KHR_materials_ior",
        "KHR_materials_specular", "KHR_materials_transmission",      "KHR_materials_unlit",
        "KHR_materials_volume",   "KHR_mesh_quantization",           "KHR_texture_transform"};
    const auto each = [&](const char* list, auto&& unknown) {
      const std::optional<Element> names = document_.root().find(list);
      for (std::size_t i = 0; names && i < names->size(); ++i) {
        const Element name = (*names)[i];
        if (!known.contains(name.text())) unknown(name);
      }
    };
    each("extensionsRequired", [](const Element& name) { name.fail("an extension that this renderer knows"); });
    each("extensionsUsed",
         [&](const Element& name) { warn("the extension " + name.text() + " is not known and was ignored"); });
  }

  // --- materials -----------------------------------------------------------------------------------------------------

  static std::optional<Element> extension(const Element& element, const char* name) {
    const std::optional<Element> all = element.find("extensions");
    return all ? all->find(name) : std::nullopt;
  }

  static double factor(const Element& element, const char* key, double otherwise, double upper = 1) {
    const std::optional<Element> value = element.find(key);
    return value ? value->number(0, upper) : otherwise;
  }

  template <std::size_t N>
  static void colour(const Element& element, const char* key, gl_float (&to)[N], double upper = 1) {
    if (const std::optional<Element> value = element.find(key)) {
      const std::vector<double> numbers = value->numbers(N, 0, upper);
      std::copy(numbers.begin(), numbers.end(), to);
    }
  }

  void add_material(const Element& element) {
    constexpr double any = std::numeric_limits<float>::max();
    Material m = lambert_material();
    m.metallic = 1;
    m.specular = 1;
    uv_of_material_.emplace_back();
    has_texture_ = false;
    if (const auto pbr = element.find("pbrMetallicRoughness")) {
      gl_float base[4] = {1, 1, 1, 1};
      colour(*pbr, "baseColorFactor", base);
      std::copy(base, base + 3, m.base_color);
      m.alpha = base[3];
      m.metallic = static_cast<float>(factor(*pbr, "metallicFactor", 1));
      m.roughness = static_cast<float>(factor(*pbr, "roughnessFactor", 1));
      m.base_color_texture = texture(*pbr, "baseColorTexture", true);
      m.metallic_roughness_texture = texture(*pbr, "metallicRoughnessTexture", false);
    }
    m.normal_texture = texture(element, "normalTexture", false);
    if (const auto normal = element.find("normalTexture"))
      if (const auto scale = normal->find("scale")) m.normal_scale = static_cast<float>(scale->number(-any, any));
    m.emission_texture = texture(element, "emissiveTexture", true);
    colour(element, "emissiveFactor", m.emission, any);
    if (std::any_of(m.emission, m.emission + 3, [](float e) { return e > 1; }))
      warn(element.name() +
           ".emissiveFactor: above 1, taken as it stands (glTF has KHR_materials_emissive_strength for it)");
    if (const auto strength = extension(element, "KHR_materials_emissive_strength"))
      for (float& e : m.emission) {
        const double product = e * factor(*strength, "emissiveStrength", 1, any);
        if (!(product <= any)) strength->fail("a product with emissiveFactor that a float can hold");
        e = static_cast<float>(product);
      }
    // Other surfaces scatter on both sides whatever the file says.
    const auto sides = element.find("doubleSided");
    if (sides && sides->boolean() && std::any_of(m.emission, m.emission + 3, [](float e) { return e > 0; }))
      m.flags |= GLEANER_MATERIAL_DOUBLE_SIDED;
    const std::string mode = element.find("alphaMode") ? element.at("alphaMode").text() : "OPAQUE";
    if (mode == "MASK")
      m.flags |= GLEANER_MATERIAL_ALPHA_MASK;
    else if (mode == "BLEND")
      m.flags |= GLEANER_MATERIAL_ALPHA_BLEND;
    else if (mode != "OPAQUE")
      element.at("alphaMode").fail("OPAQUE, MASK or BLEND");
    m.alpha_cutoff = static_cast<float>(factor(element, "alphaCutoff", 0.5, any));
    if (const auto specular = extension(element, "KHR_materials_specular")) {
      m.specular = static_cast<float>(factor(*specular, "specularFactor", 1));
      colour(*specular, "specularColorFactor", m.specular_color, any);
      m.specular_texture = texture(*specular, "specularTexture", false);
      m.specular_color_texture = texture(*specular, "specularColorTexture", true);
    }
    if (const auto ior = extension(element, "KHR_materials_ior")) {
      m.ior = static_cast<float>(factor(*ior, "ior", 1.5, any));
      if (m.ior != 0 && m.ior < 1) ior->at("ior").fail("0 or at least 1");
    }
    if (const auto transmission = extension(element, "KHR_materials_transmission")) {
      m.transmission = static_cast<float>(factor(*transmission, "transmissionFactor", 0));
      if (m.transmission > 0) {
        m.transmission_texture = texture(*transmission, "transmissionTexture", false);
        if (m.ior < 1) element.fail("an ior of at least 1 where light is transmitted", "0");
      }
    }
    if (const auto volume = extension(element, "KHR_materials_volume")) add_volume(*volume, m);
    if (extension(element, "KHR_materials_unlit")) {
      // It emits its base colour whatever else the file says.
      m.flags = (m.flags & ~GLEANER_MATERIAL_DOUBLE_SIDED) | GLEANER_MATERIAL_UNLIT;
      m.metallic = m.specular = m.transmission = 0;
      std::fill(m.emission, m.emission + 3, 0.0f);
      m.metallic_roughness_texture = m.normal_texture = m.emission_texture = GLEANER_NONE;
      m.transmission_texture = m.specular_texture = m.specular_color_texture = GLEANER_NONE;
    }
    scene_.materials.push_back(m);
    const auto name = element.find("name");
    scene_.material_names.push_back(name ? name->text() : element.name());
  }

  // The extension makes glass a solid. An explicit thickness of 0 is how glTF itself says thin-walled.
  void add_volume(const Element& volume, Material& m) {
    const auto thickness = volume.find("thicknessFactor");
    if (m.transmission == 0 || (thickness && thickness->number(0) == 0)) return;
    m.flags |= GLEANER_MATERIAL_SOLID;
    if (volume.find("thicknessTexture"))
      warn(volume.name() + ".thicknessTexture: not read, the geometry says how thick it is");
    const auto distance = volume.find("attenuationDistance");
    if (!distance) return;
    const double metres = distance->number(0);
    if (!(metres > 0)) distance->fail("more than 0");
    gl_float left[3] = {1, 1, 1};
    colour(volume, "attenuationColor", left);
    // Nothing comes through a colour of 0 at any distance; 1e12 per metre is as good as infinity, and finite.
    for (int c = 0; c < 3; ++c)
      m.attenuation[c] = left[c] >= 1 ? 0.0f : static_cast<float>(std::min(-std::log(double(left[c])) / metres, 1e12));
  }

  // --- textures ------------------------------------------------------------------------------------------------------

  static UvSource uv_source(const Element& info) {
    UvSource uv;
    if (const auto set = info.find("texCoord")) uv.set = set->count(0, 255);
    if (const auto transform = extension(info, "KHR_texture_transform")) {
      constexpr double most = 1e6;
      const auto pair = [&](const char* key, double(&to)[2]) {
        if (const auto value = transform->find(key)) {
          const std::vector<double> numbers = value->numbers(2, -most, most);
          std::copy(numbers.begin(), numbers.end(), to);
        }
      };
      pair("offset", uv.offset);
      pair("scale", uv.scale);
      if (const auto rotation = transform->find("rotation")) uv.rotation = rotation->number(-most, most);
      if (const auto set = transform->find("texCoord")) uv.set = set->count(0, 255);
    }
    return uv;
  }

  gl_uint texture(const Element& owner, const char* key, bool is_srgb) {
    const auto info = owner.find(key);
    if (!info) return GLEANER_NONE;
    // Vertices carry one pair of coordinates: that of the material's first texture.
    const UvSource uv = uv_source(*info);
    if (!has_texture_) uv_of_material_.back() = uv;
    has_texture_ = true;
    if (uv.key() != uv_of_material_.back().key())
      warn(info->name() +
           ": other texture coordinates or another transform than the material's first texture, which it shares now");

    const Element element = document_.item("textures", info->at("index"));
    Texture t{};
    t.flags = is_srgb ? GLEANER_TEXTURE_SRGB : 0;
    if (const auto reference = element.find("sampler")) {
      const Element sampler = document_.item("samplers", *reference);
      t.wrap_u = wrap(sampler, "wrapS");
      t.wrap_v = wrap(sampler, "wrapT");
      if (const auto filter = sampler.find("magFilter"); filter && filter->count(0, 65535) == 9728)
        warn(filter->name() + ": NEAREST is read as LINEAR");
    }
    const std::size_t source = image_source(document_.item("images", element.at("source")));
    const auto [place, is_new] =
        textures_.try_emplace({source, t.wrap_u, t.wrap_v, t.flags}, gl_uint(scene_.textures.size()));
    if (is_new) {
      scene_.textures.push_back(t);
      image_of_texture_.push_back(source);
    }
    return place->second;
  }

  static gl_uint wrap(const Element& sampler, const char* key) {
    const auto mode = sampler.find(key);
    if (!mode) return GLEANER_WRAP_REPEAT;
    switch (mode->count(0, 65535)) {
      case 10497:
        return GLEANER_WRAP_REPEAT;
      case 33071:
        return GLEANER_WRAP_CLAMP;
      case 33648:
        return GLEANER_WRAP_MIRROR;
      default:
        mode->fail("10497, 33071 or 33648");
    }
  }

  std::size_t image_source(const Element& image) {
    if (const auto known = image_by_element_.find(image.name()); known != image_by_element_.end()) return known->second;
    ImageSource source;
    source.element = image.name();
    if (const auto uri = image.find("uri")) {
      source.element = uri->name();
      if (is_data_uri(uri->text())) {
        embedded_.push_back(data_uri_bytes(uri->text(), document_.file(), uri->name()));
        source.bytes = embedded_.back();
        if (source.bytes.empty()) uri->fail("an image", "no bytes");
      } else {
        const std::string name = percent_decoded(uri->text(), document_.file(), uri->name());
        source.path = resolve_inside(name, document_.file(), uri->name());
        file_bytes(source.path, document_.file(), uri->name());
      }
    } else {
      source.bytes = document_.buffer_view(image.at("bufferView"));
    }
    std::size_t index = sources_.size();
    if (!source.path.empty()) index = image_by_path_.try_emplace(source.path, index).first->second;
    if (index == sources_.size()) sources_.push_back(std::move(source));
    return image_by_element_[image.name()] = index;
  }

  void decode_textures() {
    const std::vector<DecodedImage> images = decode_images(sources_, document_.file(), scene_.texels, scene_.warnings);
    for (std::size_t i = 0; i < scene_.textures.size(); ++i) {
      const DecodedImage& image = images[image_of_texture_[i]];
      scene_.textures[i].first_texel = image.first_texel;
      scene_.textures[i].width = image.width;
      scene_.textures[i].height = image.height;
    }
  }

  // --- nodes ---------------------------------------------------------------------------------------------------------

  static Matrix local_matrix(const Element& node) {
    constexpr double most = 1e30;
    if (const auto matrix = node.find("matrix")) {
      const std::vector<double> numbers = matrix->numbers(16, -most, most);
      Matrix m;
      std::copy(numbers.begin(), numbers.end(), m.begin());
      if (m[3] != 0 || m[7] != 0 || m[11] != 0 || m[15] != 1)
        matrix->fail("an affine matrix (last row 0 0 0 1)", "another");
      return m;
    }
    double r[4] = {0, 0, 0, 1}, s[3] = {1, 1, 1}, t[3] = {0, 0, 0};
    const auto vector = [&](const char* key, auto& to) {
      const auto value = node.find(key);
      if (!value) return;
      const std::vector<double> numbers = value->numbers(std::size(to), -most, most);
      std::copy(numbers.begin(), numbers.end(), to);
    };
    vector("rotation", r);
    vector("scale", s);
    vector("translation", t);
    const double length = std::sqrt(r[0] * r[0] + r[1] * r[1] + r[2] * r[2] + r[3] * r[3]);
    if (!(length > 0 && std::isfinite(length))) node.at("rotation").fail("a unit quaternion");
    const double x = r[0] / length, y = r[1] / length, z = r[2] / length, w = r[3] / length;
    return {s[0] * (1 - 2 * (y * y + z * z)),
            s[0] * 2 * (x * y + z * w),
            s[0] * 2 * (x * z - y * w),
            0,
            s[1] * 2 * (x * y - z * w),
            s[1] * (1 - 2 * (x * x + z * z)),
            s[1] * 2 * (y * z + x * w),
            0,
            s[2] * 2 * (x * z + y * w),
            s[2] * 2 * (y * z - x * w),
            s[2] * (1 - 2 * (x * x + y * y)),
            0,
            t[0],
            t[1],
            t[2],
            1};
  }

  // The nodes of the default scene; of a file without scenes, those that are nobody's children.
  std::vector<std::size_t> root_nodes() const {
    const Element root = document_.root();
    const std::size_t count = document_.size("nodes");
    std::vector<std::size_t> roots;
    if (document_.size("scenes") > 0) {
      const auto chosen = root.find("scene");
      const Element scene = chosen ? document_.item("scenes", *chosen) : root.at("scenes")[0];
      const auto nodes = scene.find("nodes");
      for (std::size_t i = 0; nodes && i < nodes->size(); ++i) roots.push_back((*nodes)[i].index(count));
      return roots;
    }
    std::vector<bool> is_child(count);
    for (std::size_t i = 0; i < count; ++i) {
      const auto children = root.at("nodes")[i].find("children");
      for (std::size_t c = 0; children && c < children->size(); ++c) is_child[(*children)[c].index(count)] = true;
    }
    for (std::size_t i = 0; i < count; ++i)
      if (!is_child[i]) roots.push_back(i);
    return roots;
  }

  void walk_nodes() {
    const std::size_t count = document_.size("nodes");
    std::vector<bool> visited(count);
    std::vector<std::pair<std::size_t, Matrix>> open;
    const std::vector<std::size_t> roots = root_nodes();
    for (auto root = roots.rbegin(); root != roots.rend(); ++root) open.emplace_back(*root, kIdentity);
    while (!open.empty()) {
      const auto [index, parent] = open.back();
      open.pop_back();
      const Element node = document_.root().at("nodes")[index];
      // A cycle, too, comes by a node a second time.
      if (visited[index]) node.fail("a node with one parent", "a second way to it");
      visited[index] = true;
      const Matrix to_world = product(parent, local_matrix(node));
      if (!std::all_of(to_world.begin(), to_world.end(), [](double x) { return std::isfinite(x); }))
        node.fail("a finite transform", "an overflow");
      if (const auto mesh = node.find("mesh")) instances_.push_back({node, document_.item("meshes", *mesh), to_world});
      if (const auto camera = node.find("camera")) add_camera(node, document_.item("cameras", *camera), to_world);
      if (const auto light = extension(node, "KHR_lights_punctual")) add_light(light->at("light"), to_world);
      if (const auto children = node.find("children"))
        for (std::size_t c = children->size(); c-- > 0;) open.emplace_back((*children)[c].index(count), to_world);
    }
  }

  // --- cameras and lights --------------------------------------------------------------------------------------------

  static std::string name_of(const Element& first, const Element& second, const std::string& otherwise) {
    for (const Element& element : {first, second})
      if (const auto name = element.find("name"); name && !name->text().empty()) return name->text();
    return otherwise;
  }

  template <typename To>
  static void store(const Vector& from, To& to) {
    for (int c = 0; c < 3; ++c) to[c] = static_cast<float>(from[c]);
  }

  void add_camera(const Element& node, const Element& element, const Matrix& to_world) {
    constexpr double any = std::numeric_limits<float>::max();
    NamedCamera named;
    named.name = name_of(node, element, "camera " + std::to_string(scene_.cameras.size()));
    const Vector forward = unit(column(to_world, 2));
    const Vector right = unit(cross(column(to_world, 1), forward));
    if (dot(right, right) == 0) node.fail("a transform that keeps the camera's axes apart", "one that does not");
    store(column(to_world, 3), named.camera.origin);
    store(right, named.camera.right);
    store(cross(forward, right), named.camera.up);
    store({-forward[0], -forward[1], -forward[2]}, named.camera.forward);
    for (const Element& holder : {element, node}) {
      const auto extras = holder.find("extras");
      if (!extras || !extras->is_object()) continue;
      const auto width = extras->find("width"), height = extras->find("height");
      if (!width || !height) continue;
      named.width = static_cast<std::uint32_t>(width->count(1, 1u << 28));
      named.height = static_cast<std::uint32_t>(height->count(1, 1u << 28));
    }
    const std::string type = element.at("type").text();
    if (type == "perspective") {
      const Element lens = element.at("perspective");
      const double yfov = lens.at("yfov").number(0, any);
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
        if (!(lens.at(key).number(-any, any) > 0)) lens.at(key).fail("more than 0");
      named.camera.type = GLEANER_CAMERA_ORTHOGRAPHIC;
      named.camera.half_width = static_cast<float>(lens.at("xmag").number());
      named.camera.half_height = static_cast<float>(lens.at("ymag").number());
      named.aspect = named.camera.half_width / named.camera.half_height;
    } else {
      element.at("type").fail("perspective or orthographic");
    }
    scene_.cameras.push_back(std::move(named));
  }

  void add_light(const Element& reference, const Matrix& to_world) {
    constexpr double any = std::numeric_limits<float>::max();
    const auto holder = extension(document_.root(), "KHR_lights_punctual");
    if (!holder) reference.fail("extensions.KHR_lights_punctual at the top of the file", "none");
    const Element lights = holder->at("lights");
    const Element element = lights[reference.index(lights.size())];
    Light light{};
    store(column(to_world, 3), light.position);
    gl_float tint[3] = {1, 1, 1};
    colour(element, "color", tint, any);
    const double intensity = factor(element, "intensity", 1, any);
    for (int c = 0; c < 3; ++c) {
      if (!(tint[c] * intensity <= any)) element.fail("a product of color and intensity that a float can hold", "more");
      light.intensity[c] = static_cast<float>(tint[c] * intensity);
    }
    const Vector forward = unit(column(to_world, 2));
    store({-forward[0], -forward[1], -forward[2]}, light.direction);
    const std::string type = element.at("type").text();
    if (type != "point" && dot(forward, forward) == 0)
      reference.fail("a node whose transform keeps a direction", "none");
    if (type == "directional") {
      light.type = GLEANER_LIGHT_DIRECTIONAL;
      std::fill(light.position, light.position + 3, 0.0f);
    } else if (type == "point" || type == "spot") {
      light.type = type == "point" ? GLEANER_LIGHT_POINT : GLEANER_LIGHT_SPOT;
      if (const auto range = element.find("range")) {
        light.range = static_cast<float>(range->number(0, any));
        if (!(light.range > 0)) range->fail("more than 0");
      }
    } else {
      element.at("type").fail("point, spot or directional");
    }
    if (type == "spot") {
      const Element cone = element.at("spot");
      const double outer = factor(cone, "outerConeAngle", std::numbers::pi / 4, std::numbers::pi / 2 + 1e-6);
      const double inner = factor(cone, "innerConeAngle", 0, std::numbers::pi / 2 + 1e-6);
      if (!(inner <= outer)) cone.at("innerConeAngle").fail("at most the outerConeAngle");
      light.cos_inner = static_cast<float>(std::cos(inner));
      light.cos_outer = static_cast<float>(std::cos(outer));
    }
    scene_.lights.push_back(light);
  }

  // --- meshes --------------------------------------------------------------------------------------------------------

  struct PrimitiveSize {
    std::size_t triangles = 0, vertices = 0;
  };

  static std::uint64_t mode_of(const Element& primitive) {
    const auto mode = primitive.find("mode");
    return mode ? mode->count(0, 6) : 4;
  }

  // What a primitive will add, from counts alone: sizes are known before memory is taken.
  PrimitiveSize size_of(const Element& primitive) const {
    const std::uint64_t mode = mode_of(primitive);
    if (mode < 4) return {};
    const auto count_of = [&](const Element& reference) {
      return document_.item("accessors", reference).at("count").count(1, 0xffffffffu);
    };
    const Element position = primitive.at("attributes").at("POSITION");
    const std::size_t vertices = count_of(position);
    const auto indices = primitive.find("indices");
    const std::size_t corners = indices ? count_of(*indices) : vertices;
    if (mode == 4 && corners % 3 != 0)
      (indices ? *indices : position).fail("a multiple of 3 corners of triangles", std::to_string(corners));
    if (corners < 3) return {};
    return {mode == 4 ? corners / 3 : corners - 2, std::min(vertices, corners)};
  }

  void add_meshes() {
    PrimitiveSize total;
    for (const Instance& instance : instances_) {
      const Element primitives = instance.mesh.at("primitives");
      for (std::size_t p = 0; p < primitives.size(); ++p) {
        const PrimitiveSize size = size_of(primitives[p]);
        total.triangles += size.triangles;
        total.vertices += size.vertices;
        if (total.triangles > kMaxTriangles)
          primitives[p].fail("at most " + std::to_string(kMaxTriangles) + " triangles in all", "more");
        if (total.vertices > kMaxVertices)
          primitives[p].fail("at most " + std::to_string(kMaxVertices) + " vertices in all", "more");
      }
    }
    const bool has_uvs = !scene_.textures.empty();
    scene_.positions.reserve(3 * total.vertices);
    scene_.normals.reserve(3 * total.vertices);
    if (has_uvs) scene_.uvs.reserve(2 * total.vertices);
    scene_.indices.reserve(3 * total.triangles);
    scene_.triangle_material.reserve(total.triangles);
    for (const Instance& instance : instances_) {
      const std::size_t first = scene_.triangle_count();
      const Element primitives = instance.mesh.at("primitives");
      if (instance.mesh.find("weights") || instance.node.find("weights"))
        warn("morph targets are not read: meshes stand as their vertices say");
      for (std::size_t p = 0; p < primitives.size(); ++p) add_primitive(primitives[p], instance.to_world);
      if (const std::size_t count = scene_.triangle_count() - first)
        scene_.meshes.push_back(
            {name_of(instance.node, instance.mesh, instance.mesh.name()), std::uint32_t(first), std::uint32_t(count)});
    }
  }

  // Corners of a primitive's triangles, three a triangle, in the order that shows the front.
  std::vector<std::uint32_t> corners_of(const Element& primitive, std::size_t vertices) const {
    std::vector<std::uint32_t> given;
    if (const auto indices = primitive.find("indices")) {
      given = document_.indices(*indices, vertices);
    } else {
      given.resize(vertices);
      std::iota(given.begin(), given.end(), 0u);
    }
    const std::uint64_t mode = mode_of(primitive);
    if (mode == 4) return given;
    std::vector<std::uint32_t> corners;
    for (std::size_t i = 0; i + 2 < given.size(); ++i) {
      const std::size_t odd = i % 2;
      const auto triangle = mode == 5 ? std::array{given[i], given[i + 1 + odd], given[i + 2 - odd]}
                                      : std::array{given[i + 1], given[i + 2], given[0]};
      corners.insert(corners.end(), triangle.begin(), triangle.end());
    }
    return corners;
  }

  // Keeps of `per_vertex` arrays what the corners name: files may share one long accessor among many primitives.
  static void drop_unused(std::vector<std::uint32_t>& corners, std::size_t vertices, std::vector<std::uint32_t>& kept) {
    kept.assign(corners.begin(), corners.end());
    std::sort(kept.begin(), kept.end());
    kept.erase(std::unique(kept.begin(), kept.end()), kept.end());
    if (kept.size() == vertices) return;
    for (std::uint32_t& corner : corners)
      corner = static_cast<std::uint32_t>(std::lower_bound(kept.begin(), kept.end(), corner) - kept.begin());
  }

  void add_primitive(const Element& primitive, const Matrix& to_world) {
    if (mode_of(primitive) < 4) {
      warn(primitive.name() + ": points and lines are not drawn");
      return;
    }
    const Element attributes = primitive.at("attributes");
    const auto attribute = [&](const char* key, const char* type) -> std::optional<Accessor> {
      const auto reference = attributes.find(key);
      if (!reference) return std::nullopt;
      return document_.accessor(*reference, type);
    };
    const Accessor position = *attribute("POSITION", "VEC3");
    const std::size_t vertices = position.count;
    const auto same_count = [&](const std::optional<Accessor>& other, const char* key) {
      if (other && other->count != vertices)
        attributes.at(key).fail("as many elements as POSITION: " + std::to_string(vertices),
                                std::to_string(other->count));
    };
    const std::optional<Accessor> normal = attribute("NORMAL", "VEC3");
    same_count(normal, "NORMAL");
    if (attributes.find("COLOR_0")) warn("COLOR_0: vertex colours are not read");
    if (attributes.find("JOINTS_0")) warn("JOINTS_0: skins are not read");

    const std::uint32_t material = material_of(primitive);
    std::vector<std::uint32_t> corners = corners_of(primitive, vertices);
    if (corners.empty()) return;
    std::vector<std::uint32_t> kept;
    if (vertices > corners.size()) {
      drop_unused(corners, vertices, kept);
    } else {
      kept.resize(vertices);
      std::iota(kept.begin(), kept.end(), 0u);
    }
    const auto first = static_cast<std::uint32_t>(scene_.vertex_count());
    add_positions(document_.floats(position), kept, to_world, attributes.at("POSITION"));
    if (normal)
      add_normals(document_.floats(*normal), kept, to_world, attributes.at("NORMAL"));
    else
      scene_.normals.resize(scene_.positions.size());
    if (!scene_.textures.empty()) add_uvs(attributes, kept, material, vertices);

    // A transform that mirrors turns triangles inside out; swapping two corners keeps the front in front.
    const bool is_mirrored = dot(column(to_world, 0), cross(column(to_world, 1), column(to_world, 2))) < 0;
    for (std::size_t i = 0; i < corners.size(); i += 3) {
      if (is_mirrored) std::swap(corners[i + 1], corners[i + 2]);
      for (int k = 0; k < 3; ++k) scene_.indices.push_back(first + corners[i + k]);
    }
    scene_.triangle_material.resize(scene_.triangle_count(), material);
  }

  std::uint32_t material_of(const Element& primitive) {
    const std::size_t in_file = document_.size("materials");
    if (const auto reference = primitive.find("material")) return static_cast<std::uint32_t>(reference->index(in_file));
    if (scene_.materials.size() == in_file) {
      Material m = lambert_material();
      m.metallic = 1;
      m.specular = 1;
      scene_.materials.push_back(m);
      scene_.material_names.push_back("glTF default");
      uv_of_material_.emplace_back();
    }
    return static_cast<std::uint32_t>(in_file);
  }

  void add_positions(const std::vector<float>& values, const std::vector<std::uint32_t>& kept, const Matrix& m,
                     const Element& attribute) {
    for (const std::uint32_t v : kept) {
      const float* p = &values[3 * std::size_t(v)];
      for (int c = 0; c < 3; ++c) {
        const double world = m[c] * p[0] + m[4 + c] * p[1] + m[8 + c] * p[2] + m[12 + c];
        if (!(std::abs(world) <= kMaxCoordinate))
          attribute.fail("finite coordinates within 1e9 m of the origin",
                         std::to_string(world) + " at vertex " + std::to_string(v));
        scene_.positions.push_back(static_cast<float>(world));
      }
    }
  }

  // Normals turn with the inverse transpose: up to a positive factor, the cofactors with the determinant's sign.
  void add_normals(const std::vector<float>& values, const std::vector<std::uint32_t>& kept, const Matrix& m,
                   const Element& attribute) {
    const Vector x = column(m, 0), y = column(m, 1), z = column(m, 2);
    const Vector cofactors[3] = {cross(y, z), cross(z, x), cross(x, y)};
    const double sign = dot(x, cofactors[0]) < 0 ? -1 : 1;
    bool has_zero = false;
    for (const std::uint32_t v : kept) {
      const float* n = &values[3 * std::size_t(v)];
      Vector world;
      for (int c = 0; c < 3; ++c) {
        if (!std::isfinite(n[c]))
          attribute.fail("finite normals", std::to_string(n[c]) + " at vertex " + std::to_string(v));
        world[c] = sign * (cofactors[0][c] * n[0] + cofactors[1][c] * n[1] + cofactors[2][c] * n[2]);
      }
      world = unit(world);
      has_zero |= dot(world, world) == 0;
      for (const double c : world) scene_.normals.push_back(static_cast<float>(c));
    }
    if (has_zero) warn(attribute.name() + ": normals of length 0 are replaced by those of the triangles");
  }

  void add_uvs(const Element& attributes, const std::vector<std::uint32_t>& kept, std::uint32_t material,
               std::size_t vertices) {
    const UvSource& uv = uv_of_material_[material];
    const std::string key = "TEXCOORD_" + std::to_string(uv.set);
    const auto reference = attributes.find(key.c_str());
    if (!reference) {
      if (has_any_texture(scene_.materials[material]))
        warn(attributes.name() + ": no " + key + " for a material with textures: their corner's texel is taken");
      scene_.uvs.resize(2 * scene_.vertex_count());
      return;
    }
    const Accessor accessor = document_.accessor(*reference, "VEC2");
    if (accessor.count != vertices)
      reference->fail("as many elements as POSITION: " + std::to_string(vertices), std::to_string(accessor.count));
    const std::vector<float> values = document_.floats(accessor);
    const double cosine = std::cos(uv.rotation), sine = std::sin(uv.rotation);
    for (const std::uint32_t v : kept) {
      float pair[2] = {values[2 * std::size_t(v)], values[2 * std::size_t(v) + 1]};
      if (!uv.is_plain()) {
        const double u = uv.scale[0] * pair[0], w = uv.scale[1] * pair[1];
        pair[0] = static_cast<float>(cosine * u + sine * w + uv.offset[0]);
        pair[1] = static_cast<float>(-sine * u + cosine * w + uv.offset[1]);
      }
      for (const float c : pair) {
        if (!std::isfinite(c))
          reference->fail("finite coordinates", std::to_string(c) + " at vertex " + std::to_string(v));
        scene_.uvs.push_back(c);
      }
    }
  }

  static bool has_any_texture(const Material& m) {
    for (const gl_uint t : {m.base_color_texture, m.metallic_roughness_texture, m.normal_texture, m.emission_texture,
                            m.transmission_texture, m.specular_texture, m.specular_color_texture})
      if (t != GLEANER_NONE) return true;
    return false;
  }

  GltfDocument document_;
  Scene scene_;
  std::set<std::string> warned_;
  std::vector<Instance> instances_;
  std::vector<UvSource> uv_of_material_;
  bool has_texture_ = false;  // has the material that is being read a texture already?
  std::map<std::tuple<std::size_t, gl_uint, gl_uint, gl_uint>, gl_uint> textures_;  // image, wraps, flags -> texture
  std::vector<std::size_t> image_of_texture_;
  std::vector<ImageSource> sources_;
  std::map<std::string, std::size_t> image_by_element_;
  std::map<std::filesystem::path, std::size_t> image_by_path_;
  std::vector<std::vector<std::byte>> embedded_;
};

}  // namespace

Scene read_gltf(const std::string& path) { return Reader(path).read(); }

}  // namespace gleaner::scene

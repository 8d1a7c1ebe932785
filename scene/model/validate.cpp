// Every promise of records.h and scene.h that later code relies on without asking again. All comparisons are written so
// that NaN fails them.

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <iterator>
#include <string>
#include <vector>

#include "scene/model/error.h"
#include "scene/model/instances.h"
#include "scene/model/limits.h"
#include "scene/model/scene.h"

namespace gleaner::scene {
namespace {

class Checker {
 public:
  Checker(const Scene& scene, const std::string& file) : scene_(scene), file_(file) {}

  void run() const {
    geometry();
    meshes();
    instances();
    materials();
    textures();
    lights();
    for (std::size_t i = 0; i < scene_.cameras.size(); ++i) camera(i);
    environment();
    validate_rig(scene_, file_);
  }

  void vertices(std::size_t first, std::size_t count) const {
    const Scene& s = scene_;
    for (std::size_t i = 3 * first; i < 3 * (first + count); ++i) {
      if (!(std::abs(s.positions[i]) <= kMaxCoordinate))
        fail(item("positions", i / 3), "finite coordinates of at most " + number(kMaxCoordinate) + " m",
             number(s.positions[i]));
    }
    for (std::size_t i = 3 * first; i < 3 * (first + count); i += 3) {
      const float* n = &s.normals[i];
      if (n[0] == 0 && n[1] == 0 && n[2] == 0) continue;
      unit(n, [&] { return item("normals", i / 3); });
    }
  }

  void lights() const {
    for (std::size_t i = 0; i < scene_.lights.size(); ++i) light(i);
  }

  void materials() const {
    for (std::size_t i = 0; i < scene_.materials.size(); ++i) material(i);
    for (std::size_t i = 0; i < scene_.albedo_tables.size(); ++i)
      within(scene_.albedo_tables[i], 0, 1, [&] { return item("albedo_tables", i); });
  }

  // After meshes().
  void instanced_meshes() const {
    for (std::size_t m = 0; m < scene_.meshes.size(); ++m)
      if (scene_.meshes[m].instanced) instanced_mesh(m);
  }

  // `box`: about the instance's mesh.
  void place(std::size_t i, const Bounds& box) const {
    const Instance& instance = scene_.instances[i];
    if (const auto why = refused_transform(instance.transform))
      fail(item("instances", i, "transform"), "a finite transform with an inverse of moderate size", *why);
    const DerivedInstance d = derived(instance.transform, box);
    for (int c = 0; c < 3; ++c)
      if (!(d.lower[c] >= -kMaxCoordinate && d.upper[c] <= kMaxCoordinate))
        fail(item("instances", i, "transform"), "a place within " + number(kMaxCoordinate) + " m",
             number(static_cast<float>(d.lower[c])) + " to " + number(static_cast<float>(d.upper[c])));
  }

 private:
  [[noreturn]] void fail(const std::string& element, const std::string& expected, const std::string& found) const {
    throw Error::bad_input(file_, element, expected, found);
  }

  void length(const char* array, std::size_t found, std::size_t expected) const {
    if (found != expected) fail(array, std::to_string(expected) + " values", std::to_string(found));
  }

  template <typename Name>
  void within(float value, float lower, float upper, const Name& name) const {
    if (!(value >= lower && value <= upper))
      fail(name(), "a value from " + number(lower) + " to " + number(upper), number(value));
  }

  template <typename Name>
  void not_negative(float value, const Name& name) const {
    if (!(value >= 0 && std::isfinite(value))) fail(name(), "a finite value of at least 0", number(value));
  }

  template <typename Name>
  void finite(float value, const Name& name) const {
    if (!std::isfinite(value)) fail(name(), "a finite value", number(value));
  }

  template <typename Name>
  void unit(const float v[3], const Name& name) const {
    const double squared = double(v[0]) * v[0] + double(v[1]) * v[1] + double(v[2]) * v[2];
    if (!(std::abs(squared - 1) <= kUnitTolerance))
      fail(name(), "a vector of length 1", "length " + std::to_string(std::sqrt(squared)));
  }

  static std::string number(float value) {
    char text[32];
    std::snprintf(text, sizeof text, "%g", static_cast<double>(value));
    return text;
  }

  void geometry() const {
    const Scene& s = scene_;
    if (s.positions.size() % 3) fail("positions", "three values a vertex", std::to_string(s.positions.size()));
    if (s.indices.size() % 3) fail("indices", "three values a triangle", std::to_string(s.indices.size()));
    const std::size_t vertices = s.vertex_count(), triangles = s.triangle_count();
    if (triangles > kMaxTriangles)
      fail("triangles", "at most " + std::to_string(kMaxTriangles), std::to_string(triangles));
    if (vertices > kMaxVertices) fail("vertices", "at most " + std::to_string(kMaxVertices), std::to_string(vertices));
    length("normals", s.normals.size(), s.positions.size());
    if (!s.uvs.empty()) length("uvs", s.uvs.size(), 2 * vertices);
    if (!s.second_uvs.empty()) length("second_uvs", s.second_uvs.size(), 2 * vertices);
    if (!s.colors.empty()) length("colors", s.colors.size(), 4 * vertices);
    length("triangle_material", s.triangle_material.size(), triangles);
    this->vertices(0, vertices);
    for (std::size_t i = 0; i < s.uvs.size(); ++i) finite(s.uvs[i], [&] { return item("uvs", i / 2); });
    for (std::size_t i = 0; i < s.second_uvs.size(); ++i)
      finite(s.second_uvs[i], [&] { return item("second_uvs", i / 2); });
    for (std::size_t i = 0; i < s.indices.size(); ++i) {
      if (s.indices[i] >= vertices)
        fail(item("indices", i), "a vertex index below " + std::to_string(vertices), std::to_string(s.indices[i]));
    }
    for (std::size_t i = 0; i < triangles; ++i) {
      if (s.triangle_material[i] >= s.materials.size())
        fail(item("triangle_material", i), "a material index below " + std::to_string(s.materials.size()),
             std::to_string(s.triangle_material[i]));
    }
  }

  void meshes() const {
    std::size_t next = 0;
    for (std::size_t i = 0; i < scene_.meshes.size(); ++i) {
      const Mesh& mesh = scene_.meshes[i];
      if (mesh.first_triangle != next || mesh.triangle_count > scene_.triangle_count() - next)
        fail(item("meshes", i), "a range of triangles that begins at " + std::to_string(next),
             std::to_string(mesh.triangle_count) + " from " + std::to_string(mesh.first_triangle));
      next += mesh.triangle_count;
    }
    if (next != scene_.triangle_count())
      fail("meshes", "ranges that cover " + std::to_string(scene_.triangle_count()) + " triangles",
           std::to_string(next));
  }

  // After geometry() and meshes().
  void instances() const {
    const Scene& s = scene_;
    if (s.instances.size() > kMaxInstances)
      fail("instances", "at most " + std::to_string(kMaxInstances), std::to_string(s.instances.size()));
    std::vector<bool> placed(s.meshes.size());
    instanced_meshes();
    const std::vector<Bounds> boxes = boxes_of_instanced(s);
    for (std::size_t i = 0; i < s.instances.size(); ++i) {
      const Instance& instance = s.instances[i];
      if (instance.mesh >= s.meshes.size() || !s.meshes[instance.mesh].instanced)
        fail(item("instances", i, "mesh"), "an instanced mesh, below " + std::to_string(s.meshes.size()),
             std::to_string(instance.mesh));
      placed[instance.mesh] = true;
      if (std::any_of(instance.reserved, instance.reserved + 3, [](gl_uint word) { return word != 0; }))
        fail(item("instances", i, "reserved"), "zeros", "other words");
      place(i, boxes[instance.mesh]);
    }
    for (std::size_t m = 0; m < s.meshes.size(); ++m)
      if (s.meshes[m].instanced && !placed[m]) fail(item("meshes", m), "an instance of it", "none");
  }

  void instanced_mesh(std::size_t m) const {
    const Mesh& mesh = scene_.meshes[m];
    if (mesh.deforming) fail(item("meshes", m), "a mesh that is instanced or deforms", "one that does both");
    if (mesh.triangle_count == 0) fail(item("meshes", m), "triangles, being instanced", "none");
    for (std::size_t t = mesh.first_triangle; t < std::size_t{mesh.first_triangle} + mesh.triangle_count; ++t)
      if (!may_be_instanced(scene_.materials[scene_.triangle_material[t]]))
        fail(item("meshes", m), "materials that neither emit nor bound a solid that light passes, being instanced",
             item("materials", scene_.triangle_material[t]));
  }

  void material(std::size_t i) const {
    const Material& m = scene_.materials[i];
    const auto named = [&](const char* field) { return [i, field] { return item("materials", i, field); }; };
    for (int c = 0; c < 3; ++c) {
      within(m.base_color[c], 0, 1, named("base_color"));
      not_negative(m.emission[c], named("emission"));
      not_negative(m.specular_color[c], named("specular_color"));
      within(m.f0[c], 0, 1, named("f0"));
      not_negative(m.attenuation[c], named("attenuation"));
    }
    within(m.alpha, 0, 1, named("alpha"));
    not_negative(m.alpha_cutoff, named("alpha_cutoff"));
    within(m.specular, 0, 1, named("specular"));
    within(m.metallic, 0, 1, named("metallic"));
    within(m.roughness, 0, 1, named("roughness"));
    within(m.transmission, 0, 1, named("transmission"));
    finite(m.normal_scale, named("normal_scale"));
    not_negative(m.ior, named("ior"));
    if (m.transmission > 0 && !(m.ior >= 1)) fail(item("materials", i, "ior"), "at least 1 for glass", number(m.ior));
    constexpr gl_uint known = GLEANER_MATERIAL_SOLID | GLEANER_MATERIAL_UNLIT | GLEANER_MATERIAL_ALPHA_BLEND |
                              GLEANER_MATERIAL_ALPHA_MASK | GLEANER_MATERIAL_ATTENUATES | GLEANER_MATERIAL_DOUBLE_SIDED;
    if (m.flags & ~known) fail(item("materials", i, "flags"), "known bits alone", std::to_string(m.flags));
    layers(m, i);
    texture_of(m.base_color_texture, i, "base_color_texture");
    texture_of(m.metallic_roughness_texture, i, "metallic_roughness_texture");
    texture_of(m.normal_texture, i, "normal_texture");
    texture_of(m.emission_texture, i, "emission_texture");
    texture_of(m.transmission_texture, i, "transmission_texture");
    texture_of(m.specular_texture, i, "specular_texture");
    texture_of(m.specular_color_texture, i, "specular_color_texture");
    if (m.albedo_table == GLEANER_NONE) return;
    constexpr gl_uint allowed[] = {1, GLEANER_ALBEDO_ROWS, GLEANER_ALBEDO_LEVELS,
                                   GLEANER_ALBEDO_ROWS * GLEANER_ALBEDO_LEVELS};
    if (std::find(std::begin(allowed), std::end(allowed), m.albedo_rows) == std::end(allowed))
      fail(item("materials", i, "albedo_rows"), "1, 17, 33 or 561", std::to_string(m.albedo_rows));
    table_of(m.albedo_table, m.albedo_rows, i, "albedo_table");
  }

  void table_of(gl_uint table, gl_uint rows, std::size_t i, const char* field) const {
    const std::uint64_t end = std::uint64_t(table) + rows * (GLEANER_ALBEDO_NODES + 1ull);
    if (end > scene_.albedo_tables.size())
      fail(item("materials", i, field), "a table within " + std::to_string(scene_.albedo_tables.size()) + " values",
           std::to_string(end));
  }

  // Coat, sheen, grain, film, and what shines through.
  void layers(const Material& m, std::size_t i) const {
    const auto named = [&](const char* field) { return [i, field] { return item("materials", i, field); }; };
    within(m.clearcoat, 0, 1, named("clearcoat"));
    within(m.clearcoat_roughness, 0, 1, named("clearcoat_roughness"));
    finite(m.clearcoat_normal_scale, named("clearcoat_normal_scale"));
    for (const float c : m.sheen_color) within(c, 0, 1, named("sheen_color"));
    within(m.sheen_roughness, 0, 1, named("sheen_roughness"));
    within(m.anisotropy, 0, 1, named("anisotropy"));
    finite(m.anisotropy_rotation, named("anisotropy_rotation"));
    within(m.iridescence, 0, 1, named("iridescence"));
    if (!(m.iridescence_ior >= 1 && std::isfinite(m.iridescence_ior)))
      fail(item("materials", i, "iridescence_ior"), "at least 1", number(m.iridescence_ior));
    not_negative(m.iridescence_minimum, named("iridescence_minimum"));
    not_negative(m.iridescence_maximum, named("iridescence_maximum"));
    within(m.diffuse_transmission, 0, 1, named("diffuse_transmission"));
    for (const float c : m.diffuse_transmission_color) within(c, 0, 1, named("diffuse_transmission_color"));
    texture_of(m.diffuse_transmission_texture, i, "diffuse_transmission_texture");
    texture_of(m.diffuse_transmission_color_texture, i, "diffuse_transmission_color_texture");
    texture_of(m.clearcoat_texture, i, "clearcoat_texture");
    texture_of(m.clearcoat_roughness_texture, i, "clearcoat_roughness_texture");
    texture_of(m.clearcoat_normal_texture, i, "clearcoat_normal_texture");
    texture_of(m.sheen_color_texture, i, "sheen_color_texture");
    texture_of(m.sheen_roughness_texture, i, "sheen_roughness_texture");
    texture_of(m.anisotropy_texture, i, "anisotropy_texture");
    texture_of(m.iridescence_texture, i, "iridescence_texture");
    texture_of(m.iridescence_thickness_texture, i, "iridescence_thickness_texture");
    const auto rows = [](gl_uint texture) { return texture == GLEANER_NONE ? 1u : GLEANER_ALBEDO_ROWS; };
    // Where nothing is reflected by a layer, nobody reads its table.
    if (m.clearcoat_table != GLEANER_NONE)
      table_of(m.clearcoat_table, rows(m.clearcoat_roughness_texture), i, "clearcoat_table");
    else if (m.clearcoat > 0 && lit(m))
      fail(item("materials", i, "clearcoat_table"), "a table", "none");
    if (m.sheen_table != GLEANER_NONE)
      table_of(m.sheen_table, rows(m.sheen_roughness_texture), i, "sheen_table");
    else if (std::any_of(m.sheen_color, m.sheen_color + 3, [](float c) { return c > 0; }) && lit(m))
      fail(item("materials", i, "sheen_table"), "a table", "none");
  }

  static bool lit(const Material& m) {
    return !(m.flags & GLEANER_MATERIAL_UNLIT) && (m.transmission < 1 || m.transmission_texture != GLEANER_NONE);
  }

  void texture_of(gl_uint texture, std::size_t i, const char* field) const {
    if (texture == GLEANER_NONE) return;
    if (texture >= scene_.textures.size())
      fail(item("materials", i, field), "a texture index below " + std::to_string(scene_.textures.size()),
           std::to_string(texture));
    if (scene_.uvs.empty() && scene_.vertex_count() > 0)
      fail("uvs", "two values a vertex, for " + item("materials", i, field), "none");
  }

  void textures() const {
    if (scene_.texels.size() > kMaxTexels)
      fail("texels", "at most " + std::to_string(kMaxTexels), std::to_string(scene_.texels.size()));
    for (std::size_t i = 0; i < scene_.textures.size(); ++i) {
      const Texture& t = scene_.textures[i];
      if (!(t.width >= 1 && t.width <= kMaxTextureSide && t.height >= 1 && t.height <= kMaxTextureSide))
        fail(item("textures", i), "1 to " + std::to_string(kMaxTextureSide) + " texels a side",
             std::to_string(t.width) + "x" + std::to_string(t.height));
      const std::uint64_t end = t.first_texel + std::uint64_t(t.width) * t.height;
      if (end > scene_.texels.size())
        fail(item("textures", i), "texels within " + std::to_string(scene_.texels.size()), std::to_string(end));
      if (t.wrap_u > GLEANER_WRAP_MIRROR || t.wrap_v > GLEANER_WRAP_MIRROR)
        fail(item("textures", i), "a known wrap mode", std::to_string(t.wrap_u) + " and " + std::to_string(t.wrap_v));
      if (t.flags & ~GLEANER_TEXTURE_SRGB)
        fail(item("textures", i, "flags"), "known bits alone", std::to_string(t.flags));
      if (t.uv_set > 1) fail(item("textures", i, "uv_set"), "0 or 1", std::to_string(t.uv_set));
      for (const float x : t.transform) finite(x, [&] { return item("textures", i, "transform"); });
    }
  }

  void light(std::size_t i) const {
    const Light& l = scene_.lights[i];
    const auto named = [&](const char* field) { return [i, field] { return item("lights", i, field); }; };
    if (l.type > GLEANER_LIGHT_DIRECTIONAL)
      fail(item("lights", i, "type"), "a known type of light", std::to_string(l.type));
    for (int c = 0; c < 3; ++c) {
      if (!(std::abs(l.position[c]) <= kMaxCoordinate))
        fail(item("lights", i, "position"), "finite coordinates of at most " + number(kMaxCoordinate) + " m",
             number(l.position[c]));
      not_negative(l.intensity[c], named("intensity"));
    }
    not_negative(l.range, named("range"));
    if (l.type != GLEANER_LIGHT_POINT) unit(l.direction, named("direction"));
    if (l.type == GLEANER_LIGHT_SPOT) {
      within(l.cos_inner, -1, 1, named("cos_inner"));
      within(l.cos_outer, -1, 1, named("cos_outer"));
      if (!(l.cos_outer <= l.cos_inner))
        fail(item("lights", i), "an inner cone within the outer one",
             number(l.cos_inner) + " and " + number(l.cos_outer) + " (cosines)");
    }
  }

  void camera(std::size_t i) const {
    const NamedCamera& named_camera = scene_.cameras[i];
    const Camera& c = named_camera.camera;
    const auto named = [&](const char* field) { return [i, field] { return item("cameras", i, field); }; };
    if (c.type > GLEANER_CAMERA_ORTHOGRAPHIC)
      fail(item("cameras", i, "type"), "a known type of camera", std::to_string(c.type));
    for (int k = 0; k < 3; ++k) {
      if (!(std::abs(c.origin[k]) <= kMaxCameraCoordinate))
        fail(item("cameras", i, "origin"), "finite coordinates of at most " + number(kMaxCameraCoordinate) + " m",
             number(c.origin[k]));
    }
    unit(c.right, named("right"));
    unit(c.up, named("up"));
    unit(c.forward, named("forward"));
    for (float half : {c.half_width, c.half_height})
      if (!(half > 0 && half <= kMaxCoordinate))
        fail(item("cameras", i), "a film wider than 0 and at most " + number(kMaxCoordinate), number(half));
    not_negative(named_camera.aspect, named("aspect"));
  }

  void environment() const {
    const Environment& e = scene_.environment;
    if (e.width > kMaxEnvironmentSide || e.height > kMaxEnvironmentSide || (e.width == 0) != (e.height == 0))
      fail("environment", "1 to " + std::to_string(kMaxEnvironmentSide) + " pixels a side",
           std::to_string(e.width) + "x" + std::to_string(e.height));
    length("environment", e.radiance.size(), 3 * std::size_t(e.width) * e.height);
    for (std::size_t i = 0; i < e.radiance.size(); ++i)
      not_negative(e.radiance[i], [&] { return item("environment", i / 3); });
  }

  const Scene& scene_;
  const std::string& file_;
};

}  // namespace

void validate(const Scene& scene, const std::string& file) { Checker(scene, file).run(); }

void validate_vertices(const Scene& scene, std::size_t first, std::size_t count, const std::string& file) {
  Checker(scene, file).vertices(first, count);
}

void validate_placement(const Scene& scene, std::size_t instance, const Bounds& box, const std::string& file) {
  Checker(scene, file).place(instance, box);
}

void validate_lights(const Scene& scene, const std::string& file) { Checker(scene, file).lights(); }

void validate_materials(const Scene& scene, const std::string& file) {
  const Checker checker(scene, file);
  checker.materials();
  checker.instanced_meshes();
}

}  // namespace gleaner::scene

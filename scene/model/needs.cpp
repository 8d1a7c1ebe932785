#include <algorithm>
#include <cmath>
#include <vector>

#include "scene/model/emission.h"
#include "scene/model/media.h"
#include "scene/model/needs.h"
#include "scene/model/scene.h"

namespace gleaner::scene {
namespace {

constexpr double kNormalTolerance = 1e-4;  // length of the difference between a vertex normal and the triangle's own

struct Face {
  double normal[3];
  bool has_area;
};

Face face_of(const Scene& scene, std::size_t triangle) {
  double edge[2][3];
  const float* p = scene.positions.data();
  const std::uint32_t* v = &scene.indices[3 * triangle];
  for (int e = 0; e < 2; ++e)
    for (int c = 0; c < 3; ++c) edge[e][c] = double(p[3 * std::size_t(v[e + 1]) + c]) - p[3 * std::size_t(v[0]) + c];
  Face face{{edge[0][1] * edge[1][2] - edge[0][2] * edge[1][1], edge[0][2] * edge[1][0] - edge[0][0] * edge[1][2],
             edge[0][0] * edge[1][1] - edge[0][1] * edge[1][0]},
            false};
  const double length =
      std::sqrt(face.normal[0] * face.normal[0] + face.normal[1] * face.normal[1] + face.normal[2] * face.normal[2]);
  face.has_area = length > 0;
  if (face.has_area)
    for (double& c : face.normal) c /= length;
  return face;
}

bool deviates(const Scene& scene, std::size_t triangle, const Face& face) {
  for (int k = 0; k < 3; ++k) {
    const float* n = &scene.normals[3 * std::size_t(scene.indices[3 * triangle + k])];
    if (n[0] == 0 && n[1] == 0 && n[2] == 0) continue;
    double difference = 0;
    for (int c = 0; c < 3; ++c) difference += (n[c] - face.normal[c]) * (n[c] - face.normal[c]);
    if (!(difference <= kNormalTolerance * kNormalTolerance)) return true;
  }
  return false;
}

bool emits(const Material& m) { return m.emission[0] > 0 || m.emission[1] > 0 || m.emission[2] > 0; }

bool has_alpha_mode(const Material& m) {
  return m.flags & (GLEANER_MATERIAL_ALPHA_MASK | GLEANER_MATERIAL_ALPHA_BLEND);
}

void add_textures(const Scene& scene, const Material& m, SceneNeeds& needs) {
  constexpr float plain[6] = {1, 0, 0, 0, 1, 0};
  for (const auto slot : texture_slots()) {
    const gl_uint index = m.*slot;
    if (index == GLEANER_NONE) continue;
    needs.material_textures |= slot != &Material::base_color_texture;
    const Texture& t = scene.textures[index];
    needs.textures = true;
    needs.texture_transforms |= !std::equal(plain, plain + 6, t.transform);
    needs.second_uvs |= t.uv_set == 1;
  }
  needs.normal_maps |= m.normal_texture != GLEANER_NONE || m.clearcoat_normal_texture != GLEANER_NONE;
}

void add_material(const Scene& scene, const Material& m, float vertex_alpha, SceneNeeds& needs) {
  add_textures(scene, m, needs);
  needs.alpha |= is_see_through(scene, m, vertex_alpha);
  if (m.flags & GLEANER_MATERIAL_UNLIT) {
    needs.unlit = true;
    return;
  }
  const bool textured = m.metallic_roughness_texture != GLEANER_NONE;
  const bool rough = m.roughness > 0 || textured || m.anisotropy > 0;
  const bool transmissive = is_transmissive(m);
  const bool opaque_part =
      !transmissive || m.transmission < 1 || m.transmission_texture != GLEANER_NONE || m.metallic > 0;
  if (opaque_part && (m.metallic > 0 || m.specular > 0)) (rough ? needs.glossy : needs.specular) = true;
  needs.metallic |= opaque_part && m.metallic > 0;
  needs.clearcoat |= opaque_part && m.clearcoat > 0;
  needs.sheen |= opaque_part && std::any_of(m.sheen_color, m.sheen_color + 3, [](float c) { return c > 0; });
  const bool has_lobe = opaque_part && (m.metallic > 0 || m.specular > 0);
  needs.anisotropy |= has_lobe && m.anisotropy > 0;
  needs.iridescence |= has_lobe && m.iridescence > 0;
  if (transmits_diffusely(m)) needs.diffuse_transmission = needs.transmissive = needs.rough_transmissive = true;
  if (!transmissive) return;
  needs.transmissive = true;
  const bool solid = m.flags & GLEANER_MATERIAL_SOLID;
  const bool blurs = textured || m.roughness * m.roughness >= GLEANER_SMOOTH_GLASS_ALPHA;
  const bool smooth = !blurs || textured;
  needs.rough_transmissive |= blurs;
  (blurs ? needs.glossy : needs.specular) = true;
  needs.panes |= smooth && !solid;
  needs.refractive |= smooth && solid;
  needs.attenuation |= (m.flags & GLEANER_MATERIAL_ATTENUATES) != 0;
}

// The least alpha of the vertices' colours, one a material that has an alpha mode.
std::vector<float> vertex_alphas(const Scene& scene) {
  std::vector<float> least(scene.materials.size(), 1.0f);
  if (scene.colors.empty()) return least;
  for (std::size_t t = 0; t < scene.triangle_count(); ++t) {
    const std::uint32_t material = scene.triangle_material[t];
    if (!has_alpha_mode(scene.materials[material])) continue;
    for (int k = 0; k < 3; ++k)
      least[material] = std::min(
          least[material], static_cast<float>(scene.colors[4 * std::size_t(scene.indices[3 * t + k]) + 3]) / 65535);
  }
  return least;
}

}  // namespace

SceneNeeds needs_of(const Scene& scene) {
  SceneNeeds needs;
  std::vector<bool> used(scene.materials.size());
  for (std::size_t t = 0; t < scene.triangle_count(); ++t) {
    const std::uint32_t material = scene.triangle_material[t];
    used[material] = true;
    const Material& m = scene.materials[material];
    const bool shines = emits(m) && !(m.flags & GLEANER_MATERIAL_UNLIT);
    const bool two_sided = shines && (m.flags & GLEANER_MATERIAL_DOUBLE_SIDED);
    const bool emissive = (shines && !needs.emissive_triangles) || (two_sided && !needs.two_sided_emitters);
    if (!emissive && needs.smooth_normals) continue;
    const Face face = face_of(scene, t);
    if (!face.has_area) continue;
    needs.emissive_triangles |= emissive;
    needs.two_sided_emitters |= two_sided;
    needs.smooth_normals = needs.smooth_normals || deviates(scene, t, face);
  }
  const std::vector<float> least_alpha = vertex_alphas(scene);
  for (std::size_t m = 0; m < used.size(); ++m)
    if (used[m]) add_material(scene, scene.materials[m], least_alpha[m], needs);
  needs.vertex_colors = std::any_of(scene.colors.begin(), scene.colors.end(), [](auto c) { return c != 65535; });
  needs.instances = !scene.instances.empty();
  needs.deforming = std::any_of(scene.meshes.begin(), scene.meshes.end(), [](const Mesh& m) { return m.deforming; });
  needs.punctual_lights = !scene.lights.empty();
  needs.environment = !scene.environment.empty();
  // Of an index of 1, shadow rays pass.
  for (std::size_t m = 0; m < used.size(); ++m)
    needs.media |= used[m] && is_solid(scene.materials[m]) && scene.materials[m].ior == 1;
  needs.media |= needs.attenuation || (needs.transmissive && media_may_overlap(scene, media_by_rank(scene)));
  return needs;
}

std::vector<std::string> lost_light(const SceneNeeds& needs) {
  if (!needs.punctual_lights || !needs.refractive) return {};
  return {
      "point, spot and directional lights do not shine through solid glass: no shadow ray finds its way through a "
      "surface that refracts. A lamp of emissive triangles does, and so does an environment; and so would the glass as "
      "a "
      "thin sheet (KHR_materials_transmission without KHR_materials_volume)"};
}

// In the order of the struct.
constexpr bool SceneNeeds::*need_fields[] = {&SceneNeeds::specular,
                                             &SceneNeeds::glossy,
                                             &SceneNeeds::metallic,
                                             &SceneNeeds::transmissive,
                                             &SceneNeeds::rough_transmissive,
                                             &SceneNeeds::attenuation,
                                             &SceneNeeds::alpha,
                                             &SceneNeeds::unlit,
                                             &SceneNeeds::textures,
                                             &SceneNeeds::material_textures,
                                             &SceneNeeds::normal_maps,
                                             &SceneNeeds::smooth_normals,
                                             &SceneNeeds::punctual_lights,
                                             &SceneNeeds::emissive_triangles,
                                             &SceneNeeds::environment,
                                             &SceneNeeds::deforming,
                                             &SceneNeeds::vertex_colors,
                                             &SceneNeeds::texture_transforms,
                                             &SceneNeeds::second_uvs,
                                             &SceneNeeds::two_sided_emitters,
                                             &SceneNeeds::panes,
                                             &SceneNeeds::refractive,
                                             &SceneNeeds::media,
                                             &SceneNeeds::clearcoat,
                                             &SceneNeeds::sheen,
                                             &SceneNeeds::anisotropy,
                                             &SceneNeeds::iridescence,
                                             &SceneNeeds::instances,
                                             &SceneNeeds::diffuse_transmission};

std::uint32_t SceneNeeds::bits() const {
  std::uint32_t bits = 0;
  for (std::size_t i = 0; i < std::size(need_fields); ++i) bits |= std::uint32_t(this->*need_fields[i]) << i;
  return bits;
}

SceneNeeds needs_from_bits(std::uint32_t bits) {
  SceneNeeds needs;
  for (std::size_t i = 0; i < std::size(need_fields); ++i) needs.*need_fields[i] = bits >> i & 1;
  return needs;
}

const std::vector<std::string>& need_names() {
  static const std::vector<std::string> names = {"specular",
                                                 "glossy",
                                                 "metallic",
                                                 "transmissive",
                                                 "rough_transmissive",
                                                 "attenuation",
                                                 "alpha",
                                                 "unlit",
                                                 "textures",
                                                 "material_textures",
                                                 "normal_maps",
                                                 "smooth_normals",
                                                 "punctual_lights",
                                                 "emissive_triangles",
                                                 "environment",
                                                 "deforming",
                                                 "vertex_colors",
                                                 "texture_transforms",
                                                 "second_uvs",
                                                 "two_sided_emitters",
                                                 "panes",
                                                 "refractive",
                                                 "media",
                                                 "clearcoat",
                                                 "sheen",
                                                 "anisotropy",
                                                 "iridescence",
                                                 "instances",
                                                 "diffuse_transmission"};
  return names;
}

}  // namespace gleaner::scene

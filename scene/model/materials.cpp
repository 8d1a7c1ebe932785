// What is derived from a material as it was read: f0, flags, and the tables of what its lobes leave.

#include <algorithm>
#include <vector>

#include "scene/model/albedo_tables.h"
#include "scene/model/scene.h"

namespace gleaner::scene {

Material blank_material() {
  Material m{};
  for (int c = 0; c < 3; ++c) m.base_color[c] = m.specular_color[c] = 1;
  m.alpha = 1;
  m.alpha_cutoff = 0.5f;
  m.ior = 1.5f;
  m.roughness = 1;
  m.normal_scale = m.clearcoat_normal_scale = 1;
  std::fill(m.diffuse_transmission_color, m.diffuse_transmission_color + 3, 1.0f);
  m.iridescence_ior = 1.3f;
  m.iridescence_minimum = 100;
  m.iridescence_maximum = 400;
  for (const auto slot : texture_slots()) m.*slot = GLEANER_NONE;
  m.albedo_table = m.clearcoat_table = m.sheen_table = GLEANER_NONE;
  return m;
}

const std::vector<gl_uint Material::*>& texture_slots() {
  static const std::vector<gl_uint Material::*> slots = {&Material::base_color_texture,
                                                         &Material::metallic_roughness_texture,
                                                         &Material::normal_texture,
                                                         &Material::emission_texture,
                                                         &Material::transmission_texture,
                                                         &Material::specular_texture,
                                                         &Material::specular_color_texture,
                                                         &Material::clearcoat_texture,
                                                         &Material::clearcoat_roughness_texture,
                                                         &Material::clearcoat_normal_texture,
                                                         &Material::sheen_color_texture,
                                                         &Material::sheen_roughness_texture,
                                                         &Material::anisotropy_texture,
                                                         &Material::iridescence_texture,
                                                         &Material::iridescence_thickness_texture,
                                                         &Material::diffuse_transmission_texture,
                                                         &Material::diffuse_transmission_color_texture};
  return slots;
}

Texture plain_texture() {
  Texture t{};
  t.wrap_u = t.wrap_v = GLEANER_WRAP_REPEAT;
  t.transform[0] = t.transform[4] = 1;
  return t;
}

void finish_materials(Scene& scene) {
  for (Material& m : scene.materials) {
    const float mirror = (1 - m.ior) / (1 + m.ior);
    for (int c = 0; c < 3; ++c) m.f0[c] = std::min(mirror * mirror * m.specular_color[c], 1.0f);
    const bool absorbs = std::any_of(m.attenuation, m.attenuation + 3, [](float a) { return a > 0; });
    m.flags &= ~GLEANER_MATERIAL_ATTENUATES;
    if (absorbs && (m.flags & GLEANER_MATERIAL_SOLID)) m.flags |= GLEANER_MATERIAL_ATTENUATES;
  }
  make_albedo_tables(scene);
}

}  // namespace gleaner::scene

// What is derived from a material as it was read: f0, flags, and the tables of what its specular lobe leaves.

#include <algorithm>
#include <atomic>
#include <cmath>
#include <map>
#include <thread>
#include <tuple>
#include <vector>

#include "scene/model/albedo.h"
#include "scene/model/scene.h"

namespace gleaner::scene {
namespace {

// Is there a Lambert layer under a dielectric specular lobe anywhere on this material?
bool has_coated_layer(const Material& m) {
  const bool opaque_part = m.transmission < 1 || m.transmission_texture != GLEANER_NONE;
  const bool dielectric_part = m.metallic < 1 || m.metallic_roughness_texture != GLEANER_NONE;
  return !(m.flags & GLEANER_MATERIAL_UNLIT) && m.specular > 0 && opaque_part && dielectric_part;
}

float alpha_of(float roughness) { return roughness * roughness; }

float row_roughness(int row) { return static_cast<float>(row) / (GLEANER_ALBEDO_ROWS - 1); }

// Fills in the albedo of every key; a few milliseconds each, so all cores take part.
void compute(std::map<float, DirectionalAlbedo>& by_alpha) {
  std::vector<std::pair<const float, DirectionalAlbedo>*> work;
  for (auto& entry : by_alpha) work.push_back(&entry);
  std::atomic<std::size_t> next = 0;
  const auto run = [&] {
    for (std::size_t i; (i = next++) < work.size();) work[i]->second = directional_albedo(work[i]->first);
  };
  std::vector<std::jthread> helpers;
  const std::size_t threads = std::min<std::size_t>(work.size(), std::max(1u, std::thread::hardware_concurrency()));
  for (std::size_t i = 1; i < threads; ++i) helpers.emplace_back(run);
  run();
}

}  // namespace

Texture plain_texture() {
  Texture t{};
  t.wrap_u = t.wrap_v = GLEANER_WRAP_REPEAT;
  t.transform[0] = t.transform[4] = 1;
  return t;
}

void finish_materials(Scene& scene) {
  scene.albedo_tables.clear();
  std::map<float, DirectionalAlbedo> by_alpha;
  for (Material& m : scene.materials) {
    const float mirror = (1 - m.ior) / (1 + m.ior);
    for (int c = 0; c < 3; ++c) m.f0[c] = std::min(mirror * mirror * m.specular_color[c], 1.0f);
    const bool absorbs = std::any_of(m.attenuation, m.attenuation + 3, [](float a) { return a > 0; });
    m.flags &= ~GLEANER_MATERIAL_ATTENUATES;
    if (absorbs && (m.flags & GLEANER_MATERIAL_SOLID)) m.flags |= GLEANER_MATERIAL_ATTENUATES;
    m.albedo_table = GLEANER_NONE;
    m.albedo_rows = 0;
    if (!has_coated_layer(m)) continue;
    m.albedo_rows = m.metallic_roughness_texture == GLEANER_NONE ? 1 : GLEANER_ALBEDO_ROWS;
    if (m.albedo_rows == 1) {
      by_alpha[alpha_of(m.roughness)];
    } else {
      for (int row = 0; row < GLEANER_ALBEDO_ROWS; ++row) by_alpha[alpha_of(row_roughness(row))];
    }
  }
  compute(by_alpha);

  using Key = std::tuple<gl_uint, float, float, float>;  // rows, roughness, largest f0, specular
  std::map<Key, gl_uint> tables;
  for (Material& m : scene.materials) {
    if (m.albedo_rows == 0) continue;
    const float f0 = *std::max_element(m.f0, m.f0 + 3);
    const bool textured = m.albedo_rows > 1;
    const auto [place, is_new] = tables.try_emplace(Key{m.albedo_rows, textured ? 0 : m.roughness, f0, m.specular},
                                                    static_cast<gl_uint>(scene.albedo_tables.size()));
    m.albedo_table = place->second;
    if (!is_new) continue;
    for (gl_uint row = 0; row < m.albedo_rows; ++row) {
      const float roughness = textured ? row_roughness(static_cast<int>(row)) : m.roughness;
      const std::size_t first = scene.albedo_tables.size();
      scene.albedo_tables.resize(first + GLEANER_ALBEDO_NODES + 1);
      albedo_row(by_alpha.at(alpha_of(roughness)), f0, m.specular,
                 std::span<float, GLEANER_ALBEDO_NODES + 1>(&scene.albedo_tables[first], GLEANER_ALBEDO_NODES + 1));
    }
  }
}

}  // namespace gleaner::scene

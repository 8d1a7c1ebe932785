#include "worker/stages/scene_tables.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstddef>
#include <cstring>

#include "kernels/scene_layout.h"
#include "scene/model/instances.h"

namespace gleaner::worker {
namespace {

#define SAME_WORD(type, field, word) static_assert(offsetof(scene::type, field) == 4 * (word))
static_assert(sizeof(scene::Texture) == 4 * TEXTURE_WORDS);
SAME_WORD(Texture, first_texel, TEXTURE_FIRST_TEXEL);
SAME_WORD(Texture, width, TEXTURE_WIDTH);
SAME_WORD(Texture, height, TEXTURE_HEIGHT);
SAME_WORD(Texture, wrap_u, TEXTURE_WRAP_U);
SAME_WORD(Texture, wrap_v, TEXTURE_WRAP_V);
SAME_WORD(Texture, flags, TEXTURE_FLAGS);
SAME_WORD(Texture, uv_set, TEXTURE_UV_SET);
SAME_WORD(Texture, transform, TEXTURE_TRANSFORM);
#undef SAME_WORD

}  // namespace

std::array<float, 512> decode_table() {
  std::array<float, 512> table{};
  for (int i = 0; i < 256; ++i) {
    const double c = i / 255.0;
    table[i] = static_cast<float>(c <= 0.04045 ? c / 12.92 : std::pow((c + 0.055) / 1.055, 2.4));
    table[256 + i] = static_cast<float>(c);
  }
  return table;
}

std::vector<float> material_rows(const scene::Scene& scene, const std::vector<std::uint32_t>& media) {
  std::vector<float> rows(scene.materials.size() * MATERIAL_WORDS, 0.0f);
  for (std::size_t i = 0; i < scene.materials.size(); ++i) {
    const scene::Material& m = scene.materials[i];
    float* row = &rows[i * MATERIAL_WORDS];
    const auto word = [row](unsigned at, std::uint32_t value) { std::memcpy(row + at, &value, sizeof value); };
    std::copy(m.base_color, m.base_color + 3, row + MATERIAL_BASE_COLOR);
    row[MATERIAL_ALPHA] = m.alpha;
    row[MATERIAL_METALLIC] = m.metallic;
    row[MATERIAL_ROUGHNESS] = m.roughness;
    row[MATERIAL_SPECULAR] = m.specular;
    row[MATERIAL_TRANSMISSION] = m.transmission;
    std::copy(m.f0, m.f0 + 3, row + MATERIAL_F0);
    row[MATERIAL_IOR] = m.ior;
    word(MATERIAL_FLAGS, m.flags);
    word(MATERIAL_BASE_COLOR_TEXTURE, m.base_color_texture);
    word(MATERIAL_ALBEDO_TABLE, m.albedo_table);
    word(MATERIAL_ALBEDO_ROWS, m.albedo_rows);
    row[MATERIAL_ALPHA_CUTOFF] = m.alpha_cutoff;
    std::copy(m.attenuation, m.attenuation + 3, row + MATERIAL_ATTENUATION);
    row[MATERIAL_NORMAL_SCALE] = m.normal_scale;
    word(MATERIAL_METALLIC_ROUGHNESS_TEXTURE, m.metallic_roughness_texture);
    word(MATERIAL_NORMAL_TEXTURE, m.normal_texture);
    word(MATERIAL_EMISSION_TEXTURE, m.emission_texture);
    word(MATERIAL_TRANSMISSION_TEXTURE, m.transmission_texture);
    word(MATERIAL_SPECULAR_TEXTURE, m.specular_texture);
    word(MATERIAL_SPECULAR_COLOR_TEXTURE, m.specular_color_texture);
    row[MATERIAL_CLEARCOAT] = m.clearcoat;
    row[MATERIAL_CLEARCOAT_ROUGHNESS] = m.clearcoat_roughness;
    row[MATERIAL_CLEARCOAT_NORMAL_SCALE] = m.clearcoat_normal_scale;
    std::copy(m.sheen_color, m.sheen_color + 3, row + MATERIAL_SHEEN_COLOR);
    row[MATERIAL_SHEEN_ROUGHNESS] = m.sheen_roughness;
    row[MATERIAL_ANISOTROPY] = m.anisotropy;
    row[MATERIAL_ANISOTROPY_ROTATION] = m.anisotropy_rotation;
    row[MATERIAL_IRIDESCENCE] = m.iridescence;
    row[MATERIAL_IRIDESCENCE_IOR] = m.iridescence_ior;
    row[MATERIAL_IRIDESCENCE_MINIMUM] = m.iridescence_minimum;
    row[MATERIAL_IRIDESCENCE_MAXIMUM] = m.iridescence_maximum;
    word(MATERIAL_CLEARCOAT_TEXTURE, m.clearcoat_texture);
    word(MATERIAL_CLEARCOAT_ROUGHNESS_TEXTURE, m.clearcoat_roughness_texture);
    word(MATERIAL_CLEARCOAT_NORMAL_TEXTURE, m.clearcoat_normal_texture);
    word(MATERIAL_SHEEN_COLOR_TEXTURE, m.sheen_color_texture);
    word(MATERIAL_SHEEN_ROUGHNESS_TEXTURE, m.sheen_roughness_texture);
    word(MATERIAL_ANISOTROPY_TEXTURE, m.anisotropy_texture);
    word(MATERIAL_IRIDESCENCE_TEXTURE, m.iridescence_texture);
    word(MATERIAL_IRIDESCENCE_THICKNESS_TEXTURE, m.iridescence_thickness_texture);
    word(MATERIAL_CLEARCOAT_TABLE, m.clearcoat_table);
    word(MATERIAL_SHEEN_TABLE, m.sheen_table);
    row[MATERIAL_DIFFUSE_TRANSMISSION] = m.diffuse_transmission;
    std::copy(m.diffuse_transmission_color, m.diffuse_transmission_color + 3,
              row + MATERIAL_DIFFUSE_TRANSMISSION_COLOR);
    word(MATERIAL_DIFFUSE_TRANSMISSION_TEXTURE, m.diffuse_transmission_texture);
    word(MATERIAL_DIFFUSE_TRANSMISSION_COLOR_TEXTURE, m.diffuse_transmission_color_texture);
  }
  for (std::uint32_t r = 0; r < media.size(); ++r) {
    const std::uint32_t rank = r + 1;
    std::memcpy(&rows[media[r] * MATERIAL_WORDS + MATERIAL_MEDIUM], &rank, sizeof rank);
    std::memcpy(&rows[r * MATERIAL_WORDS + MATERIAL_OF_MEDIUM], &media[r], sizeof media[r]);
  }
  return rows;
}

unsigned words_of_triangle(const scene::SceneNeeds& needs) {
  return needs.second_uvs ? TRIANGLE_WORDS_SECOND_UVS : TRIANGLE_WORDS_PLAIN;
}

void write_triangles(const scene::Scene& scene, std::size_t first, std::size_t count,
                     const std::vector<std::uint32_t>& emitters, unsigned words, float* out) {
  constexpr unsigned color_rg[] = {TRIANGLE_COLOR0, TRIANGLE_COLOR1, TRIANGLE_COLOR2_RG};
  constexpr unsigned color_ba[] = {TRIANGLE_COLOR0 + 1, TRIANGLE_COLOR1 + 1, TRIANGLE_COLOR2_BA};
  const bool second_uvs = words == TRIANGLE_WORDS_SECOND_UVS && !scene.second_uvs.empty();
  for (std::size_t t = first; t < first + count; ++t, out += words) {
    std::memset(out, 0, 4 * words);
    for (std::size_t k = 0; k < 3; ++k) {
      const std::size_t vertex = scene.indices[3 * t + k];
      std::memcpy(out + TRIANGLE_P0 + 3 * k, &scene.positions[3 * vertex], 12);
      if (!scene.normals.empty()) std::memcpy(out + TRIANGLE_N0 + 3 * k, &scene.normals[3 * vertex], 12);
      if (!scene.uvs.empty()) std::memcpy(out + TRIANGLE_UV0 + 2 * k, &scene.uvs[2 * vertex], 8);
      if (second_uvs) std::memcpy(out + TRIANGLE_SECOND_UV0 + 2 * k, &scene.second_uvs[2 * vertex], 8);
      if (!scene.colors.empty()) {
        std::memcpy(out + color_rg[k], &scene.colors[4 * vertex], 4);
        std::memcpy(out + color_ba[k], &scene.colors[4 * vertex + 2], 4);
      }
    }
    std::memcpy(out + TRIANGLE_MATERIAL, &scene.triangle_material[t], 4);
    std::memcpy(out + TRIANGLE_EMITTER, &emitters[t], 4);
  }
}

std::vector<float> table_of_instances(std::span<const scene::Instance> instances,
                                      const std::vector<scene::Bounds>& boxes) {
  std::vector<float> rows((instances.size() + 1) * INSTANCE_WORDS);
  for (unsigned k = 0; k < 3; ++k) rows[INSTANCE_LINEAR + 4 * k] = rows[INSTANCE_NORMAL + 4 * k] = 1;
  rows[INSTANCE_SIDE] = 1;
  float* row = rows.data() + INSTANCE_WORDS;
  for (const scene::Instance& instance : instances) {
    const scene::DerivedInstance d = scene::derived(instance.transform, boxes[instance.mesh]);
    for (unsigned r = 0; r < 3; ++r) {
      for (unsigned c = 0; c < 3; ++c) {
        row[INSTANCE_LINEAR + 3 * r + c] = instance.transform[4 * r + c];
        row[INSTANCE_NORMAL + 3 * r + c] = static_cast<float>(d.inverse[3 * c + r]);
      }
      row[INSTANCE_TRANSLATION + r] = instance.transform[4 * r + 3];
      row[INSTANCE_ERROR + r] = static_cast<float>(d.error[r]);
    }
    row[INSTANCE_SIDE] = d.mirrored ? -1.0f : 1.0f;
    row += INSTANCE_WORDS;
  }
  return rows;
}

std::array<cl_uint, 2> pack_media(const std::vector<std::uint32_t>& ranks) {
  std::array<cl_uint, 4> rank{};
  std::copy_n(ranks.begin(), std::min<std::size_t>(ranks.size(), 4), rank.begin());
  return {rank[0] << 16 | rank[1], rank[2] << 16 | rank[3]};
}

void add_media_of_lights(const scene::MediumFinder& media, LightTables& lights) {
  if (lights.emission.empty()) return;
  const std::size_t rows = lights.emitters.size() / EMITTER_WORDS;
  const std::size_t entries = lights.emission.size() - EMISSION_HEADER;
  constexpr double kBudget = 2e8;
  const bool affordable = static_cast<double>(rows) * static_cast<double>(media.triangles()) <= kBudget;
  for (std::size_t i = 0; i < entries; ++i) {
    std::array<cl_uint, 2> words{};
    if (i < rows && affordable) {
      const float* row = &lights.emitters[i * EMITTER_WORDS];
      std::uint32_t triangle = 0, cluster = 0, kind = 0;
      std::memcpy(&triangle, row + EMITTER_TRIANGLE, 4);
      std::memcpy(&cluster, row + EMITTER_CLUSTER, 4);
      cluster &= ~EMITTER_TWO_SIDED;
      std::memcpy(&kind, &lights.clusters[cluster * CLUSTER_WORDS + CLUSTER_KIND], 4);
      std::array<double, 3> at{};
      for (std::size_t k = 0; k < 3; ++k)
        at[k] = triangle == GLEANER_NONE
                    ? double{row[EMITTER_POSITION + k]}
                    : row[EMITTER_P0 + k] + (double{row[EMITTER_E1 + k]} + row[EMITTER_E2 + k]) / 3;
      if (kind != CLUSTER_DIRECTIONAL) words = pack_media(media.at(at));
    }
    for (const cl_uint word : words) lights.emission.push_back(std::bit_cast<float>(word));
  }
}

}  // namespace gleaner::worker

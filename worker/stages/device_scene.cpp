#include "worker/stages/device_scene.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstddef>
#include <cstring>

#include "kernels/path_layout.h"
#include "kernels/scene_layout.h"
#include "scene/model/emission.h"
#include "scene/model/error.h"
#include "scene/model/instances.h"
#include "worker/stages/light_clusters.h"

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

// 256 sRGB bytes decoded, then i / 255 for data that is linear already.
std::array<float, 512> decode_table() {
  std::array<float, 512> table{};
  for (int i = 0; i < 256; ++i) {
    const double c = i / 255.0;
    table[i] = static_cast<float>(c <= 0.04045 ? c / 12.92 : std::pow((c + 0.055) / 1.055, 2.4));
    table[256 + i] = static_cast<float>(c);
  }
  return table;
}

// `media`: as media_by_rank() gives them, where the scene has media.
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

void write_triangles(const scene::Scene& scene, const std::vector<std::uint32_t>& emitters, unsigned words,
                     float* out) {
  constexpr unsigned color_rg[] = {TRIANGLE_COLOR0, TRIANGLE_COLOR1, TRIANGLE_COLOR2_RG};
  constexpr unsigned color_ba[] = {TRIANGLE_COLOR0 + 1, TRIANGLE_COLOR1 + 1, TRIANGLE_COLOR2_BA};
  const bool second_uvs = words == TRIANGLE_WORDS_SECOND_UVS && !scene.second_uvs.empty();
  for (std::size_t t = 0; t < scene.triangle_count(); ++t, out += words) {
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

std::vector<scene::Bounds> boxes_of_instanced(const scene::Scene& scene) {
  std::vector<scene::Bounds> boxes(scene.meshes.size());
  for (std::size_t m = 0; m < boxes.size(); ++m)
    if (scene.meshes[m].instanced) boxes[m] = bounds_of(scene, scene.meshes[m]);
  return boxes;
}

// Rows of kernels/scene_layout.h. `boxes`: about each instanced mesh.
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

// What moves of a mesh's rows: places and normals of the corners.
void write_corners(const scene::Scene& shown, const scene::Mesh& mesh, unsigned words, float* out) {
  for (std::size_t t = mesh.first_triangle; t < std::size_t{mesh.first_triangle} + mesh.triangle_count;
       ++t, out += words)
    for (std::size_t k = 0; k < 3; ++k) {
      const std::size_t vertex = shown.indices[3 * t + k];
      std::memcpy(out + TRIANGLE_P0 + 3 * k, &shown.positions[3 * vertex], 12);
      std::memcpy(out + TRIANGLE_N0 + 3 * k, &shown.normals[3 * vertex], 12);
    }
}

// Ranks take 16 bits.
constexpr std::size_t kMostMedia = 65535;

std::array<cl_uint, 2> pack_media(const std::vector<std::uint32_t>& ranks) {
  std::array<cl_uint, 4> rank{};
  std::copy_n(ranks.begin(), std::min<std::size_t>(ranks.size(), 4), rank.begin());
  return {rank[0] << 16 | rank[1], rank[2] << 16 | rank[3]};
}

// Behind the shares of the lights: what each stands in (kernels/scene_layout.h: EMISSION_HEADER). A lamp is where its
// triangle's middle is. Lights beyond a budget of triangles to be looked at stand in nothing: their paths find out when
// they leave the solid.
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

}  // namespace

std::array<cl_uint, 2> DeviceScene::media_of(const scene::Camera& camera) const {
  if (!media_) return {};
  std::lock_guard lock(media_mutex_);
  if (media_camera_ && std::memcmp(&*media_camera_, &camera, sizeof camera) == 0) return camera_media_;
  const auto at = [&](double x, double y) {
    std::array<double, 3> p;
    for (int k = 0; k < 3; ++k)
      p[k] = camera.origin[k] + x * camera.half_width * camera.right[k] + y * camera.half_height * camera.up[k];
    return media_->at(p);
  };
  std::vector<std::uint32_t> ranks = at(0, 0);
  // The rays of an orthographic camera begin all over its film: in a solid only where that holds all of it.
  if (camera.type == GLEANER_CAMERA_ORTHOGRAPHIC)
    for (const auto& [x, y] : {std::pair{-1, -1}, {-1, 1}, {1, -1}, {1, 1}}) {
      const std::vector<std::uint32_t> others = at(x, y);
      std::erase_if(ranks, [&](const std::uint32_t& r) { return std::ranges::find(others, r) == others.end(); });
    }
  media_camera_ = camera;
  return camera_media_ = pack_media(ranks);
}

cl::Buffer DeviceScene::upload(const Device& device, cl::CommandQueue& queue, const void* data, std::size_t bytes) {
  // Lanes with nothing to look up read row 0: no table is smaller than a row of the largest, which is of albedos.
  constexpr std::size_t least = 1024;
  static_assert(least >= 4 * (GLEANER_ALBEDO_NODES + 1));
  cl::Buffer buffer = device.make_buffer(std::max(bytes, least), CL_MEM_READ_ONLY);
  if (bytes < least) {
    const std::array<std::byte, least> zero{};
    queue.enqueueWriteBuffer(buffer, CL_TRUE, 0, least, zero.data());
  }
  if (bytes) queue.enqueueWriteBuffer(buffer, CL_TRUE, 0, bytes, data);
  bytes_ += std::max(bytes, least);
  return buffer;
}

DeviceScene::DeviceScene(const Device& device, std::shared_ptr<const scene::Scene> scene, const scene::Bvh* bvh)
    : device_(device), scene_(scene) {
  scene::SceneNeeds needs = scene::needs_of(*scene);
  cl::CommandQueue queue = device.make_queue();
  LightTables lights = make_light_tables(*scene);

  triangle_words_ = words_of_triangle(needs);
  const std::size_t triangle_bytes = std::max<std::size_t>(scene->triangle_count(), 1) * 4 * triangle_words_;
  triangles_ = device.make_buffer(triangle_bytes, CL_MEM_READ_ONLY);
  // Written in place: a copy of the largest table would double the scene's memory for a moment.
  auto* rows = static_cast<float*>(queue.enqueueMapBuffer(triangles_, CL_TRUE, CL_MAP_WRITE, 0, triangle_bytes));
  std::memset(rows, 0, 4 * triangle_words_);
  write_triangles(*scene, lights.triangle_emitter, triangle_words_, rows);
  queue.enqueueUnmapMemObject(triangles_, rows);
  queue.finish();
  bytes_ += triangle_bytes;

  const auto bytes_of = [](const auto& v) { return v.size() * sizeof(v[0]); };
  instance_count_ = scene->instances.size();
  instanced_boxes_ = boxes_of_instanced(*scene);
  const std::vector<float> instances = table_of_instances(scene->instances, instanced_boxes_);
  instances_ = upload(device, queue, instances.data(), bytes_of(instances));
  const std::vector<std::uint32_t> media = needs.media ? scene::media_by_rank(*scene) : std::vector<std::uint32_t>{};
  if (media.size() > kMostMedia)
    throw Error::bad_input(scene->name, "solids", "at most " + std::to_string(kMostMedia) + " transmitting materials",
                           std::to_string(media.size()));
  if (needs.media) {
    media_.emplace(scene, media);
    add_media_of_lights(*media_, lights);
  }
  const std::vector<float> materials = material_rows(*scene, media);
  materials_ = upload(device, queue, materials.data(), bytes_of(materials));
  textures_ = upload(device, queue, scene->textures.data(), bytes_of(scene->textures));
  texels_ = upload(device, queue, scene->texels.data(), bytes_of(scene->texels));
  const auto srgb = decode_table();
  srgb_ = upload(device, queue, srgb.data(), sizeof srgb);
  albedo_tables_ = upload(device, queue, scene->albedo_tables.data(), bytes_of(scene->albedo_tables));
  emitters_ = upload(device, queue, lights.emitters.data(), bytes_of(lights.emitters));
  clusters_ = upload(device, queue, lights.clusters.data(), bytes_of(lights.clusters));
  environment_ = upload(device, queue, lights.environment.data(), bytes_of(lights.environment));

  emission_ = upload(device, queue, lights.emission.data(), bytes_of(lights.emission));
  shines_ = !lights.emission.empty();
  for (const scene::Material& material : scene->materials)
    if (material.albedo_table != GLEANER_NONE)
      albedo_rows_[material.albedo_table] = std::max(albedo_rows_[material.albedo_table], material.albedo_rows);
  triangle_count_ = scene->triangle_count();

  if (device.info().trace == TraceKind::embree) {
    tracer_ = make_embree_tracer(*scene, device.info().threads);
  } else {
    if (!bvh) throw Error::failed("the OpenCL tracer needs the scene's BVH");
    tracer_ = make_opencl_tracer(device, *scene, *bvh, triangles_, triangle_words_);
  }

  bool emission_textures = false, alpha_emitters = false;
  for (const auto& material : scene->materials) {
    emission_textures = emission_textures || (material.emission_texture != GLEANER_NONE && needs.emissive_triangles);
    const bool emits = material.emission[0] > 0 || material.emission[1] > 0 || material.emission[2] > 0;
    const bool may_fade = material.flags & (GLEANER_MATERIAL_ALPHA_MASK | GLEANER_MATERIAL_ALPHA_BLEND);
    alpha_emitters = alpha_emitters || (needs.alpha && emits && may_fade &&
                                        (needs.vertex_colors || scene::is_see_through(*scene, material)));
  }
  const std::pair<bool, const char*> words[] = {
      {needs.specular, "SPECULAR"},
      {needs.glossy, "GLOSSY"},
      {needs.metallic, "METALLIC"},
      {needs.clearcoat, "CLEARCOAT"},
      {needs.sheen, "SHEEN"},
      {needs.anisotropy, "ANISOTROPY"},
      {needs.iridescence, "IRIDESCENCE"},
      {needs.transmissive, "TRANSMISSIVE"},
      {needs.rough_transmissive, "ROUGH_TRANSMISSIVE"},
      {needs.panes, "PANES"},
      {needs.media, "MEDIA"},
      {needs.attenuation, "ATTENUATION"},
      {needs.alpha, "ALPHA"},
      {needs.unlit, "UNLIT"},
      {needs.textures, "TEXTURES"},
      {needs.material_textures, "MATERIAL_TEXTURES"},
      {needs.normal_maps, "NORMAL_MAPS"},
      {emission_textures, "EMISSION_TEXTURES"},
      {needs.smooth_normals, "SMOOTH_NORMALS"},
      {needs.vertex_colors, "VERTEX_COLORS"},
      {needs.texture_transforms, "TEXTURE_TRANSFORMS"},
      {needs.second_uvs, "SECOND_UVS"},
      {needs.punctual_lights, "PUNCTUAL_LIGHTS"},
      {needs.emissive_triangles, "EMISSIVE_TRIANGLES"},
      {needs.two_sided_emitters, "TWO_SIDED_EMITTERS"},
      {alpha_emitters, "ALPHA_EMITTERS"},
      {needs.environment, "ENVIRONMENT"},
      {needs.instances, "INSTANCES"},
      {needs.diffuse_transmission, "DIFFUSE_TRANSMISSION"},
  };
  options_ = "-D LANES=" + std::to_string(device.lanes());
  // Lights of no power make no clusters: the scene is as good as without lights.
  for (auto [need, word] : words)
    if (need && (lights.cluster_slots || (std::strcmp(word, "PUNCTUAL_LIGHTS") &&
                                          std::strcmp(word, "EMISSIVE_TRIANGLES") && std::strcmp(word, "ENVIRONMENT"))))
      options_ += std::string(" -D NEED_") + word;
  transparent_shadows_ = (needs.alpha || needs.panes || needs.media) && lights.cluster_slots;
  path_rows_ = needs.media ? MEDIA_PATH_ROWS : transparent_shadows_ ? TRANSPARENT_PATH_ROWS : PLAIN_PATH_ROWS;
  shadow_rows_ = !transparent_shadows_ ? PLAIN_SHADOW_ROWS : needs.media ? MEDIA_SHADOW_ROWS : TRANSPARENT_SHADOW_ROWS;
  if (lights.cluster_slots) options_ += " -D CLUSTERS=" + std::to_string(lights.cluster_slots);
}

MotionReport DeviceScene::move(const scene::Scene& shown, std::span<const std::uint32_t> deformed) {
  const scene::Scene& base = *scene_;
  if (shown.positions.size() != base.positions.size() || shown.indices.size() != base.indices.size() ||
      shown.meshes.size() != base.meshes.size())
    throw Error::failed("a scene that moved has other vertices, triangles or meshes than as it was loaded");
  cl::CommandQueue queue = device_.make_queue();
  for (const std::uint32_t m : deformed) {
    if (m >= base.meshes.size() || !base.meshes[m].deforming)
      throw Error::failed("mesh " + std::to_string(m) + " does not deform");
    const scene::Mesh& mesh = base.meshes[m];
    if (mesh.triangle_count == 0) continue;
    const std::size_t row_bytes = 4 * std::size_t{triangle_words_};
    auto* rows =
        static_cast<float*>(queue.enqueueMapBuffer(triangles_, CL_TRUE, CL_MAP_READ | CL_MAP_WRITE,
                                                   row_bytes * mesh.first_triangle, row_bytes * mesh.triangle_count));
    write_corners(shown, mesh, triangle_words_, rows);
    queue.enqueueUnmapMemObject(triangles_, rows);
  }
  if (!shown.instances.empty()) {
    const std::vector<float> rows = table_of_instances(shown.instances, instanced_boxes_);
    queue.enqueueWriteBuffer(instances_, CL_TRUE, 0, rows.size() * sizeof(float), rows.data());
  }
  queue.finish();
  return tracer_->follow({shown.positions, deformed, shown.instances});
}

bool DeviceScene::has_albedo_row(std::uint32_t table, float row) const {
  if (table == 0 && row == 0) return true;  // every scene has it (upload)
  const auto found = albedo_rows_.find(table);
  return found != albedo_rows_.end() && row >= 0 && row <= static_cast<float>(found->second - 1);
}

void DeviceScene::set_arguments(Kernel& kernel) const {
  kernel.set("triangles", triangles_)
      .set("instances", instances_)
      .set("materials", materials_)
      .set("textures", textures_)
      .set("texels", texels_)
      .set("srgb", srgb_)
      .set("albedo_tables", albedo_tables_)
      .set("emitters", emitters_)
      .set("clusters", clusters_)
      .set("environment", environment_);
}

unsigned DeviceScene::set_arguments(cl::Kernel& kernel, unsigned first) const {
  for (const cl::Buffer* buffer : {&triangles_, &instances_, &materials_, &textures_, &texels_, &srgb_, &albedo_tables_,
                                   &emitters_, &clusters_, &environment_})
    kernel.setArg(first++, *buffer);
  return first;
}

}  // namespace gleaner::worker

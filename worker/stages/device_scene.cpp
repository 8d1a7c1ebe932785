#include "worker/stages/device_scene.h"

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstring>
#include <set>
#include <utility>

#include "kernels/path_layout.h"
#include "kernels/scene_layout.h"
#include "scene/model/emission.h"
#include "scene/model/error.h"
#include "scene/model/instances.h"
#include "worker/stages/scene_tables.h"
#include "worker/wavefront/counters.h"

namespace gleaner::worker {
namespace {

// Ranks take 16 bits.
constexpr std::size_t kMostMedia = 65535;

// Compiler options, one NEED_... a need. Lights of no power make no clusters: then the scene is as good as without
// lights.
std::string kernel_needs(const scene::Scene& scene, const scene::SceneNeeds& needs, bool lit) {
  bool emission_textures = false, alpha_emitters = false;
  for (const auto& material : scene.materials) {
    emission_textures = emission_textures || (material.emission_texture != GLEANER_NONE && needs.emissive_triangles);
    const bool emits = material.emission[0] > 0 || material.emission[1] > 0 || material.emission[2] > 0;
    const bool may_fade = material.flags & (GLEANER_MATERIAL_ALPHA_MASK | GLEANER_MATERIAL_ALPHA_BLEND);
    alpha_emitters = alpha_emitters || (needs.emissive_triangles && needs.alpha && emits && may_fade &&
                                        (needs.vertex_colors || scene::is_see_through(scene, material)));
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
  std::string options;
  for (auto [need, word] : words)
    if (need && (lit || (std::strcmp(word, "PUNCTUAL_LIGHTS") && std::strcmp(word, "EMISSIVE_TRIANGLES") &&
                         std::strcmp(word, "ENVIRONMENT"))))
      options += std::string(" -D NEED_") + word;
  return options;
}

// Those of programs that read no light: the same, whatever shines.
std::string surface_needs(const scene::Scene& scene, scene::SceneNeeds needs) {
  needs.emissive_triangles = needs.two_sided_emitters = needs.punctual_lights = needs.environment = false;
  return kernel_needs(scene, needs, false);
}

}  // namespace

std::string DeviceScene::layout_options() const {
  // Media are asked for together with what refracts: the headers know none without.
  if (path_rows_ == MEDIA_PATH_ROWS) return " -D NEED_SPECULAR -D NEED_TRANSMISSIVE -D NEED_MEDIA -D CLUSTERS=1";
  return path_rows_ == TRANSPARENT_PATH_ROWS ? " -D NEED_ALPHA -D CLUSTERS=1" : "";
}

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

cl::Buffer DeviceScene::upload(cl::CommandQueue& queue, const void* data, std::size_t bytes) {
  // Lanes with nothing to look up read row 0: no table is smaller than a row of the largest, which is of albedos.
  constexpr std::size_t least = 1024;
  static_assert(least >= 4 * (GLEANER_ALBEDO_NODES + 1));
  cl::Buffer buffer = device_.make_buffer(std::max(bytes, least), CL_MEM_READ_ONLY);
  if (bytes < least) {
    const std::array<std::byte, least> zero{};
    queue.enqueueWriteBuffer(buffer, CL_TRUE, 0, least, zero.data());
  }
  if (bytes) queue.enqueueWriteBuffer(buffer, CL_TRUE, 0, bytes, data);
  bytes_ += std::max(bytes, least);
  return buffer;
}

void DeviceScene::load(cl::CommandQueue& queue, Table& table, std::vector<float> rows) {
  if (table.buffer() != nullptr && table.rows.size() == rows.size()) {
    if (rows.empty() || std::memcmp(table.rows.data(), rows.data(), rows.size() * sizeof(float)) == 0) return;
    queue.enqueueWriteBuffer(table.buffer, CL_TRUE, 0, rows.size() * sizeof(float), rows.data());
  } else {
    if (table.buffer() != nullptr) bytes_ -= table.buffer.getInfo<CL_MEM_SIZE>();
    table.buffer = upload(queue, rows.data(), rows.size() * sizeof(float));
  }
  written_bytes_ += rows.size() * sizeof(float);
  table.rows = std::move(rows);
}

DeviceScene::DeviceScene(const Device& device, std::shared_ptr<const scene::Scene> scene, const scene::Bvh* bvh)
    : device_(device),
      vertex_values_(scene->positions.size()),
      corners_(scene->indices.size()),
      meshes_(scene->meshes),
      triangle_count_(scene->triangle_count()),
      instance_count_(scene->instances.size()) {
  cl::CommandQueue queue = device.make_queue();
  const scene::SceneNeeds needs = scene::needs_of(*scene);
  triangle_words_ = words_of_triangle(needs);
  const std::size_t triangle_bytes = std::max<std::size_t>(triangle_count_, 1) * 4 * triangle_words_;
  triangles_ = device.make_buffer(triangle_bytes, CL_MEM_READ_ONLY);
  bytes_ += triangle_bytes;

  const auto bytes_of = [](const auto& v) { return v.size() * sizeof(v[0]); };
  textures_ = upload(queue, scene->textures.data(), bytes_of(scene->textures));
  texels_ = upload(queue, scene->texels.data(), bytes_of(scene->texels));
  const auto srgb = decode_table();
  srgb_ = upload(queue, srgb.data(), sizeof srgb);
  const EnvironmentTable environment = make_environment_table(scene->environment);
  environment_ = upload(queue, environment.rows.data(), bytes_of(environment.rows));
  environment_power_ = environment.power;
  instanced_boxes_ = boxes_of_instanced(*scene);

  const LightTables lights = load_tables(queue, scene, needs);
  // Written in place: a copy of the largest table would double the scene's memory for a moment.
  auto* rows = static_cast<float*>(queue.enqueueMapBuffer(triangles_, CL_TRUE, CL_MAP_WRITE, 0, triangle_bytes));
  std::memset(rows, 0, 4 * triangle_words_);
  write_triangles(*scene, 0, triangle_count_, lights.triangle_emitter, triangle_words_, rows);
  queue.enqueueUnmapMemObject(triangles_, rows);
  queue.finish();
  triangle_emitter_ = lights.triangle_emitter;

  if (device.info().trace == TraceKind::embree) {
    tracer_ = make_embree_tracer(*scene, device.info().threads);
  } else {
    if (!bvh) throw Error::failed("the OpenCL tracer needs the scene's BVH");
    tracer_ = make_opencl_tracer(device, *scene, *bvh, triangles_, triangle_words_);
  }
}

// Everything but triangles, textures and what is traced. Of what is loaded already, only tables that differ are
// written.
LightTables DeviceScene::load_tables(cl::CommandQueue& queue, const std::shared_ptr<const scene::Scene>& scene,
                                     const scene::SceneNeeds& needs) {
  LightTables lights = make_light_tables(*scene, environment_power_);
  const std::vector<std::uint32_t> media = needs.media ? scene::media_by_rank(*scene) : std::vector<std::uint32_t>{};
  if (media.size() > kMostMedia)
    throw Error::bad_input(scene->name, "solids", "at most " + std::to_string(kMostMedia) + " transmitting materials",
                           std::to_string(media.size()));
  media_.reset();
  media_camera_.reset();
  if (needs.media) {
    media_.emplace(scene, media);
    add_media_of_lights(*media_, lights);
  }
  load(queue, instances_, table_of_instances(scene->instances, instanced_boxes_));
  load(queue, materials_, material_rows(*scene, media));
  load(queue, albedo_tables_, scene->albedo_tables);
  load(queue, emitters_, lights.emitters);
  load(queue, clusters_, lights.clusters);
  load(queue, emission_, lights.emission);
  shines_ = !lights.emission.empty();
  albedo_rows_.clear();
  for (const scene::Material& material : scene->materials)
    if (material.albedo_table != GLEANER_NONE)
      albedo_rows_[material.albedo_table] = std::max(albedo_rows_[material.albedo_table], material.albedo_rows);
  options_ = "-D LANES=" + std::to_string(device_.lanes()) + kernel_needs(*scene, needs, lights.cluster_slots > 0);
  surface_options_ = "-D LANES=" + std::to_string(device_.lanes()) + surface_needs(*scene, needs);
  if (lights.cluster_slots) options_ += " -D CLUSTERS=" + std::to_string(lights.cluster_slots);
  transparent_shadows_ = (needs.alpha || needs.panes || needs.media) && lights.cluster_slots;
  path_rows_ = needs.media ? MEDIA_PATH_ROWS : transparent_shadows_ ? TRANSPARENT_PATH_ROWS : PLAIN_PATH_ROWS;
  shadow_rows_ = !transparent_shadows_ ? PLAIN_SHADOW_ROWS : needs.media ? MEDIA_SHADOW_ROWS : TRANSPARENT_SHADOW_ROWS;
  return lights;
}

void DeviceScene::check_shown(const scene::Scene& shown, std::span<const std::uint32_t> deformed) const {
  if (shown.positions.size() != vertex_values_ || shown.indices.size() != corners_ ||
      shown.meshes.size() != meshes_.size() || shown.instances.size() != instance_count_)
    throw Error::failed("a scene that moved has other vertices, triangles, meshes or instances than as it was loaded");
  for (const std::uint32_t m : deformed)
    if (m >= meshes_.size() || !meshes_[m].deforming)
      throw Error::failed("mesh " + std::to_string(m) + " does not deform");
}

MotionReport DeviceScene::show(const std::shared_ptr<const scene::Scene>& shown,
                               std::span<const std::uint32_t> deformed) {
  check_shown(*shown, deformed);
  const double start = seconds_now();
  cl::CommandQueue queue = device_.make_queue();
  written_bytes_ = 0;
  const LightTables lights = load_tables(queue, shown, scene::needs_of(*shown));
  std::set<std::uint32_t> rewritten(deformed.begin(), deformed.end());
  for (std::uint32_t m = 0; m < meshes_.size(); ++m) {
    const auto first = static_cast<std::ptrdiff_t>(meshes_[m].first_triangle);
    const auto end = first + static_cast<std::ptrdiff_t>(meshes_[m].triangle_count);
    // Lights of a mesh may have other rows than before, though it stands.
    if (!std::equal(lights.triangle_emitter.begin() + first, lights.triangle_emitter.begin() + end,
                    triangle_emitter_.begin() + first))
      rewritten.insert(m);
  }
  const std::size_t row_bytes = 4 * std::size_t{triangle_words_};
  for (const std::uint32_t m : rewritten) {
    const scene::Mesh& mesh = meshes_[m];
    if (mesh.triangle_count == 0) continue;
    const std::size_t bytes = row_bytes * mesh.triangle_count;
    auto* rows = static_cast<float*>(queue.enqueueMapBuffer(triangles_, CL_TRUE, CL_MAP_WRITE_INVALIDATE_REGION,
                                                            row_bytes * mesh.first_triangle, bytes));
    write_triangles(*shown, mesh.first_triangle, mesh.triangle_count, lights.triangle_emitter, triangle_words_, rows);
    queue.enqueueUnmapMemObject(triangles_, rows);
    written_bytes_ += bytes;
  }
  queue.finish();
  triangle_emitter_ = lights.triangle_emitter;
  const double loaded = seconds_now();
  MotionReport report = tracer_->follow({shown->positions, deformed, shown->instances});
  report.table_seconds = loaded - start;
  report.written_bytes = written_bytes_;
  return report;
}

bool DeviceScene::has_albedo_row(std::uint32_t table, float row) const {
  if (table == 0 && row == 0) return true;  // every scene has it (upload)
  const auto found = albedo_rows_.find(table);
  return found != albedo_rows_.end() && row >= 0 && row <= static_cast<float>(found->second - 1);
}

void DeviceScene::set_arguments(Kernel& kernel) const {
  kernel.set("triangles", triangles_)
      .set("instances", instances_.buffer)
      .set("materials", materials_.buffer)
      .set("textures", textures_)
      .set("texels", texels_)
      .set("srgb", srgb_)
      .set("albedo_tables", albedo_tables_.buffer)
      .set("emitters", emitters_.buffer)
      .set("clusters", clusters_.buffer)
      .set("environment", environment_);
}

unsigned DeviceScene::set_arguments(cl::Kernel& kernel, unsigned first) const {
  for (const cl::Buffer* buffer : {&triangles_, &instances_.buffer, &materials_.buffer, &textures_, &texels_, &srgb_,
                                   &albedo_tables_.buffer, &emitters_.buffer, &clusters_.buffer, &environment_})
    kernel.setArg(first++, *buffer);
  return first;
}

}  // namespace gleaner::worker

#pragma once
// The tables that kernels read of a scene, but for its lights': rows of kernels/scene_layout.h.

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "scene/model/media.h"
#include "scene/model/scene.h"
#include "worker/device/opencl.h"
#include "worker/stages/light_clusters.h"

namespace gleaner::worker {

// 256 sRGB bytes decoded, then i / 255 for data that is linear already.
std::array<float, 512> decode_table();

// `media`: as media_by_rank() gives them, where the scene has media.
std::vector<float> material_rows(const scene::Scene& scene, const std::vector<std::uint32_t>& media);

unsigned words_of_triangle(const scene::SceneNeeds& needs);
// Rows of the triangles [first, first + count), `words` each. `emitters`: LightTables::triangle_emitter.
void write_triangles(const scene::Scene& scene, std::size_t first, std::size_t count,
                     const std::vector<std::uint32_t>& emitters, unsigned words, float* out);

// A row for what stands in the world as it is, then one an instance. `boxes`: about each instanced mesh.
std::vector<float> table_of_instances(std::span<const scene::Instance> instances,
                                      const std::vector<scene::Bounds>& boxes);

// Ranks of solids as kernels keep them (kernels/surface.h: Media).
std::array<cl_uint, 2> pack_media(const std::vector<std::uint32_t>& ranks);

// Behind the shares of the lights: what each stands in (kernels/scene_layout.h: EMISSION_HEADER). A lamp is where its
// triangle's middle is. Lights beyond a budget of triangles to be looked at stand in nothing: their paths find out when
// they leave the solid.
void add_media_of_lights(const scene::MediumFinder& media, LightTables& lights);

}  // namespace gleaner::worker

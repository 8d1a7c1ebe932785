#pragma once
// Directional albedo of the GGX lobe F D V (separable Smith, Schlick), the numbers behind Material::albedo_table.

#include <array>
#include <span>

#include "scene/model/records.h"

namespace gleaner::scene {

// E(mu) = f0 * scale + (1 - f0) * bias at mu = (i + 0.5) / GLEANER_ALBEDO_NODES: Schlick's F is linear in f0, so is E.
struct DirectionalAlbedo {
  std::array<double, GLEANER_ALBEDO_NODES> scale, bias;
};

// alpha = roughness^2 in [0, 1]; alpha 0 is the mirror, E = F(mu). 4096 quasi-random samples of the visible normals a
// node.
DirectionalAlbedo directional_albedo(double alpha);

using AlbedoNodes = std::array<double, GLEANER_ALBEDO_NODES>;

// A Fresnel term, three colours at the half-vector cosines i / (kFresnelNodes - 1); between them linear.
inline constexpr int kFresnelNodes = 257;
using FresnelTable = std::array<std::array<double, 3>, kFresnelNodes>;

// E(mu) of the GGX lobe with `fresnel`, alpha_x along azimuth 0 and alpha_y across, seen from `azimuth` (radians): the
// largest of the three colours.
AlbedoNodes lobe_albedo(double alpha_x, double alpha_y, double azimuth, const FresnelTable& fresnel);

// E(mu) of white sheen (KHR_materials_sheen: Charlie's distribution, Conty and Kulla's shadowing); of narrow lobes it
// exceeds 1 at grazing angles.
AlbedoNodes sheen_albedo(double alpha);

// One row of a table: {1 - s E(mu_i)} for all nodes, then 1 - s M with M = 2 * integral of E(mu) mu.
void albedo_row(const DirectionalAlbedo& albedo, double f0, double specular,
                std::span<float, GLEANER_ALBEDO_NODES + 1> row);

}  // namespace gleaner::scene

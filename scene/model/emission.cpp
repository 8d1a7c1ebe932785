#include "scene/model/emission.h"

#include <algorithm>
#include <cmath>

namespace gleaner::scene {
namespace {

// Mean of a texture's decoded colour.
std::array<float, 3> mean_color(const Scene& scene, gl_uint index) {
  const Texture& texture = scene.textures[index];
  std::array<double, 3> sum{};
  const std::size_t count = std::size_t{texture.width} * texture.height;
  for (std::size_t i = 0; i < count; ++i)
    for (int k = 0; k < 3; ++k) {
      double c = ((scene.texels[texture.first_texel + i] >> (8 * k)) & 255) / 255.0;
      if (texture.flags & GLEANER_TEXTURE_SRGB) c = c <= 0.04045 ? c / 12.92 : std::pow((c + 0.055) / 1.055, 2.4);
      sum[k] += c;
    }
  return {static_cast<float>(sum[0] / count), static_cast<float>(sum[1] / count), static_cast<float>(sum[2] / count)};
}

// Calls `visit` with the alpha of every texel of the material's base colour, or of the material where it has no
// texture, until it says false.
template <typename Visit>
void each_alpha(const Scene& scene, const Material& m, Visit&& visit) {
  if (m.base_color_texture == GLEANER_NONE) {
    visit(m.alpha);
    return;
  }
  const Texture& t = scene.textures[m.base_color_texture];
  const std::uint32_t* texel = scene.texels.data() + t.first_texel;
  const std::size_t count = std::size_t(t.width) * t.height;
  for (std::size_t i = 0; i < count; ++i)
    if (!visit(static_cast<float>(texel[i] >> 24) / 255 * m.alpha)) return;
}

float mean_opacity(const Scene& scene, const Material& m) {
  const bool mask = m.flags & GLEANER_MATERIAL_ALPHA_MASK;
  if (!mask && !(m.flags & GLEANER_MATERIAL_ALPHA_BLEND)) return 1;
  double sum = 0;
  std::size_t count = 0;
  each_alpha(scene, m, [&](float alpha) {
    sum += mask ? (alpha >= m.alpha_cutoff ? 1 : 0) : double{alpha};
    ++count;
    return true;
  });
  return static_cast<float>(sum / static_cast<double>(count));
}

}  // namespace

bool is_see_through(const Scene& scene, const Material& m, float vertex_alpha) {
  const bool mask = m.flags & GLEANER_MATERIAL_ALPHA_MASK;
  if (!mask && !(m.flags & GLEANER_MATERIAL_ALPHA_BLEND)) return false;
  const float opaque_from = mask ? m.alpha_cutoff : 1;
  if (m.alpha * vertex_alpha < opaque_from) return true;
  bool through = false;
  each_alpha(scene, m, [&](float alpha) {
    through = alpha * vertex_alpha < opaque_from;
    return !through;
  });
  return through;
}

std::vector<std::array<float, 3>> mean_emission(const Scene& scene) {
  std::vector<std::array<float, 3>> means(scene.materials.size());
  for (std::size_t i = 0; i < means.size(); ++i) {
    const Material& m = scene.materials[i];
    std::copy(m.emission, m.emission + 3, means[i].begin());
    if (!(m.emission[0] > 0 || m.emission[1] > 0 || m.emission[2] > 0)) continue;
    if (m.emission_texture != GLEANER_NONE) {
      const auto color = mean_color(scene, m.emission_texture);
      for (int k = 0; k < 3; ++k) means[i][k] *= color[k];
    }
    const float opacity = mean_opacity(scene, m);
    for (float& c : means[i]) c *= opacity;
  }
  return means;
}

}  // namespace gleaner::scene

#include "scene/model/albedo_tables.h"

#include <algorithm>
#include <atomic>
#include <cmath>
#include <functional>
#include <map>
#include <numbers>
#include <thread>
#include <vector>

#include "scene/model/albedo.h"
#include "scene/model/thin_film.h"

namespace gleaner::scene {
namespace {

constexpr std::size_t kRow = GLEANER_ALBEDO_NODES + 1;

float alpha_of(float roughness) { return roughness * roughness; }

float row_roughness(gl_uint row) { return static_cast<float>(row) / (GLEANER_ALBEDO_ROWS - 1); }

bool is_lit(const Material& m) {
  const bool opaque_part = m.transmission < 1 || m.transmission_texture != GLEANER_NONE;
  return opaque_part && !(m.flags & GLEANER_MATERIAL_UNLIT);
}

float sheen_of(const Material& m) { return *std::max_element(m.sheen_color, m.sheen_color + 3); }

// Is there a Lambert layer under a dielectric specular lobe, a coat or sheen anywhere on this material?
bool has_coated_layer(const Material& m) {
  const bool dielectric_part = m.metallic < 1 || m.metallic_roughness_texture != GLEANER_NONE;
  return is_lit(m) && dielectric_part && (m.specular > 0 || m.clearcoat > 0 || sheen_of(m) > 0);
}

// More than the plain specular lobe above the layer?
bool is_layered(const Material& m) {
  return m.clearcoat > 0 || sheen_of(m) > 0 || m.iridescence > 0 || m.anisotropy > 0;
}

bool has_levels(const Material& m) {
  return (m.clearcoat > 0 && m.clearcoat_texture != GLEANER_NONE) ||
         (sheen_of(m) > 0 && m.sheen_color_texture != GLEANER_NONE) ||
         (m.iridescence > 0 && m.iridescence_texture != GLEANER_NONE);
}

gl_uint roughness_rows(const Material& m) {
  return m.metallic_roughness_texture == GLEANER_NONE ? 1 : GLEANER_ALBEDO_ROWS;
}

// The roughness of row r of `rows`.
float roughness_of_row(float plain, gl_uint rows, gl_uint r) { return rows == 1 ? plain : row_roughness(r); }

// A few milliseconds each, so all cores take part.
void each(std::size_t count, const std::function<void(std::size_t)>& work) {
  std::atomic<std::size_t> next = 0;
  const auto run = [&] {
    for (std::size_t i; (i = next++) < count;) work(i);
  };
  std::vector<std::jthread> helpers;
  const std::size_t threads = std::min<std::size_t>(count, std::max(1u, std::thread::hardware_concurrency()));
  for (std::size_t i = 1; i < threads; ++i) helpers.emplace_back(run);
  run();
}

// Schlick's, or that of the material's film at `thickness` nm.
FresnelTable fresnel_table(const Material& m, bool film, double thickness) {
  FresnelTable table;
  for (int i = 0; i < kFresnelNodes; ++i) {
    const double cosine = static_cast<double>(i) / (kFresnelNodes - 1);
    if (film) {
      table[i] = thin_film(cosine, m.iridescence_ior, thickness, {m.f0[0], m.f0[1], m.f0[2]});
      continue;
    }
    for (std::size_t c = 0; c < 3; ++c) table[i][c] = m.f0[c] + (1 - m.f0[c]) * std::pow(1 - cosine, 5);
  }
  return table;
}

// The largest reflectance among the thicknesses that the film may have.
FresnelTable film_table(const Material& m) {
  FresnelTable largest = fresnel_table(m, true, m.iridescence_maximum);
  if (m.iridescence_thickness_texture == GLEANER_NONE) return largest;
  constexpr int kThicknesses = 32;
  for (int t = 0; t < kThicknesses; ++t) {
    const FresnelTable one = fresnel_table(
        m, true, std::lerp(double{m.iridescence_minimum}, double{m.iridescence_maximum}, double(t) / kThicknesses));
    for (int i = 0; i < kFresnelNodes; ++i)
      for (std::size_t c = 0; c < 3; ++c) largest[i][c] = std::max(largest[i][c], one[i][c]);
  }
  return largest;
}

// E of a lobe with a grain: the largest over the azimuths, so that no direction sends more than it gets; and where a
// texture may take the grain away, that of a round lobe as well.
AlbedoNodes grained_albedo(const Material& m, double alpha, const FresnelTable& fresnel) {
  AlbedoNodes largest{};
  alpha = std::max(alpha, double{GLEANER_LEAST_GRAINED_ALPHA});
  const double along = std::lerp(alpha, 1.0, double{m.anisotropy} * m.anisotropy);
  const auto take = [&](double alpha_x, double azimuth) {
    const AlbedoNodes e = lobe_albedo(alpha_x, alpha, azimuth, fresnel);
    for (std::size_t i = 0; i < e.size(); ++i) largest[i] = std::max(largest[i], e[i]);
  };
  for (const double turn : {0.0, 0.125, 0.25}) take(along, 2 * std::numbers::pi * turn);
  if (m.anisotropy_texture != GLEANER_NONE) take(alpha, 0);
  return largest;
}

class TableMaker {
 public:
  explicit TableMaker(Scene& scene) : scene_(scene) {}

  void make() {
    scene_.albedo_tables.clear();
    for (Material& m : scene_.materials) count_rows(m);
    compute();
    for (Material& m : scene_.materials) {
      if (m.albedo_rows != 0) m.albedo_table = is_layered(m) ? layered_table(m) : plain_table(m);
      if (is_lit(m) && m.clearcoat > 0)
        m.clearcoat_table = table({1, m.clearcoat_roughness, coat_rows(m) > 1 ? 1.0f : 0.0f}, coat_rows(m),
                                  [&](gl_uint row, std::span<float, kRow> to) {
                                    write(coat_albedo(roughness_of_row(m.clearcoat_roughness, coat_rows(m), row)), to);
                                  });
      if (is_lit(m) && sheen_of(m) > 0)
        m.sheen_table = table({2, m.sheen_roughness, sheen_rows(m) > 1 ? 1.0f : 0.0f}, sheen_rows(m),
                              [&](gl_uint row, std::span<float, kRow> to) {
                                AlbedoNodes e =
                                    sheen_.at(sheen_alpha(roughness_of_row(m.sheen_roughness, sheen_rows(m), row)));
                                for (double& x : e) x /= GLEANER_SHEEN_SCALE;
                                write(e, to);
                              });
    }
  }

 private:
  static gl_uint coat_rows(const Material& m) {
    return m.clearcoat_roughness_texture == GLEANER_NONE ? 1 : GLEANER_ALBEDO_ROWS;
  }
  static gl_uint sheen_rows(const Material& m) {
    return m.sheen_roughness_texture == GLEANER_NONE ? 1 : GLEANER_ALBEDO_ROWS;
  }
  static float sheen_alpha(float roughness) { return std::max(alpha_of(roughness), GLEANER_SHEEN_ALPHA); }

  // The roughnesses that tables of this material name, where its layers have textures: all rows.
  static std::vector<float> roughnesses(float plain, gl_uint rows) {
    std::vector<float> all;
    for (gl_uint row = 0; row < rows; ++row) all.push_back(roughness_of_row(plain, rows, row));
    return all;
  }

  // What stands for a layer's roughness in the table of the diffuse layer: that, or with a texture a few up to it.
  static std::vector<float> few_roughnesses(float plain, gl_uint rows) {
    if (rows == 1) return {plain};
    const gl_uint last = static_cast<gl_uint>(std::lround(plain * (GLEANER_ALBEDO_ROWS - 1)));
    return {0, row_roughness(last / 2), row_roughness(last)};
  }

  void count_rows(Material& m) {
    m.albedo_table = m.clearcoat_table = m.sheen_table = GLEANER_NONE;
    m.albedo_rows = 0;
    if (is_lit(m) && m.clearcoat > 0) {
      for (const float r : roughnesses(m.clearcoat_roughness, coat_rows(m))) by_alpha_[alpha_of(r)];
    }
    if (is_lit(m) && sheen_of(m) > 0)
      for (const float r : roughnesses(m.sheen_roughness, sheen_rows(m))) sheen_[sheen_alpha(r)];
    if (!has_coated_layer(m)) return;
    m.albedo_rows = roughness_rows(m);
    for (const float r : roughnesses(m.roughness, m.albedo_rows)) by_alpha_[alpha_of(r)];
    if (has_levels(m)) m.albedo_rows *= GLEANER_ALBEDO_LEVELS;
  }

  void compute() {
    std::vector<std::function<void()>> work;
    for (auto& [alpha, albedo] : by_alpha_)
      work.push_back([&albedo = albedo, alpha = alpha] { albedo = directional_albedo(alpha); });
    for (auto& [alpha, albedo] : sheen_)
      work.push_back([&albedo = albedo, alpha = alpha] { albedo = sheen_albedo(alpha); });
    each(work.size(), [&](std::size_t i) { work[i](); });
  }

  // The place of the table of this key, which is written where there is none.
  gl_uint table(const std::vector<float>& key, gl_uint rows,
                const std::function<void(gl_uint, std::span<float, kRow>)>& write_row) {
    const auto [place, is_new] = tables_.try_emplace(key, static_cast<gl_uint>(scene_.albedo_tables.size()));
    if (is_new) {
      scene_.albedo_tables.resize(place->second + rows * kRow);
      for (gl_uint row = 0; row < rows; ++row)
        write_row(row, std::span<float, kRow>(&scene_.albedo_tables[place->second + row * kRow], kRow));
    }
    return place->second;
  }

  gl_uint plain_table(const Material& m) {
    const float f0 = *std::max_element(m.f0, m.f0 + 3);
    const bool textured = m.albedo_rows > 1;
    return table({0, float(m.albedo_rows), textured ? 0 : m.roughness, f0, m.specular}, m.albedo_rows,
                 [&](gl_uint row, std::span<float, kRow> to) {
                   albedo_row(by_alpha_.at(alpha_of(roughness_of_row(m.roughness, m.albedo_rows, row))), f0, m.specular,
                              to);
                 });
  }

  static void write(const AlbedoNodes& e, std::span<float, kRow> to) {
    double mean = 0;
    for (std::size_t i = 0; i < e.size(); ++i) {
      to[i] = static_cast<float>(std::clamp(1 - e[i], 0.0, 1.0));
      mean += 2 * (static_cast<double>(i) + 0.5) / GLEANER_ALBEDO_NODES * e[i];
    }
    to[GLEANER_ALBEDO_NODES] = static_cast<float>(std::clamp(1 - mean / GLEANER_ALBEDO_NODES, 0.0, 1.0));
  }

  // E of Schlick's lobe of white f90.
  AlbedoNodes schlick_albedo(float roughness, double f0) const {
    const DirectionalAlbedo& albedo = by_alpha_.at(alpha_of(roughness));
    AlbedoNodes e;
    for (std::size_t i = 0; i < e.size(); ++i) e[i] = f0 * albedo.scale[i] + (1 - f0) * albedo.bias[i];
    return e;
  }
  AlbedoNodes coat_albedo(float roughness) const { return schlick_albedo(roughness, 0.04); }

  // The largest of a few albedos at each node.
  static AlbedoNodes largest(const std::vector<AlbedoNodes>& all) {
    AlbedoNodes most{};
    for (const AlbedoNodes& one : all)
      for (std::size_t i = 0; i < most.size(); ++i) most[i] = std::max(most[i], one[i]);
    return most;
  }

  // What coat, sheen and the lobe together leave: (1 - c Ec) (1 - s Es) (1 - E), which is never more than they do
  // leave, since what passes a layer is the less of what passes it on either way.
  gl_uint layered_table(const Material& m) {
    const std::vector<float> key = {3,
                                    float(m.albedo_rows),
                                    m.roughness,
                                    m.f0[0],
                                    m.f0[1],
                                    m.f0[2],
                                    m.specular,
                                    m.clearcoat,
                                    m.clearcoat_roughness,
                                    float(coat_rows(m)),
                                    m.clearcoat_texture == GLEANER_NONE ? 0.0f : 1.0f,
                                    sheen_of(m),
                                    m.sheen_roughness,
                                    float(sheen_rows(m)),
                                    m.sheen_color_texture == GLEANER_NONE ? 0.0f : 1.0f,
                                    m.anisotropy,
                                    m.anisotropy_texture == GLEANER_NONE ? 0.0f : 1.0f,
                                    m.iridescence,
                                    m.iridescence_ior,
                                    m.iridescence_minimum,
                                    m.iridescence_maximum,
                                    m.iridescence_texture == GLEANER_NONE ? 0.0f : 1.0f,
                                    m.iridescence_thickness_texture == GLEANER_NONE ? 0.0f : 1.0f};
    AlbedoNodes coat{}, sheen{};
    std::vector<AlbedoNodes> some;
    if (m.clearcoat > 0) {
      for (const float r : few_roughnesses(m.clearcoat_roughness, coat_rows(m))) some.push_back(coat_albedo(r));
      coat = largest(some);
    }
    some.clear();
    if (sheen_of(m) > 0) {
      for (const float r : few_roughnesses(m.sheen_roughness, sheen_rows(m))) some.push_back(sheen_.at(sheen_alpha(r)));
      sheen = largest(some);
    }
    const gl_uint rows = roughness_rows(m);
    if (tables_.contains(key)) return tables_.at(key);
    std::vector<AlbedoNodes> plain(rows), film(rows);
    const FresnelTable film_fresnel = m.iridescence > 0 ? film_table(m) : FresnelTable{};
    const FresnelTable schlick = fresnel_table(m, false, 0);
    each(rows, [&](std::size_t row) {
      const float roughness = roughness_of_row(m.roughness, rows, static_cast<gl_uint>(row));
      const double alpha = alpha_of(roughness), f0 = *std::max_element(m.f0, m.f0 + 3);
      plain[row] = m.anisotropy > 0 ? grained_albedo(m, alpha, schlick) : schlick_albedo(roughness, f0);
      if (m.iridescence > 0)
        film[row] =
            m.anisotropy > 0 ? grained_albedo(m, alpha, film_fresnel) : lobe_albedo(alpha, alpha, 0, film_fresnel);
    });
    return table(key, m.albedo_rows, [&](gl_uint row, std::span<float, kRow> to) {
      const double level = has_levels(m) ? double(row / rows) / (GLEANER_ALBEDO_LEVELS - 1) : 1;
      const auto weight = [level](double full, gl_uint texture) {
        return full * (texture == GLEANER_NONE ? 1 : level);
      };
      const double c = weight(m.clearcoat, m.clearcoat_texture), s = weight(sheen_of(m), m.sheen_color_texture),
                   f = weight(m.iridescence, m.iridescence_texture);
      AlbedoNodes taken;
      for (std::size_t i = 0; i < taken.size(); ++i) {
        const double lobe = m.specular * std::lerp(plain[row % rows][i], film[row % rows][i], f);
        taken[i] = 1 - (1 - c * coat[i]) * (1 - s * std::min(sheen[i], 1.0)) * (1 - lobe);
      }
      write(taken, to);
    });
  }

  Scene& scene_;
  std::map<float, DirectionalAlbedo> by_alpha_;
  std::map<float, AlbedoNodes> sheen_;  // by alpha
  std::map<std::vector<float>, gl_uint> tables_;
};

}  // namespace

void make_albedo_tables(Scene& scene) { TableMaker(scene).make(); }

}  // namespace gleaner::scene

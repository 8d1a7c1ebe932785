// The white furnace: a surface in an environment of radiance 1 shows its directional albedo. Coplanar tiles cannot see
// one another, so that one picture measures every kind of material at one angle.

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <functional>

#include "scene/library/builder.h"
#include "scene/library/library.h"
#include "scene/model/albedo.h"
#include "scene/model/thin_film.h"
#include "tests/radiometry/shot.h"

namespace gleaner::test {
namespace {

constexpr double kFamily = 1e-3;

using scene::dielectric;
using scene::grey;
using scene::lambert;
using scene::Material;
using scene::metal;
using scene::SceneBuilder;

// Directional albedo of rough interfaces by quadrature over half-vectors, drawn as D (n.h) is: tan^2 = a^2 u / (1 - u).
// GGX with separable Smith masking; `reflectance` is the Fresnel term of (v.h). Also what refraction lets through to
// the other side, where eta > 0.
struct Rough {
  double reflected = 0, transmitted = 0;
};
Rough integrate(double alpha, double mu, const std::function<double(double)>& reflectance, double eta = 0) {
  constexpr int nu = 1500, nphi = 256;
  const double sine = std::sqrt(1 - mu * mu), a2 = alpha * alpha;
  const auto g1 = [&](double c) { return 2 * c / (c + std::sqrt(a2 + (1 - a2) * c * c)); };
  Rough sum;
  for (int i = 0; i < nu; ++i) {
    // Squeezed towards both ends, where the integrand has roots: u = t^2 (3 - 2 t).
    const double t = (i + 0.5) / nu, u = t * t * (3 - 2 * t), du = 6 * t * (1 - t) / nu;
    const double tangent = alpha * std::sqrt(u / (1 - u)), hz = 1 / std::sqrt(1 + tangent * tangent);
    for (int j = 0; j < nphi; ++j) {
      const double hx = tangent * hz * std::cos(2 * M_PI * (j + 0.5) / nphi);
      const double vh = hx * sine + hz * mu;
      if (vh <= 0) continue;
      const double fresnel = reflectance(vh), common = g1(mu) * vh / (mu * hz) * du / nphi;
      const double lz = 2 * vh * hz - mu;
      if (lz > 0) sum.reflected += common * g1(lz) * fresnel;
      const double sin2 = eta > 0 ? (1 - vh * vh) / (eta * eta) : 1;
      if (sin2 >= 1) continue;
      const double away = std::sqrt(1 - sin2);
      const double tz = (vh / eta - away) * hz - mu / eta;
      if (tz < 0) sum.transmitted += common * g1(-tz) * (1 - fresnel);
    }
  }
  return sum;
}

// The same of a white lobe of alpha_x along the view's azimuth and alpha_y across it.
double grained(double alpha_x, double alpha_y, double mu) {
  constexpr int nu = 1500, nphi = 256;
  const double sine = std::sqrt(1 - mu * mu);
  const auto g1 = [&](double x, double y, double z) {
    return 2 * z / (z + std::sqrt(z * z + alpha_x * alpha_x * x * x + alpha_y * alpha_y * y * y));
  };
  double sum = 0;
  for (int i = 0; i < nu; ++i) {
    const double t = (i + 0.5) / nu, u = t * t * (3 - 2 * t), du = 6 * t * (1 - t) / nu;
    for (int j = 0; j < nphi; ++j) {
      const double phi = 2 * M_PI * (j + 0.5) / nphi, tangent = std::sqrt(u / (1 - u));
      double hx = alpha_x * tangent * std::cos(phi), hy = alpha_y * tangent * std::sin(phi);
      const double hz = 1 / std::sqrt(1 + hx * hx + hy * hy);
      hx *= hz;
      hy *= hz;
      const double vh = hx * sine + hz * mu, lz = 2 * vh * hz - mu;
      if (vh <= 0 || lz <= 0) continue;
      sum += g1(sine, 0, mu) * vh / (mu * hz) * g1(2 * vh * hx - sine, 2 * vh * hy, lz) * du / nphi;
    }
  }
  return sum;
}

double schlick(double f0, double c) { return f0 + (1 - f0) * std::pow(1 - c, 5); }

// Unpolarized, from below 1 / eta or from above.
double fresnel(double c, double eta) {
  const double sin2 = (1 - c * c) / (eta * eta);
  if (sin2 >= 1) return 1;
  const double t = std::sqrt(1 - sin2);
  const double s = (c - eta * t) / (c + eta * t), p = (eta * c - t) / (eta * c + t);
  return (s * s + p * p) / 2;
}

// Of the specular lobe alone; roughness 0 is a mirror.
double lobe(double f0, double roughness, double mu) {
  if (roughness == 0) return schlick(f0, mu);
  return integrate(roughness * roughness, mu, [f0](double c) { return schlick(f0, c); }).reflected;
}

double f0_of(double ior) { return std::pow((ior - 1) / (ior + 1), 2); }

// The layer under the lobe gets what that leaves, E's table being exact or not: s E + base (1 - s E).
double layered(double base, double roughness, double specular, double ior, double mu) {
  const double e = specular * lobe(f0_of(ior), roughness, mu);
  return e + base * (1 - e);
}

struct Tile {
  std::string name;
  Material material;
  std::function<double(double mu)> albedo;
};

Material with(Material m, const std::function<void(Material&)>& change) {
  change(m);
  return m;
}

std::vector<Tile> tiles() {
  std::vector<Tile> all;
  all.push_back({"Lambert, 0.6", lambert(grey(0.6)), [](double) { return 0.6; }});
  for (const double roughness : {0.0, 0.1, 0.3, 0.6, 1.0}) {
    const std::string a = "roughness " + std::to_string(roughness).substr(0, 3);
    all.push_back({"white dielectric, " + a, dielectric(grey(1), roughness), [](double) { return 1; }});
    all.push_back({"dielectric 0.3, " + a, dielectric(grey(0.3), roughness, 1.8),
                   [=](double mu) { return layered(0.3, roughness, 1, 1.8, mu); }});
    all.push_back({"white metal, " + a, metal(grey(1), roughness), [=](double mu) { return lobe(1, roughness, mu); }});
  }
  all.push_back({"metal 0.5, roughness 0.4", metal(grey(0.5), 0.4), [](double mu) { return lobe(0.5, 0.4, mu); }});
  all.push_back({"specular 0.5, base 0.4, roughness 0.5",
                 with(dielectric(grey(0.4), 0.5), [](Material& m) { m.specular = 0.5f; }),
                 [](double mu) { return layered(0.4, 0.5, 0.5, 1.5, mu); }});
  all.push_back({"metallic 0.4, base 0.7, roughness 0.5",
                 with(dielectric(grey(0.7), 0.5), [](Material& m) { m.metallic = 0.4f; }),
                 [](double mu) { return 0.4 * lobe(0.7, 0.5, mu) + 0.6 * layered(0.7, 0.5, 1, 1.5, mu); }});
  const auto transmitting = [](double share, std::uint32_t flags) {
    return [=](Material& m) {
      m.transmission = static_cast<float>(share);
      m.flags = flags;
    };
  };
  all.push_back({"thin glass, white", with(dielectric(grey(1), 0), transmitting(1, 0)), [](double) { return 1; }});
  all.push_back({"thin glass, 0.5", with(dielectric(grey(0.5), 0), transmitting(1, 0)), [](double mu) {
                   const double f = fresnel(mu, 1.5), r = 2 * f / (1 + f);
                   return r + 0.5 * (1 - r);
                 }});
  all.push_back({"half thin glass, half Lambert 0.5",
                 with(lambert(grey(0.5)),
                      [=](Material& m) {
                        transmitting(0.5, 0)(m);
                        m.roughness = 0;
                      }),
                 [](double mu) {
                   const double f = fresnel(mu, 1.5), r = 2 * f / (1 + f);
                   return 0.25 + 0.5 * (r + 0.5 * (1 - r));
                 }});
  // A rough pane reflects and transmits one lobe, to both sides together what its masking leaves of it.
  all.push_back({"0.7 rough thin glass, rest glossy white, roughness 0.3",
                 with(dielectric(grey(1), 0.3), transmitting(0.7, 0)),
                 [](double mu) { return 0.3 + 0.7 * integrate(0.09, mu, [](double) { return 1; }).reflected; }});
  // One face of a solid: radiance is squeezed on its way in, and what comes from below was never squeezed.
  all.push_back({"face of smooth glass, 1.5", with(dielectric(grey(1), 0), transmitting(1, GLEANER_MATERIAL_SOLID)),
                 [](double mu) {
                   const double f = fresnel(mu, 1.5);
                   return f + (1 - f) / (1.5 * 1.5);
                 }});
  all.push_back({"face of rough glass, 1.5, roughness 0.5",
                 with(dielectric(grey(1), 0.5), transmitting(1, GLEANER_MATERIAL_SOLID)), [](double mu) {
                   const Rough e = integrate(
                       0.25, mu, [](double c) { return fresnel(c, 1.5); }, 1.5);
                   return e.reflected + e.transmitted / (1.5 * 1.5);
                 }});
  all.push_back({"opacity 0.3, Lambert 0.4",
                 with(lambert(grey(0.4)),
                      [](Material& m) {
                        m.alpha = 0.3f;
                        m.flags = GLEANER_MATERIAL_ALPHA_BLEND;
                      }),
                 [](double) { return 0.3 * 0.4 + 0.7; }});
  all.push_back({"unlit, 0.25", with(lambert(grey(0.25)), [](Material& m) { m.flags = GLEANER_MATERIAL_UNLIT; }),
                 [](double) { return 0.25; }});
  return all;
}

// Coats, sheen, grain and films. White below them stays white, but where a lobe lies between two of them: what passes a
// layer is the less of what passes it on either way, and a little is lost.
std::vector<Tile> layers() {
  std::vector<Tile> all;
  const auto coat = [](double weight, double roughness) {
    return [=](Material& m) {
      m.clearcoat = static_cast<float>(weight);
      m.clearcoat_roughness = static_cast<float>(roughness);
    };
  };
  const auto sheen = [](double roughness) {
    return [=](Material& m) {
      std::fill(m.sheen_color, m.sheen_color + 3, 1.0f);
      m.sheen_roughness = static_cast<float>(roughness);
    };
  };
  const auto film = [](double share, double nanometres) {
    return [=](Material& m) {
      m.iridescence = static_cast<float>(share);
      m.iridescence_maximum = static_cast<float>(nanometres);
    };
  };
  const auto one = [](double) { return 1; };
  const auto black_under_coat = [](double weight, double roughness) {
    return [=](double mu) { return weight * lobe(0.04, roughness, mu); };
  };
  for (const double roughness : {0.0, 0.3, 0.7}) {
    const std::string a = "roughness " + std::to_string(roughness).substr(0, 3);
    all.push_back({"coat over white, " + a, with(lambert(grey(1)), coat(1, roughness)), one});
    all.push_back({"0.6 coat over white, " + a, with(lambert(grey(1)), coat(0.6, roughness)), one});
    all.push_back(
        {"0.8 coat over black, " + a, with(lambert(grey(0)), coat(0.8, roughness)), black_under_coat(0.8, roughness)});
  }
  // A mirror sends light away at the cosine it came at.
  all.push_back({"coat over a white mirror", with(metal(grey(1), 0), coat(1, 0)), one});
  for (const double roughness : {0.4, 0.7, 1.0})
    all.push_back({"sheen over white, roughness " + std::to_string(roughness).substr(0, 3),
                   with(lambert(grey(1)), sheen(roughness)), one});
  // Green is what the pictures are measured by.
  const auto film_lobe = [](double share, double nanometres, double f0, double roughness, double mu) {
    std::array<double, 3> e{};
    for (std::size_t c = 0; c < 3; ++c)
      e[c] = integrate(roughness * roughness, mu, [&](double cosine) {
               const double plain = schlick(f0, cosine);
               return plain + share * (scene::thin_film(cosine, 1.3, nanometres, {f0, f0, f0})[c] - plain);
             }).reflected;
    return e;
  };
  all.push_back({"film on metal 0.7, roughness 0.4", with(metal(grey(0.7), 0.4), film(1, 450)),
                 [=](double mu) { return film_lobe(1, 450, 0.7, 0.4, mu)[1]; }});
  all.push_back(
      {"film on white dielectric, roughness 0.5", with(dielectric(grey(1), 0.5), film(0.8, 300)), [=](double mu) {
         // The layer gets what the brightest colour leaves.
         const auto e = film_lobe(0.8, 300, f0_of(1.5), 0.5, mu);
         return e[1] + 1 - std::max({e[0], e[1], e[2]});
       }});
  // The tiles have no texture coordinates: their tangent is x, and they are seen from z.
  const double alpha = 0.09, along = alpha + (1 - alpha) * 0.64;
  const auto grain = [](double turn) {
    return [=](Material& m) {
      m.anisotropy = 0.8f;
      m.anisotropy_rotation = static_cast<float>(turn);
    };
  };
  all.push_back({"metal with its grain across the view", with(metal(grey(1), 0.3), grain(0)),
                 [=](double mu) { return grained(alpha, along, mu); }});
  all.push_back({"metal with its grain along the view", with(metal(grey(1), 0.3), grain(M_PI / 2)),
                 [=](double mu) { return grained(along, alpha, mu); }});
  return all;
}

// Sheets that light shines through: what the lobe leaves goes to both sides together.
std::vector<Tile> shining() {
  const auto shines = [](double share, double color) {
    return [=](Material& m) {
      m.diffuse_transmission = static_cast<float>(share);
      std::fill(m.diffuse_transmission_color, m.diffuse_transmission_color + 3, static_cast<float>(color));
    };
  };
  const auto glass = [](Material m, double transmission) {
    m.transmission = static_cast<float>(transmission);
    return m;
  };
  const auto one = [](double) { return 1; };
  Material coated = lambert(grey(1));
  coated.clearcoat = 1;
  return {
      {"Lambert 0.8, 0.3 of it shines through, 0.5", with(lambert(grey(0.8)), shines(0.3, 0.5)),
       [](double) { return 0.7 * 0.8 + 0.3 * 0.5; }},
      {"glossy white, 0.6 shines through", with(dielectric(grey(1), 0.3), shines(0.6, 1)), one},
      {"glossy black, all shines through", with(dielectric(grey(0), 0.5), shines(1, 1)), one},
      {"mirror over white, 0.4 shines through", with(dielectric(grey(1), 0), shines(0.4, 1)), one},
      {"glossy white, 0.5 shines through, 0.25", with(dielectric(grey(1), 0.5), shines(0.5, 0.25)),
       [](double mu) {
         const double e = lobe(f0_of(1.5), 0.5, mu);
         return e + (1 - e) * (0.5 + 0.5 * 0.25);
       }},
      {"metal, through which none shines", with(metal(grey(1), 0.5), shines(0.5, 1)),
       [](double mu) { return lobe(1, 0.5, mu); }},
      {"half smooth thin glass, of the rest 0.4 shines through",
       with(glass(dielectric(grey(1), 0), 0.5), shines(0.4, 1)), one},
      {"0.7 rough thin glass, of the rest 0.4 shines through",
       with(glass(dielectric(grey(1), 0.3), 0.7), shines(0.4, 1)),
       [](double mu) { return 0.3 + 0.7 * integrate(0.09, mu, [](double) { return 1; }).reflected; }},
      {"smooth coat over white, 0.5 shines through", with(coated, shines(0.5, 1)), one},
  };
}

void add_sky(SceneBuilder& b) {
  b.environment(2, [](scene::Vec) { return grey(1); });
}

// Tiles of 1 m along x in the plane y = 0, seen at cosine mu: the picture is one pixel high, four a tile wide.
struct Board {
  std::vector<Tile> all;
  std::shared_ptr<const Scene> scene;
};
Board board(std::vector<Tile> all) {
  SceneBuilder b("white-furnace-board");
  b.mesh("tiles");
  const double half = 8;  // along z: also the most slanted view ends on the tile
  for (std::size_t i = 0; i < all.size(); ++i) {
    const double x = static_cast<double>(i) - static_cast<double>(all.size()) / 2;
    b.quad({x, 0, half}, {x + 1, 0, half}, {x + 1, 0, -half}, {x, 0, -half}, b.material(all[i].name, all[i].material));
  }
  add_sky(b);
  b.orthographic_camera("camera", {0, 1, 0}, {0, -1, 0}, {0, 0, -1}, 1, 1, 16, 16);
  Scene scene = b.finish();
  return {std::move(all), std::make_shared<const Scene>(std::move(scene))};
}

// What the tables of E, their interpolation included, are off by at these cosines.
double table_error(double mu) {
  double worst = 0;
  for (const double roughness : {0.1, 0.3, 0.5, 0.6, 1.0}) {
    const auto albedo = scene::directional_albedo(roughness * roughness);
    const double at = std::clamp(mu * GLEANER_ALBEDO_NODES - 0.5, 0.0, GLEANER_ALBEDO_NODES - 1.001);
    const auto i = static_cast<std::size_t>(at);
    for (const double ior : {1.5, 1.8}) {
      const double f0 = f0_of(ior);
      const auto e = [&](std::size_t k) { return f0 * albedo.scale[k] + (1 - f0) * albedo.bias[k]; };
      const double table = e(i) + (at - static_cast<double>(i)) * (e(i + 1) - e(i));
      worst = std::max(worst, std::abs(table - lobe(f0, roughness, mu)));
    }
  }
  return worst;
}

Picture shoot_board(const Board& b, double mu, std::uint32_t chunks) {
  const auto n = static_cast<std::uint32_t>(b.all.size());
  const double sine = std::sqrt(1 - mu * mu);
  Shot shot{.scene = b.scene};
  // Above the board and away from it, towards +z; the picture is n m wide and n / (4 n) = 1/4 m high.
  shot.camera = orthographic({0, 3 * mu, 3 * sine}, {1, 0, 0}, {0, sine, -mu}, 0.125);
  shot.width = 4 * n;
  shot.height = 1;
  shot.samples = 64;
  shot.chunks = chunks;
  return shoot(shot);
}

void check_board(const Board& b, double mu, std::uint32_t chunks, std::size_t family) {
  const auto n = static_cast<std::uint32_t>(b.all.size());
  const Picture picture = shoot_board(b, mu, chunks);
  const double allowance = table_error(mu);
  std::printf(" cosine %.2f: the tables are within %.1e\n", mu, allowance);
  EXPECT_LT(allowance, 1e-3) << "cosine " << mu;
  bool fine = true;
  for (std::uint32_t i = 0; i < n; ++i) {
    Sample sample;
    picture.add_means(sample, 4 * i, 0, 4 * i + 4, 1, 1);
    fine &= expect_mean(sample, b.all[i].albedo(mu), b.all[i].name, sidak(kFamily, family * n), 4e-3, allowance);
  }
  if (!fine) keep_failure(picture, "board");
}

TEST(WhiteFurnace, EveryMaterial) {
  const Board b = board(tiles());
  for (const double mu : {0.99, 0.6, 0.2}) check_board(b, mu, 128, 3);
}

TEST(WhiteFurnace, SheetsThatLightShinesThrough) {
  const Board b = board(shining());
  for (const double mu : {0.99, 0.6, 0.2}) check_board(b, mu, 128, 3);
}

TEST(WhiteFurnace, EveryLayer) {
  const Board b = board(layers());
  for (const double mu : {0.99, 0.6, 0.2}) check_board(b, mu, 128, 3);
}

// Whatever lies above whatever: nothing sends more than it gets, and white loses little.
TEST(WhiteFurnace, StacksOfLayersGiveNoLight) {
  std::vector<Tile> all;
  for (int i = 0; i < 32; ++i) {
    Material m = i & 1 ? metal(grey(1), 0.5) : dielectric(grey(1), 0.5);
    if (i & 2) m.clearcoat = 1, m.clearcoat_roughness = 0.2f;
    if (i & 4) std::fill(m.sheen_color, m.sheen_color + 3, 1.0f), m.sheen_roughness = 0.25f;
    if (i & 8) m.anisotropy = 0.7f;
    if (i & 16) m.iridescence = 1, m.iridescence_maximum = 350;
    all.push_back({"stack " + std::to_string(i), m, [](double) { return 1; }});
  }
  const Board b = board(all);
  for (const double mu : {0.95, 0.5, 0.15}) {
    const Picture picture = shoot_board(b, mu, 32);
    double least = 1, most = 0;
    for (std::uint32_t i = 0; i < 32; ++i) {
      Sample sample;
      picture.add_means(sample, 4 * i, 0, 4 * i + 4, 1, 1);
      EXPECT_LT(sample.mean, 1 + 2e-3) << all[i].name << ", cosine " << mu;
      EXPECT_GT(sample.mean, i & 17 ? 0.5 : 0.9) << all[i].name << ", cosine " << mu;
      least = std::min(least, sample.mean);
      most = std::max(most, sample.mean);
    }
    std::printf("  cosine %.2f: albedos from %.4f to %.4f\n", mu, least, most);
  }
}

// A variant of the kernels that knows mirrors alone.
TEST(WhiteFurnace, MirrorsAlone) {
  std::vector<Tile> mirror{{"metal 0.7, roughness 0", metal(grey(0.7), 0), [](double mu) { return schlick(0.7, mu); }}};
  check_board(board(mirror), 0.4, 64, 1);
}

// Whatever does not absorb vanishes, whichever way light goes through it: spheres of the scene library.
TEST(WhiteFurnace, ClosedBodiesVanish) {
  struct Case {
    const char* name;
    std::map<std::string, std::string> parameters;
    double allowance;
  };
  // A sphere shows every cosine: grazing ones stand below the tables' first node (1/256 of it).
  const Case cases[] = {{"white dielectric sphere", {{"roughness", "0.4"}}, 1e-3},
                        {"smooth glass sphere", {{"roughness", "0"}, {"transmission", "1"}}, 0}};
  for (const Case& c : cases) {
    Shot shot{.scene = std::make_shared<const Scene>(scene::make_scene("white-furnace", c.parameters))};
    shot.camera = camera_of(*shot.scene);
    shot.width = shot.height = 24;
    shot.chunks = 8;
    const Picture picture = shoot(shot);
    if (!expect_mean(picture.mean(1), 1, c.name, sidak(kFamily, std::size(cases)), 4e-3, c.allowance))
      keep_failure(picture, c.name);
  }
}

}  // namespace
}  // namespace gleaner::test

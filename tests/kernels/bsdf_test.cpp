// Directions drawn by the kernels' BSDFs and environment, against the densities that the same code tells.

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <functional>
#include <random>

#include "scene/library/builder.h"
#include "scene/model/thin_film.h"
#include "tests/kernels/kernel_bench.h"
#include "tests/radiometry/statistics.h"

namespace gleaner::test {
namespace {

constexpr double kFamily = 1e-3;
constexpr std::size_t kDraws = 1'000'000;

constexpr const char* kText = R"CL(
#include "kernels/bsdf.h"

FN vu lane_id(void) { return (vu)((uint)get_global_id(0) * LANES) + lane_index(); }
FN void numbers(uint seed, vu i, uint dimension, vf* u0, vf* u1) {
  sample_pair(hash_combine((vu)seed, i), (vu)0u, 1u, dimension, u0, u1);
}

kernel void visible_normals(uint seed, float vx, float vy, float vz, float alpha, global float* x, global float* y,
                            global float* z) {
  vu i = lane_id();
  vf u0, u1;
  numbers(seed, i, 0u, &u0, &u1);
  v3 h = sample_visible_normal(uniform3(vx, vy, vz), (vf)alpha, (vf)alpha, u0, u1);
  scatter_f(x, i, h.x);
  scatter_f(y, i, h.y);
  scatter_f(z, i, h.z);
}

#ifdef NEED_LOBE
FN Surface surface_of(const Scene* scene, uint material, uint from_back, v3 v) {
  vf w[16];
  load_words(scene->materials, (vu)(material * MATERIAL_WORDS), w);
  Surface m;
  m.base = words3(w, MATERIAL_BASE_COLOR);
  m.opacity = one_f();
  m.metallic = w[MATERIAL_METALLIC];
  m.specular = w[MATERIAL_SPECULAR];
  m.alpha = w[MATERIAL_ROUGHNESS] * w[MATERIAL_ROUGHNESS];
  m.alpha2 = m.alpha * m.alpha;
  m.f0 = words3(w, MATERIAL_F0);
  m.table = as_vu(w[MATERIAL_ALBEDO_TABLE]);
  m.table_row = zero_f();
  global const float* row = scene->materials + material * MATERIAL_WORDS;
#ifdef NEED_ANISOTROPY
  vf strength = (vf)row[MATERIAL_ANISOTROPY];
  m.alpha_along = mix(m.alpha, one_f(), strength * strength);
  m.grain_x = cos((vf)row[MATERIAL_ANISOTROPY_ROTATION]);
  m.grain_y = sin((vf)row[MATERIAL_ANISOTROPY_ROTATION]);
#endif
#ifdef NEED_IRIDESCENCE
  m.film = (vf)row[MATERIAL_IRIDESCENCE];
  m.film_ior = (vf)row[MATERIAL_IRIDESCENCE_IOR];
  m.film_thickness = (vf)row[MATERIAL_IRIDESCENCE_MAXIMUM];
#endif
#ifdef NEED_CLEARCOAT
  m.coat = (vf)row[MATERIAL_CLEARCOAT];
  m.coat_alpha = (vf)(row[MATERIAL_CLEARCOAT_ROUGHNESS] * row[MATERIAL_CLEARCOAT_ROUGHNESS]);
  m.coat_normal = uniform3(0.0f, 0.0f, 1.0f);
  m.coat_table = (vu)(((global const uint*)row)[MATERIAL_CLEARCOAT_TABLE]);
  m.coat_row = zero_f();
#endif
#ifdef NEED_SHEEN
  m.sheen = uniform3(row[MATERIAL_SHEEN_COLOR], row[MATERIAL_SHEEN_COLOR + 1], row[MATERIAL_SHEEN_COLOR + 2]);
  m.sheen_most = max_component(m.sheen);
  m.sheen_alpha = max_f((vf)(row[MATERIAL_SHEEN_ROUGHNESS] * row[MATERIAL_SHEEN_ROUGHNESS]), (vf)GLEANER_SHEEN_ALPHA);
  m.sheen_table = (vu)(((global const uint*)row)[MATERIAL_SHEEN_TABLE]);
  m.sheen_row = zero_f();
#endif
#ifdef NEED_LAYERS
  prepare_layers(scene, &m, v);
#endif
#ifdef NEED_TRANSMISSIVE
  m.transmission = w[MATERIAL_TRANSMISSION];
  m.ior = w[MATERIAL_IOR];
  m.solid = (as_vu(w[MATERIAL_FLAGS]) & GLEANER_MATERIAL_SOLID) != 0u;
  m.eta = pick(m.ior, one_f() / m.ior, m.solid & ((vu)from_back != 0u));
  m.blurs = m.alpha > zero_f();
  m.hidden = no_lanes();
#endif
  prepare_lobe(scene, &m, v.z);
  return m;
}

// BSDF times |n.l| in either hemisphere, and its density.
FN v3 eval_all(const Scene* scene, const Surface* m, v3 v, v3 l, vf* pdf) {
  vi above = l.z > zero_f();
  v3 f = eval_bsdf(scene, m, v, make3(l.x, l.y, fabs(l.z)), pdf);
  f = pick3(splat3(zero_f()), f, above);
  *pdf = pick(zero_f(), *pdf, above);
#ifdef NEED_ROUGH_TRANSMISSIVE
  vf glass_pdf;
  v3 glass = eval_glass(m, v, l, &glass_pdf);
  *pdf = mix(*pdf, glass_pdf, m->transmission);
  f = mad3(glass, m->transmission, scale3(f, one_f() - m->transmission));
#endif
  return f;
}

kernel void draw(SCENE_PARAMETERS, uint material, uint from_back, uint seed, float vx, float vy, float vz, global float* x,
                 global float* y, global float* z, global float* pdf, global float* weight) {
  Scene scene_value = SCENE_FROM_PARAMETERS;
  Surface m = surface_of(&scene_value, material, from_back, uniform3(vx, vy, vz));
  vu i = lane_id();
  vf u_lobe, u_glass, u0, u1;
  numbers(seed, i, 1u, &u_lobe, &u_glass);
  numbers(seed, i, 2u, &u0, &u1);
  BsdfSample s = sample_bsdf(&scene_value, &m, uniform3(vx, vy, vz), u_lobe, u_glass, u0, u1);
  scatter_f(x, i, s.direction.x);
  scatter_f(y, i, s.direction.y);
  scatter_f(z, i, s.direction.z);
  scatter_f(pdf, i, s.pdf);
  scatter_f(weight, i, s.weight.x);
}

kernel void evaluate(SCENE_PARAMETERS, uint material, uint from_back, float vx, float vy, float vz, global const float* x,
                     global const float* y, global const float* z, global float* pdf, global float* value) {
  Scene scene_value = SCENE_FROM_PARAMETERS;
  Surface m = surface_of(&scene_value, material, from_back, uniform3(vx, vy, vz));
  vu i = lane_id();
  vf p;
  v3 f = eval_all(&scene_value, &m, uniform3(vx, vy, vz), make3(gather_f(x, i), gather_f(y, i), gather_f(z, i)), &p);
  scatter_f(pdf, i, p);
  scatter_f(value, i, f.x);
}
#endif

#ifdef NEED_IRIDESCENCE
kernel void film_reflectance(float ior, float thickness, float f0, global const float* cosine, global float* r,
                             global float* g, global float* b) {
  vu i = lane_id();
  v3 c = thin_film(gather_f(cosine, i), (vf)ior, (vf)thickness, splat3((vf)f0));
  scatter_f(r, i, c.x);
  scatter_f(g, i, c.y);
  scatter_f(b, i, c.z);
}
#endif

#ifdef NEED_ENVIRONMENT
kernel void sky_draw(SCENE_PARAMETERS, uint seed, global float* x, global float* y, global float* z, global float* pdf,
                     global float* again) {
  Scene scene_value = SCENE_FROM_PARAMETERS;
  vu i = lane_id();
  vf u0, u1, p, u, v;
  numbers(seed, i, 3u, &u0, &u1);
  v3 radiance;
  v3 d = environment_sample(&scene_value, u0, u1, &p, &radiance);
  scatter_f(x, i, d.x);
  scatter_f(y, i, d.y);
  scatter_f(z, i, d.z);
  scatter_f(pdf, i, p);
  environment_uv(d, &u, &v);
  scatter_f(again, i, environment_pdf(&scene_value, u, v, safe_sqrt(one_f() - d.y * d.y)));
}

// The density at (u, v) as it is over the map's square: without the sine.
kernel void sky_density(SCENE_PARAMETERS, global const float* u, global const float* v, global float* out) {
  Scene scene_value = SCENE_FROM_PARAMETERS;
  vu i = lane_id();
  scatter_f(out, i, environment_pdf(&scene_value, gather_f(u, i), gather_f(v, i), one_f()));
}
#endif
)CL";

using Direction = std::array<float, 3>;
Direction direction(double mu, double phi) {
  const double s = std::sqrt(1 - mu * mu);
  return {static_cast<float>(s * std::cos(phi)), static_cast<float>(s * std::sin(phi)), static_cast<float>(mu)};
}

double unit_turn(double y, double x) {
  const double t = std::atan2(y, x) / (2 * M_PI);
  return t - std::floor(t);
}
std::size_t cell(double u, std::size_t n) {
  return std::min(static_cast<std::size_t>(std::max(u, 0.0) * static_cast<double>(n)), n - 1);
}

// Nodes and weights of Gauss and Legendre on [0, 1].
std::vector<std::pair<double, double>> gauss(int n) {
  std::vector<std::pair<double, double>> nodes;
  for (int i = 0; i < n; ++i) {
    double x = std::cos(M_PI * (i + 0.75) / (n + 0.5)), slope = 0;
    for (int step = 0; step < 50; ++step) {
      double p0 = 1, p1 = x;
      for (int k = 2; k <= n; ++k) {
        const double p2 = ((2 * k - 1) * x * p1 - (k - 1) * p0) / k;
        p0 = p1;
        p1 = p2;
      }
      slope = n * (x * p1 - p0) / (x * x - 1);
      x -= p1 / slope;
    }
    nodes.emplace_back((x + 1) / 2, 1 / ((1 - x * x) * slope * slope));
  }
  return nodes;
}

struct Board;
class Bsdf : public ::testing::TestWithParam<unsigned> {
 protected:
  Bsdf() : bench_(GetParam()) {}
  std::vector<cl::Buffer> spaces(std::size_t count, std::size_t floats) {
    std::vector<cl::Buffer> made;
    for (std::size_t k = 0; k < count; ++k) made.push_back(bench_.space(floats));
    return made;
  }
  std::vector<std::vector<float>> read(const std::vector<cl::Buffer>& buffers, std::size_t count) {
    std::vector<std::vector<float>> all;
    for (const auto& b : buffers) all.push_back(bench_.read<float>(b, count));
    return all;
  }
  void check_samples(const Board& board, double lowest);
  void check_reciprocity(const Board& board, bool across);
  KernelBench bench_;
};

INSTANTIATE_TEST_SUITE_P(Lanes, Bsdf, ::testing::Values(1u, 16u),
                         [](const auto& lanes) { return "LANES" + std::to_string(lanes.param); });

// Cells in (u, phi) with tan^2 = alpha^2 u / (1 - u), where D (n.h) dh = du dphi / 2 pi; the density of visible normals
// is G1(v) (v.h) / ((n.v) (n.h)) of that.
TEST_P(Bsdf, VisibleNormals) {
  cl::Program program = bench_.build(kText);
  constexpr std::size_t nu = 33, nphi = 37;
  for (const double alpha : {0.04, 0.25, 1.0})
    for (const double mu : {0.95, 0.3, 0.05}) {
      const Direction v = direction(mu, 0.7);
      cl::Kernel kernel(program, "visible_normals");
      auto out = spaces(3, kDraws);
      set_arguments(kernel, 0, cl_uint{31}, v[0], v[1], v[2], static_cast<float>(alpha), out[0], out[1], out[2]);
      bench_.run(kernel, kDraws);
      const auto h = read(out, kDraws);
      std::vector<double> seen(nu * nphi), expected(nu * nphi);
      for (std::size_t i = 0; i < kDraws; ++i) {
        const double x = h[0][i], y = h[1][i], z = h[2][i], t2 = (x * x + y * y) / (z * z);
        ++seen[cell(t2 / (alpha * alpha + t2), nu) * nphi + cell(unit_turn(y, x), nphi)];
      }
      const double g1 = 2 * mu / (mu + std::sqrt(alpha * alpha + (1 - alpha * alpha) * mu * mu));
      // In s = sqrt(1 - u), where the tangent's pole at u = 1 is gone.
      const auto nodes = gauss(16);
      for (std::size_t a = 0; a < nu; ++a) {
        const double low = std::sqrt(1 - (static_cast<double>(a) + 1) / nu),
                     high = std::sqrt(1 - static_cast<double>(a) / nu);
        for (std::size_t b = 0; b < nphi; ++b)
          for (const auto& [x, wx] : nodes)
            for (const auto& [y, wy] : nodes) {
              const double r = low + x * (high - low), phi = 2 * M_PI * (static_cast<double>(b) + y) / nphi;
              const double tangent = alpha * std::sqrt(1 - r * r) / r;
              // (v.h) / (n.h)
              const double ratio = tangent * (v[0] * std::cos(phi) + v[1] * std::sin(phi)) + mu;
              expected[a * nphi + b] += wx * wy * (high - low) * 2 * r / nphi * std::max(0.0, g1 * ratio / mu);
            }
      }
      const double mass = std::accumulate(expected.begin(), expected.end(), 0.0);
      const ChiSquare chi = chi_square(seen, expected);
      std::printf("  alpha %.2f, cosine %.2f: density sums to %.4f, chi-square %.1f of %zu degrees, p = %.3f\n", alpha,
                  mu, mass, chi.statistic, chi.degrees, chi.p);
      EXPECT_NEAR(mass, 1, 1e-3);
      EXPECT_GE(chi.p, sidak(kFamily, 9));
    }
}

struct Board {
  std::vector<std::string> names;
  std::shared_ptr<const scene::Scene> scene;
  // Of solids: light meets them from within.
  bool from_back = false;
};
// Rough glass, thin and solid: both hemispheres.
Board glass(bool from_back) {
  using namespace scene;
  Board board;
  board.from_back = from_back;
  SceneBuilder b("glass");
  const auto add = [&](const std::string& name, Material m) {
    board.names.push_back(name);
    m.transmission = 1;
    const std::uint32_t at = b.material(name, m);
    b.mesh(name);
    b.quad({0, 0, 1}, {1, 0, 1}, {1, 0, 0}, {0, 0, 0}, at);
  };
  add("sheet, roughness 0.3", dielectric(grey(0.8), 0.3));
  add("sheet, roughness 0.7", dielectric(grey(1), 0.7, 1.8));
  add("solid, roughness 0.4", solid_glass(1.5, 0.4));
  add("solid, roughness 0.8", solid_glass(2.2, 0.8));
  add("solid, ior 1.33", solid_glass(1.33, 0.6));
  b.camera("camera", {0, 5, 5}, {}, 40, 16, 16);
  b.point_light({0, 3, 0}, grey(1));
  board.scene = std::make_shared<const Scene>(b.finish());
  return board;
}
Board materials() {
  using namespace scene;
  Board board;
  SceneBuilder b("materials");
  const auto add = [&](const std::string& name, const Material& m) {
    board.names.push_back(name);
    const std::uint32_t at = b.material(name, m);
    b.mesh(name);
    b.quad({0, 0, 1}, {1, 0, 1}, {1, 0, 0}, {0, 0, 0}, at);
  };
  add("Lambert", lambert(grey(0.8)));
  add("dielectric, roughness 0.35", dielectric(grey(0.5), 0.35));
  add("dielectric, roughness 0.6", dielectric(grey(0.9), 0.6));
  add("metal, roughness 0.4", metal(grey(0.7), 0.4));
  add("metal, roughness 1", metal(grey(0.7), 1));
  Material mixed = dielectric(grey(0.4), 0.5);
  mixed.metallic = 0.5f;
  mixed.specular = 0.6f;
  add("half metal", mixed);
  b.camera("camera", {0, 5, 5}, {}, 40, 16, 16);
  b.point_light({0, 3, 0}, grey(1));
  board.scene = std::make_shared<const Scene>(b.finish());
  return board;
}

// Coats, sheen, grain and films, alone and together.
Board layers() {
  using namespace scene;
  Board board;
  SceneBuilder b("layers");
  const auto add = [&](const std::string& name, Material m, const std::function<void(Material&)>& change) {
    change(m);
    board.names.push_back(name);
    const std::uint32_t at = b.material(name, m);
    b.mesh(name);
    b.quad({0, 0, 1}, {1, 0, 1}, {1, 0, 0}, {0, 0, 0}, at);
  };
  const auto coat = [](Material& m) { m.clearcoat = 0.8f, m.clearcoat_roughness = 0.45f; };
  const auto sheen = [](Material& m) { std::fill(m.sheen_color, m.sheen_color + 3, 0.7f), m.sheen_roughness = 0.5f; };
  const auto grain = [](Material& m) { m.anisotropy = 0.7f, m.anisotropy_rotation = 0.6f; };
  const auto film = [](Material& m) { m.iridescence = 0.9f, m.iridescence_maximum = 520; };
  add("coat over Lambert", lambert(grey(1)), coat);
  add("coat over metal", metal(grey(0.9), 0.5), coat);
  add("sheen over Lambert", lambert(grey(1)), sheen);
  add("narrow sheen over dielectric", dielectric(grey(1), 0.5), [&](Material& m) {
    sheen(m);
    m.sheen_roughness = 0.15f;
  });
  add("sheen over metal", metal(grey(1), 0.6), sheen);
  add("grained metal", metal(grey(1), 0.4), grain);
  add("grained dielectric", dielectric(grey(1), 0.45, 1.8), grain);
  add("film on dielectric", dielectric(grey(1), 0.5), film);
  add("film on metal", metal(grey(0.6), 0.5), film);
  add("all", dielectric(grey(1), 0.5), [&](Material& m) {
    coat(m);
    sheen(m);
    grain(m);
    film(m);
    m.metallic = 0.3f;
  });
  b.camera("camera", {0, 5, 5}, {}, 40, 16, 16);
  b.point_light({0, 3, 0}, grey(1));
  board.scene = std::make_shared<const Scene>(b.finish());
  return board;
}

// Directions with cosines from `lowest` to 1.
void Bsdf::check_samples(const Board& board, double lowest) {
  worker::DeviceScene held = bench_.hold(board.scene);
  cl::Program program = bench_.build(kText, held.kernel_options());
  constexpr std::size_t nz = 62, nphi = 45;
  const cl_uint from_back = board.from_back;
  const auto nodes = gauss(14);
  std::vector<float> lx, ly, lz;
  std::vector<double> solid;  // of each node
  for (std::size_t i = 0; i < nz; ++i)
    for (std::size_t j = 0; j < nphi; ++j)
      for (const auto& [x, wx] : nodes)
        for (const auto& [y, wy] : nodes) {
          const Direction l = direction(lowest + (1 - lowest) * (static_cast<double>(i) + x) / nz,
                                        2 * M_PI * (static_cast<double>(j) + y) / nphi);
          lx.push_back(l[0]);
          ly.push_back(l[1]);
          lz.push_back(l[2]);
          solid.push_back(wx * wy * 2 * M_PI * (1 - lowest) / (nz * nphi));
        }
  while (lx.size() % 16) lx.push_back(0), ly.push_back(0), lz.push_back(1);
  const cl::Buffer bx = bench_.buffer(lx), by = bench_.buffer(ly), bz = bench_.buffer(lz);
  // One lane at a time is slow: what it may do otherwise than many shows at one angle.
  const std::vector<double> cosines = GetParam() == 1 ? std::vector{0.35} : std::vector{0.9, 0.35, 0.15};
  cl_uint material = 0;
  for (const std::string& name : board.names) {
    for (const double mu : cosines) {
      const Direction v = direction(mu, 2.1);
      cl::Kernel evaluate(program, "evaluate"), draw(program, "draw");
      auto told = spaces(2, lx.size());
      unsigned at = held.set_arguments(evaluate, 0);
      set_arguments(evaluate, at, material, from_back, v[0], v[1], v[2], bx, by, bz, told[0], told[1]);
      bench_.run(evaluate, lx.size());
      const auto pdf = bench_.read<float>(told[0], lx.size()), value = bench_.read<float>(told[1], lx.size());
      // The last cell holds what is drawn below the surface, and ends.
      std::vector<double> seen(nz * nphi + 1), expected(nz * nphi + 1);
      double mass = 0, energy = 0;
      const scene::Material& m = board.scene->materials[material];
      const double eta = m.flags & GLEANER_MATERIAL_SOLID ? (board.from_back ? 1 / m.ior : m.ior) : 1;
      for (std::size_t k = 0; k < solid.size(); ++k) {
        // Refracted radiance is squeezed; its power is not.
        energy += value[k] * solid[k] * (lz[k] < 0 ? eta * eta : 1);
        expected[k / (nodes.size() * nodes.size())] += pdf[k] * solid[k];
        mass += pdf[k] * solid[k];
      }
      expected.back() = std::max(0.0, 1 - mass);

      auto out = spaces(5, kDraws);
      at = held.set_arguments(draw, 0);
      set_arguments(draw, at, material, from_back, cl_uint{41} + material, v[0], v[1], v[2], out[0], out[1], out[2],
                    out[3], out[4]);
      bench_.run(draw, kDraws);
      const auto drawn = read(out, kDraws);
      for (std::size_t i = 0; i < kDraws; ++i) {
        if (!(drawn[3][i] > 0)) {
          ASSERT_EQ(drawn[4][i], 0) << "weight without a density";
          ++seen.back();
          continue;
        }
        ++seen[cell((drawn[2][i] - lowest) / (1 - lowest), nz) * nphi +
               cell(unit_turn(drawn[1][i], drawn[0][i]), nphi)];
      }
      // What sample_bsdf says of its sample is what eval_bsdf says of that direction.
      evaluate.setArg(at + 5, out[0]);
      evaluate.setArg(at + 6, out[1]);
      evaluate.setArg(at + 7, out[2]);
      auto again = spaces(2, kDraws);
      evaluate.setArg(at + 8, again[0]);
      evaluate.setArg(at + 9, again[1]);
      bench_.run(evaluate, kDraws);
      const auto same = read(again, kDraws);
      double worst = 0;
      for (std::size_t i = 0; i < kDraws; ++i)
        if (drawn[3][i] > 0)
          worst = std::max({worst, std::abs(drawn[3][i] / double{same[0][i]} - 1),
                            std::abs(double{drawn[4][i]} * drawn[3][i] / same[1][i] - 1)});
      const ChiSquare chi = chi_square(seen, expected);
      std::printf("  %-28s cosine %.2f: above the surface %.4f, drawn %.4f, chi-square %.1f of %zu, p = %.3f\n",
                  name.c_str(), mu, mass, 1 - seen.back() / kDraws, chi.statistic, chi.degrees, chi.p);
      EXPECT_GE(chi.p, sidak(kFamily, cosines.size() * board.names.size())) << name << ", cosine " << mu;
      // Glass is evaluated by the half-vector that the two directions, rounded, have between them.
      EXPECT_LT(worst, lowest < 0 ? 1e-4 : 1e-5) << name << ": a sample's density or weight is not its direction's";
      EXPECT_LT(mass, 1 + 1e-3) << name;
      EXPECT_LT(energy, 1 + 1e-3) << name << ", cosine " << mu << ": more light leaves than comes";
    }
    ++material;
  }
}

TEST_P(Bsdf, SamplesFollowTheirDensity) { check_samples(materials(), 0); }
TEST_P(Bsdf, SamplesOfLayersFollowTheirDensity) { check_samples(layers(), 0); }
TEST_P(Bsdf, SamplesOfGlassFollowTheirDensity) { check_samples(glass(false), -1); }
TEST_P(Bsdf, SamplesOfGlassFromWithinFollowTheirDensity) { check_samples(glass(true), -1); }

// f(v, l) / n_l^2 = f(l, v) / n_v^2, the indices those of the sides of v and l: 1 for both but across a solid's
// surface.
void Bsdf::check_reciprocity(const Board& board, bool across) {
  worker::DeviceScene held = bench_.hold(board.scene);
  cl::Program program = bench_.build(kText, held.kernel_options());
  std::mt19937 random(3);
  std::uniform_real_distribution<double> unit(0, 1);
  for (cl_uint material = 0; material < board.names.size(); ++material)
    for (int k = 0; k < 8; ++k) {
      const double a = 0.02 + 0.97 * unit(random), b = 0.02 + 0.97 * unit(random);
      const Direction v = direction(a, 6.28 * unit(random)), l = direction(b, 6.28 * unit(random));
      // From unit `from`, in its own frame, to `to`; across the surface: to -to, seen from the front or from the back.
      const auto value = [&](const Direction& from, const Direction& to, bool from_back) {
        const float sign = across ? -1 : 1;
        cl::Kernel kernel(program, "evaluate");
        const cl::Buffer x = bench_.buffer(std::vector<float>(16, sign * to[0])),
                         y = bench_.buffer(std::vector<float>(16, sign * to[1])),
                         z = bench_.buffer(std::vector<float>(16, sign * to[2]));
        auto told = spaces(2, 16);
        const unsigned at = held.set_arguments(kernel, 0);
        set_arguments(kernel, at, material, cl_uint{from_back}, from[0], from[1], from[2], x, y, z, told[0], told[1]);
        bench_.run(kernel, 16);
        return bench_.read<float>(told[1], 16)[0] / double{to[2]};
      };
      const scene::Material& m = board.scene->materials[material];
      const double eta = across && (m.flags & GLEANER_MATERIAL_SOLID) ? m.ior : 1;
      const double there = value(v, l, board.from_back) * eta * eta, back = value(l, v, across != board.from_back);
      EXPECT_NEAR(there, back, 5e-5 * there) << board.names[material] << ", cosines " << a << " and " << b;
    }
}
TEST_P(Bsdf, Reciprocal) { check_reciprocity(materials(), false); }
TEST_P(Bsdf, LayersAreReciprocal) { check_reciprocity(layers(), false); }
TEST_P(Bsdf, GlassIsReciprocal) {
  check_reciprocity(glass(false), false);
  check_reciprocity(glass(false), true);
}

// The kernels' film against that of the tables, in double precision.
TEST_P(Bsdf, FilmsAsTheTablesHaveThem) {
  cl::Program program = bench_.build(kText, "-D NEED_IRIDESCENCE -D NEED_GLOSSY");
  std::vector<float> cosines;
  for (int i = 0; i < 256; ++i) cosines.push_back(static_cast<float>(i) / 255);
  const cl::Buffer in = bench_.buffer(cosines);
  double worst = 0;
  for (const double ior : {1.0, 1.3, 2.2})
    for (const double thickness : {0.0, 120.0, 400.0, 1200.0, 20000.0})
      for (const double f0 : {0.0, 0.04, 0.6, 1.0}) {
        cl::Kernel kernel(program, "film_reflectance");
        auto out = spaces(3, cosines.size());
        set_arguments(kernel, 0, static_cast<float>(ior), static_cast<float>(thickness), static_cast<float>(f0), in,
                      out[0], out[1], out[2]);
        bench_.run(kernel, cosines.size());
        const auto found = read(out, cosines.size());
        for (std::size_t i = 0; i < cosines.size(); ++i) {
          const auto expected = scene::thin_film(cosines[i], ior, thickness, {f0, f0, f0});
          for (std::size_t c = 0; c < 3; ++c) worst = std::max(worst, std::abs(found[c][i] - expected[c]));
        }
      }
  std::printf("  films differ by %.1e at most\n", worst);
  EXPECT_LT(worst, 2e-4);
}

TEST_P(Bsdf, EnvironmentSamples) {
  using namespace scene;
  SceneBuilder b("sky");
  b.mesh("m");
  b.quad({0, 0, 1}, {1, 0, 1}, {1, 0, 0}, {0, 0, 0}, b.material("m", lambert(grey(0.5))));
  b.camera("camera", {0, 5, 5}, {}, 40, 16, 16);
  Scene made = b.finish();
  constexpr std::uint32_t w = 19, h = 11;
  made.environment = {w, h, {}};
  for (std::uint64_t i = 0; i < w * h; ++i) {
    // A third of the map is black, one texel a sun; one row is black altogether, its neighbours too.
    double level = hash_unit(i, 0) < 0.33 || (i / w >= 6 && i / w <= 8) ? 0 : hash_unit(i, 1);
    if (i == 3 * w + 18) level = 500;
    for (int k = 0; k < 3; ++k) made.environment.radiance.push_back(static_cast<float>(level));
  }
  worker::DeviceScene held = bench_.hold(std::make_shared<const Scene>(std::move(made)));
  cl::Program program = bench_.build(kText, held.kernel_options());

  std::vector<float> u, v;
  for (std::uint32_t y = 0; y < h; ++y)
    for (std::uint32_t x = 0; x < w; ++x) {
      u.push_back((static_cast<float>(x) + 0.5f) / w);
      v.push_back((static_cast<float>(y) + 0.5f) / h);
    }
  while (u.size() % 16) u.push_back(0.5f), v.push_back(0.5f);
  cl::Kernel ask(program, "sky_density"), draw(program, "sky_draw");
  const cl::Buffer bu = bench_.buffer(u), bv = bench_.buffer(v);
  const cl::Buffer told = bench_.space(u.size());
  set_arguments(ask, held.set_arguments(ask, 0), bu, bv, told);
  bench_.run(ask, u.size());
  const auto density = bench_.read<float>(told, u.size());

  // A texel's density in (u, v) is even: 2 pi^2 times that per steradian without its sine.
  constexpr std::size_t nu = 37, nv = 23;
  std::vector<double> expected(nu * nv), seen(nu * nv);
  double mass = 0;
  const auto overlap = [](std::size_t i, std::size_t n, std::size_t k, std::size_t m) {
    return std::max(0.0, std::min((i + 1.0) / double(n), (k + 1.0) / double(m)) -
                             std::max(double(i) / double(n), double(k) / double(m)));
  };
  for (std::size_t y = 0; y < h; ++y)
    for (std::size_t x = 0; x < w; ++x) {
      const double even = density[y * w + x] * 2 * M_PI * M_PI;
      mass += even / (w * h);
      for (std::size_t i = 0; i < nu; ++i)
        for (std::size_t j = 0; j < nv; ++j) expected[i * nv + j] += even * overlap(x, w, i, nu) * overlap(y, h, j, nv);
    }
  auto out = spaces(5, kDraws);
  set_arguments(draw, held.set_arguments(draw, 0), cl_uint{51}, out[0], out[1], out[2], out[3], out[4]);
  bench_.run(draw, kDraws);
  const auto drawn = read(out, kDraws);
  std::size_t apart = 0;
  for (std::size_t i = 0; i < kDraws; ++i) {
    // scene.h: d = (sin t sin p, cos t, -sin t cos p).
    const double column = unit_turn(drawn[0][i], -drawn[2][i]),
                 row = std::acos(std::clamp(double{drawn[1][i]}, -1.0, 1.0)) / M_PI;
    ++seen[cell(column, nu) * nv + cell(row, nv)];
    ASSERT_GT(drawn[3][i], 0);
    apart += !(std::abs(drawn[3][i] / double{drawn[4][i]} - 1) < 1e-3);
  }
  const ChiSquare chi = chi_square(seen, expected);
  std::printf(
      "  density sums to %.6f, chi-square %.1f of %zu degrees, p = %.3f; %zu of %zu told otherwise when asked\n", mass,
      chi.statistic, chi.degrees, chi.p, apart, kDraws);
  EXPECT_NEAR(mass, 1, 1e-5);
  EXPECT_GE(chi.p, kFamily);
  // Rounding may carry a direction over its texel's edge.
  EXPECT_LT(apart, kDraws / 10000);
}

}  // namespace
}  // namespace gleaner::test

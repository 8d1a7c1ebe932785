// Choosing a light and a point on it: chances, densities and what they add up to, as the kernels compute them.

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstdio>
#include <random>

#include "kernels/scene_layout.h"
#include "scene/library/builder.h"
#include "scene/library/library.h"
#include "tests/kernels/kernel_bench.h"
#include "tests/radiometry/statistics.h"
#include "worker/stages/light_clusters.h"

namespace gleaner::test {
namespace {

constexpr double kFamily = 1e-3;

constexpr const char* kText = R"CL(
#include "kernels/lights.h"
#include "kernels/bsdf.h"

FN vu lane_id(void) { return (vu)((uint)get_global_id(0) * LANES) + lane_index(); }
FN v3 point_of(global const float* p, vu i) { return gather3(p, i * 3u); }

// Rows of 12: direction, target, pdf, radiance, 1 = delta | 2 = infinite, total.
FN void give(global float* out, vu i, LightSample light) {
  vf flags = pick(zero_f(), one_f(), light.delta) + pick(zero_f(), (vf)2.0f, light.infinite);
  vf all[12] = {light.direction.x, light.direction.y, light.direction.z, light.target.x, light.target.y, light.target.z,
                light.pdf, light.radiance.x, light.radiance.y, light.radiance.z, flags, light.total};
  for (uint k = 0; k < 12u; ++k) scatter_f(out, i * 12u + k, all[k]);
}

kernel void draw(SCENE_PARAMETERS, uint seed, float px, float py, float pz, global float* out) {
  Scene scene_value = SCENE_FROM_PARAMETERS;
  vu i = lane_id();
  vf u_choice, unused, u0, u1;
  vu key = hash_combine((vu)seed, i);
  sample_pair(key, (vu)0u, 1u, 0u, &u_choice, &unused);
  sample_pair(key, (vu)0u, 1u, 1u, &u0, &u1);
  give(out, i, sample_light(&scene_value, uniform3(px, py, pz), u_choice, u0, u1));
}

kernel void draw_at(SCENE_PARAMETERS, global const float* p, global const float* u, global float* out) {
  Scene scene_value = SCENE_FROM_PARAMETERS;
  vu i = lane_id();
  give(out, i, sample_light(&scene_value, point_of(p, i), (vf)0.5f, gather_f(u, i * 2u), gather_f(u, i * 2u + 1u)));
}

FN vf chance_of(const Scene* scene, vu emitter, v3 p, vf total) {
  vf e[16];
  load_words(scene->emitters, emitter * EMITTER_WORDS, e);
  return e[EMITTER_PMF] * cluster_importance_at(scene, emitter_cluster(e), p) / total;
}

// The chances of all emitters at one point; at many points their sum, the environment's included.
kernel void chances(SCENE_PARAMETERS, uint emitter_count, float px, float py, float pz, global float* out) {
  Scene scene_value = SCENE_FROM_PARAMETERS;
  vu i = lane_id();
  v3 p = uniform3(px, py, pz);
  vf total = sample_light(&scene_value, p, (vf)0.5f, (vf)0.5f, (vf)0.5f).total;
  scatter_f(out, i, chance_of(&scene_value, min(i, (vu)(emitter_count - 1u)), p, total));
}
kernel void sums(SCENE_PARAMETERS, uint emitter_count, global const float* points, global float* out) {
  Scene scene_value = SCENE_FROM_PARAMETERS;
  vu i = lane_id();
  v3 p = point_of(points, i);
  vf total = sample_light(&scene_value, p, (vf)0.5f, (vf)0.5f, (vf)0.5f).total;
  vf sum = zero_f();
  for (uint e = 0; e < emitter_count; ++e) sum += chance_of(&scene_value, (vu)e, p, total);
#ifdef NEED_ENVIRONMENT
  sum += environment_chance(&scene_value, total);
#endif
  scatter_f(out, i, sum);
}

#ifdef NEED_EMISSIVE_TRIANGLES
kernel void ask(SCENE_PARAMETERS, float px, float py, float pz, global const uint* emitter, global const float* rows,
                global const float* distance, global float* out) {
  Scene scene_value = SCENE_FROM_PARAMETERS;
  vu i = lane_id();
  v3 w = gather3(rows, i * 12u);
  vf e[16];
  load_words(emitters, gather_u(emitter, i) * EMITTER_WORDS, e);
  scatter_f(out, i, light_pdf(&scene_value, e, uniform3(px, py, pz), w, gather_f(distance, i),
                              gather_f(rows, i * 12u + 11u)));
}
#endif
)CL";

using scene::Vec;
constexpr std::size_t kRow = 12;

struct Held {
  std::shared_ptr<const scene::Scene> scene;
  worker::LightTables tables;
  std::uint32_t emitters = 0;
  bool environment = false;

  explicit Held(scene::Scene made) : scene(std::make_shared<const scene::Scene>(std::move(made))) {
    tables = worker::make_light_tables(*scene, worker::make_environment_table(scene->environment).power);
    environment = !scene->environment.empty();
    for (unsigned c = 0; c < tables.cluster_slots; ++c) {
      std::uint32_t count;
      std::memcpy(&count, &tables.clusters[c * CLUSTER_WORDS + CLUSTER_COUNT], 4);
      emitters += count;
    }
  }
  const float* row(std::uint32_t e) const { return &tables.emitters[std::size_t{e} * EMITTER_WORDS]; }
  Vec vec(std::uint32_t e, unsigned word) const {
    const float* r = row(e) + word;
    return {r[0], r[1], r[2]};
  }
  std::uint32_t kind(std::uint32_t e) const {
    std::uint32_t cluster, k;
    std::memcpy(&cluster, row(e) + EMITTER_CLUSTER, 4);
    cluster &= ~EMITTER_TWO_SIDED;
    std::memcpy(&k, &tables.clusters[cluster * CLUSTER_WORDS + CLUSTER_KIND], 4);
    return k;
  }
  // Of a triangle: does it shine on p?
  bool faces(std::uint32_t e, Vec p) const {
    std::uint32_t cluster;
    std::memcpy(&cluster, row(e) + EMITTER_CLUSTER, 4);
    const double side = scene::dot(scene::cross(vec(e, EMITTER_E1), vec(e, EMITTER_E2)), p - vec(e, EMITTER_P0));
    return side > 0 || (side < 0 && (cluster & EMITTER_TWO_SIDED) != 0);
  }
};

// One of everything: lamps, a point, a spot, a sun and a sky.
scene::Scene everything() {
  scene::Scene made = scene::make_scene("punctual-lights");
  const scene::Scene lamps = scene::make_scene("many-lights", {{"lights", "30"}});
  const auto vertices = static_cast<std::uint32_t>(made.vertex_count());
  const auto materials = static_cast<std::uint32_t>(made.materials.size());
  made.positions.insert(made.positions.end(), lamps.positions.begin(), lamps.positions.end());
  made.normals.insert(made.normals.end(), lamps.normals.begin(), lamps.normals.end());
  for (const std::uint32_t i : lamps.indices) made.indices.push_back(i + vertices);
  for (const std::uint32_t m : lamps.triangle_material) made.triangle_material.push_back(m + materials);
  for (auto mesh : lamps.meshes) {
    mesh.first_triangle += made.meshes.back().first_triangle + made.meshes.back().triangle_count;
    made.meshes.push_back(mesh);
  }
  made.materials.insert(made.materials.end(), lamps.materials.begin(), lamps.materials.end());
  made.material_names.insert(made.material_names.end(), lamps.material_names.begin(), lamps.material_names.end());
  made.environment = {8, 4, {}};
  for (std::uint64_t i = 0; i < 96; ++i)
    made.environment.radiance.push_back(static_cast<float>(scene::hash_unit(i, 9)));
  scene::finish_materials(made);
  return made;
}

// Lamps of which every second shines from both faces, hanging at all heights.
scene::Scene two_sided_lights() {
  scene::Scene made = scene::make_scene("many-lights", {{"lights", "60"}});
  const auto materials = made.materials.size();
  for (std::size_t m = 0; m < materials; ++m) {
    if (!(made.materials[m].emission[0] > 0)) continue;
    made.materials.push_back(made.materials[m]);
    made.material_names.push_back(made.material_names[m] + ", two-sided");
    made.materials.back().flags |= GLEANER_MATERIAL_DOUBLE_SIDED;
    for (std::size_t t = 0; t < made.triangle_count(); ++t)
      if (made.triangle_material[t] == m && t / 2 % 2) made.triangle_material[t] = gl_uint(made.materials.size() - 1);
  }
  return made;
}

const std::vector<std::string> kScenes = {"many-lights", "two-sided-lights", "punctual-lights", "environment-objects",
                                          "everything"};
Held make(const std::string& name) {
  if (name == "everything") return Held(everything());
  if (name == "two-sided-lights") return Held(two_sided_lights());
  if (name == "many-lights") return Held(scene::make_scene(name, {{"lights", "150"}}));
  if (name == "environment-objects") return Held(scene::make_scene(name, {{"width", "64"}}));
  return Held(scene::make_scene(name));
}

std::vector<Vec> points_in(const scene::Scene& scene, std::size_t count) {
  const scene::Bounds b = scene::bounds_of(scene);
  std::vector<Vec> points;
  for (std::uint64_t i = 0; i < count; ++i) {
    double c[3];
    for (int k = 0; k < 3; ++k) {
      // A little beyond the scene on all sides.
      const double t = 1.2 * scene::hash_unit(i, static_cast<std::uint32_t>(k)) - 0.1;
      c[k] = b.lower[k] + t * (b.upper[k] - b.lower[k]);
    }
    points.push_back({static_cast<float>(c[0]), static_cast<float>(c[1]), static_cast<float>(c[2])});
  }
  return points;
}

std::vector<float> flat(const std::vector<Vec>& points) {
  std::vector<float> all;
  for (const Vec& p : points)
    for (const double c : {p.x, p.y, p.z}) all.push_back(static_cast<float>(c));
  return all;
}

// The solid angle of a triangle (Van Oosterom & Strackee 1983).
double solid_angle(Vec p, Vec a, Vec b, Vec c) {
  a = scene::normalize(a - p);
  b = scene::normalize(b - p);
  c = scene::normalize(c - p);
  const double volume = std::abs(scene::dot(a, scene::cross(b, c)));
  return 2 * std::atan2(volume, 1 + scene::dot(a, b) + scene::dot(b, c) + scene::dot(c, a));
}

double form_factor(Vec p, Vec n, const std::array<Vec, 3>& corners) {
  double sum = 0;
  for (int i = 0; i < 3; ++i) {
    const Vec a = scene::normalize(corners[i] - p), b = scene::normalize(corners[(i + 1) % 3] - p);
    const Vec across = scene::cross(a, b);
    const double sine = std::sqrt(scene::dot(across, across));
    if (sine > 0) sum += std::atan2(sine, scene::dot(a, b)) * scene::dot(n, (1 / sine) * across);
  }
  return std::abs(sum) / (2 * M_PI);
}

class Lights : public ::testing::TestWithParam<std::tuple<unsigned, std::string>> {
 protected:
  Lights()
      : bench_(std::get<0>(GetParam())),
        lights_(make(std::get<1>(GetParam()))),
        held_(bench_.hold(lights_.scene)),
        program_(bench_.build(kText, held_.kernel_options())) {}

  // `count` light samples at p.
  std::vector<float> draw(Vec p, cl_uint seed, std::size_t count) {
    cl::Kernel kernel(program_, "draw");
    const cl::Buffer out = bench_.space(count * kRow);
    set_arguments(kernel, held_.set_arguments(kernel, 0), seed, static_cast<float>(p.x), static_cast<float>(p.y),
                  static_cast<float>(p.z), out);
    bench_.run(kernel, count);
    return bench_.read<float>(out, count * kRow);
  }
  std::vector<float> chances(Vec p) {
    const std::size_t count = (std::max(lights_.emitters, 1u) + 15) / 16 * 16;
    cl::Kernel kernel(program_, "chances");
    const cl::Buffer out = bench_.space(count);
    set_arguments(kernel, held_.set_arguments(kernel, 0), std::max(lights_.emitters, 1u), static_cast<float>(p.x),
                  static_cast<float>(p.y), static_cast<float>(p.z), out);
    bench_.run(kernel, count);
    auto all = bench_.read<float>(out, count);
    all.resize(lights_.emitters);
    return all;
  }
  // Which emitter a sample is of; `emitters` = the environment, -1 = none (it faced away). Lamps that lie over one
  // another are told apart by the density.
  int emitter_of(const float* row, Vec p, const std::vector<float>& chance) const {
    if (!(row[6] > 0)) return -1;
    const int flags = static_cast<int>(row[10]);
    const Vec target{row[3], row[4], row[5]}, direction{row[0], row[1], row[2]};
    if (flags == 2) return static_cast<int>(lights_.emitters);
    int best = -1;
    double nearest = 1e300;
    for (std::uint32_t e = 0; e < lights_.emitters; ++e) {
      const std::uint32_t kind = lights_.kind(e);
      double away = 1e300;
      if (flags == 3 && kind == CLUSTER_DIRECTIONAL) {
        const Vec d = direction + lights_.vec(e, EMITTER_DIRECTION);
        away = scene::dot(d, d);
      } else if (flags == 1 && kind == CLUSTER_POSITIONAL) {
        const Vec d = target - lights_.vec(e, EMITTER_POSITION);
        away = scene::dot(d, d);
      } else if (flags == 0 && kind == CLUSTER_TRIANGLES && lights_.faces(e, p)) {
        const Vec e1 = lights_.vec(e, EMITTER_E1), e2 = lights_.vec(e, EMITTER_E2);
        const Vec n = scene::cross(e1, e2), d = target - lights_.vec(e, EMITTER_P0);
        const double nn = scene::dot(n, n);
        const double b1 = scene::dot(scene::cross(d, e2), n) / nn, b2 = scene::dot(scene::cross(e1, d), n) / nn;
        const double outside = std::max({0.0, -b1, -b2, b1 + b2 - 1}) + std::abs(scene::dot(d, n)) / nn;
        const Vec to = target - p;
        const double d2 = scene::dot(to, to);
        const double density = chance[e] * 2 * d2 * std::sqrt(d2) / -scene::dot(n, to);
        away = outside < 1e-2 ? std::abs(density / row[6] - 1) : 1e3 + outside;
      }
      if (away < nearest) nearest = away, best = static_cast<int>(e);
    }
    return best;
  }

  KernelBench bench_;
  Held lights_;
  worker::DeviceScene held_;
  cl::Program program_;
};

std::string name_of(const ::testing::TestParamInfo<std::tuple<unsigned, std::string>>& p) {
  std::string name = std::get<1>(p.param);
  std::erase(name, '-');
  return name + "_LANES" + std::to_string(std::get<0>(p.param));
}
INSTANTIATE_TEST_SUITE_P(Scenes, Lights, ::testing::Combine(::testing::Values(1u, 16u), ::testing::ValuesIn(kScenes)),
                         name_of);
class AreaLights : public Lights {};
INSTANTIATE_TEST_SUITE_P(Scenes, AreaLights,
                         ::testing::Combine(::testing::Values(1u, 16u),
                                            ::testing::Values("many-lights", "two-sided-lights", "everything")),
                         name_of);

TEST_P(Lights, ChancesSumToOne) {
  constexpr std::size_t count = 2048;
  const std::vector<Vec> points = points_in(*lights_.scene, count);
  cl::Kernel kernel(program_, "sums");
  const cl::Buffer in = bench_.buffer(flat(points)), out = bench_.space(count);
  set_arguments(kernel, held_.set_arguments(kernel, 0), lights_.emitters, in, out);
  bench_.run(kernel, count);
  double worst = 0;
  for (const float sum : bench_.read<float>(out, count)) worst = std::max(worst, std::abs(sum - 1.0));
  std::printf("  %u emitters in %u clusters: sums within %.1e of 1\n", lights_.emitters, lights_.tables.cluster_slots,
              worst);
  EXPECT_LT(worst, 2e-5);
}

// Emitters are drawn as often as their chances say; the mean of 1 / density over an emitter's samples is the solid
// angle that it fills (seen through walls), so that densities integrate to the chance of what they belong to.
TEST_P(Lights, SamplesFollowTheirDensities) {
  constexpr std::size_t count = 1 << 17;
  const std::vector<Vec> points = points_in(*lights_.scene, 6);
  cl_uint seed = 61;
  for (const Vec& p : points) {
    const std::vector<float> rows = draw(p, seed++, count), chance = chances(p);
    std::vector<double> seen(lights_.emitters + 2), expected(lights_.emitters + 2);
    double left = 1;
    for (std::uint32_t e = 0; e < lights_.emitters; ++e) {
      const bool away = lights_.kind(e) == CLUSTER_TRIANGLES && !lights_.faces(e, p);
      expected[away ? lights_.emitters + 1 : e] += chance[e];
      left -= chance[e];
    }
    if (lights_.environment) expected[lights_.emitters] = std::max(left, 0.0);
    Sample filled;
    double delta_off = 0;
    for (std::size_t i = 0; i < count; ++i) {
      const float* row = &rows[i * kRow];
      const int e = emitter_of(row, p, chance);
      ++seen[e < 0 ? lights_.emitters + 1 : static_cast<std::size_t>(e)];
      const bool delta = (static_cast<int>(row[10]) & 1) != 0;
      filled.add(e < 0 || delta ? 0 : 1.0 / row[6]);
      if (e >= 0 && delta) delta_off = std::max(delta_off, std::abs(row[6] / double{chance[e]} - 1));
    }
    double solid = 0;
    for (std::uint32_t e = 0; e < lights_.emitters; ++e)
      if (lights_.kind(e) == CLUSTER_TRIANGLES && lights_.faces(e, p) && chance[e] > 0) {
        const Vec a = lights_.vec(e, EMITTER_P0);
        solid += solid_angle(p, a, a + lights_.vec(e, EMITTER_E1), a + lights_.vec(e, EMITTER_E2));
      }
    if (lights_.environment) solid += 4 * M_PI;
    const ChiSquare chi = chi_square(seen, expected);
    const double t = solid > 0 ? (filled.mean - solid) / filled.standard_error() : 0;
    std::printf(
        "  at (%.2f, %.2f, %.2f): choices' chi-square %.1f of %zu, p = %.3f; solid angle %.5f +- %.5f of %.5f\n", p.x,
        p.y, p.z, chi.statistic, chi.degrees, chi.p, filled.mean, filled.standard_error(), solid);
    EXPECT_GE(chi.p, sidak(kFamily, 2 * points.size()));
    EXPECT_GE(student_p(t, count), sidak(kFamily, 2 * points.size())) << filled.mean << " is not " << solid;
    EXPECT_LT(delta_off, 1e-5) << "a punctual light's density is its chance";
  }
}

// Who comes upon a light by scattering must be told the density with which it would have been sampled.
TEST_P(AreaLights, AskedAgainTheDensityIsTheSame) {
  constexpr std::size_t count = 1 << 14;
  cl_uint seed = 71;
  double worst = 0;
  std::size_t asked = 0;
  for (const Vec& p : points_in(*lights_.scene, 4)) {
    const std::vector<float> rows = draw(p, seed++, count), chance = chances(p);
    std::vector<std::uint32_t> emitter(count, 0);
    std::vector<float> distance(count, 1);
    for (std::size_t i = 0; i < count; ++i) {
      const float* row = &rows[i * kRow];
      const int e = emitter_of(row, p, chance);
      if (e < 0 || row[10] != 0) continue;
      emitter[i] = static_cast<std::uint32_t>(e);
      const Vec d = Vec{row[3], row[4], row[5]} - p;
      distance[i] = static_cast<float>(std::sqrt(scene::dot(d, d)));
    }
    cl::Kernel kernel(program_, "ask");
    const cl::Buffer be = bench_.buffer(emitter), br = bench_.buffer(rows), bd = bench_.buffer(distance);
    const cl::Buffer out = bench_.space(count);
    set_arguments(kernel, held_.set_arguments(kernel, 0), static_cast<float>(p.x), static_cast<float>(p.y),
                  static_cast<float>(p.z), be, br, bd, out);
    bench_.run(kernel, count);
    const auto told = bench_.read<float>(out, count);
    for (std::size_t i = 0; i < count; ++i) {
      const float* row = &rows[i * kRow];
      if (!(row[6] > 0) || row[10] != 0) continue;
      ++asked;
      worst = std::max(worst, std::abs(told[i] / double{row[6]} - 1));
    }
  }
  std::printf("  %zu samples, densities within %.1e\n", asked, worst);
  EXPECT_GT(asked, count / 2);
  EXPECT_LT(worst, 1e-5);
}

// Irradiance at a point, nothing in the way: light samples alone against closed forms and quadrature.
TEST_P(Lights, IrradianceIsTheSumOfAll) {
  constexpr std::size_t count = 1 << 18;
  const bool hall = std::get<1>(GetParam()).ends_with("-lights") && std::get<1>(GetParam()) != "punctual-lights";
  // In the hall every lamp hangs above; elsewhere triangles are few or none.
  const Vec p = hall ? Vec{1.5, 0.5, -0.7} : Vec{0.3, 0.05, 0.9}, n{0, 1, 0};
  double expected = 0;
  for (std::uint32_t e = 0; e < lights_.emitters; ++e) {
    const double radiance = lights_.row(e)[EMITTER_RADIANCE];
    if (lights_.kind(e) == CLUSTER_TRIANGLES) {
      if (!lights_.faces(e, p)) continue;
      const Vec a = lights_.vec(e, EMITTER_P0);
      expected +=
          M_PI * radiance * form_factor(p, n, {a, a + lights_.vec(e, EMITTER_E1), a + lights_.vec(e, EMITTER_E2)});
    } else if (lights_.kind(e) == CLUSTER_POSITIONAL) {
      const Vec d = lights_.vec(e, EMITTER_POSITION) - p, axis = lights_.vec(e, EMITTER_DIRECTION);
      const double d2 = scene::dot(d, d), outer = lights_.row(e)[EMITTER_COS_OUTER],
                   inner = lights_.row(e)[EMITTER_COS_INNER];
      const double along = -scene::dot(axis, scene::normalize(d));
      const double cone = outer <= -1 ? 1 : std::pow(std::clamp((along - outer) / (inner - outer), 0.0, 1.0), 2);
      expected += radiance * cone * std::max(0.0, d.y) / std::pow(d2, 1.5);
    } else {
      expected += radiance * std::max(0.0, -lights_.vec(e, EMITTER_DIRECTION).y);
    }
  }
  if (lights_.environment) {
    const scene::Environment& sky = lights_.scene->environment;
    const int w = static_cast<int>(sky.width), h = static_cast<int>(sky.height);
    const auto texel = [&](int x, int y) {
      return static_cast<double>(
          sky.radiance[static_cast<std::size_t>(3 * (std::clamp(y, 0, h - 1) * w + (x + w) % w))]);
    };
    constexpr int nu = 1024, nv = 512;  // the upper half
    for (int j = 0; j < nv; ++j)
      for (int i = 0; i < nu; ++i) {
        const double theta = M_PI / 2 * (j + 0.5) / nv, x = (i + 0.5) / nu * w - 0.5, y = theta / M_PI * h - 0.5;
        const int x0 = static_cast<int>(std::floor(x)), y0 = static_cast<int>(std::floor(y));
        const double fx = x - x0, fy = y - y0;
        const double radiance = (1 - fy) * ((1 - fx) * texel(x0, y0) + fx * texel(x0 + 1, y0)) +
                                fy * ((1 - fx) * texel(x0, y0 + 1) + fx * texel(x0 + 1, y0 + 1));
        expected += radiance * std::cos(theta) * std::sin(theta) * M_PI / 2 / nv * 2 * M_PI / nu;
      }
  }
  const std::vector<float> rows = draw(p, 81, count);
  Sample seen;
  for (std::size_t i = 0; i < count; ++i) {
    const float* row = &rows[i * kRow];
    seen.add(row[6] > 0 ? row[7] * std::max(0.0, double{row[1]}) / row[6] : 0);
  }
  const double t = (seen.mean - expected) / seen.standard_error();
  std::printf("  irradiance %.5f +- %.5f, expected %.5f (%.2f sigma)\n", seen.mean, seen.standard_error(), expected, t);
  EXPECT_GE(student_p(t, count), kFamily / (2 * kScenes.size()));
  EXPECT_LT(seen.standard_error(), 0.01 * expected) << "too noisy to prove anything";
}

// The geometry term: density of a point on a triangle is distance^2 / (area cosine), a punctual light's irradiance
// intensity / distance^2; on the device within 8 units in the last place of the host's double precision.
class GeometryTerm : public ::testing::TestWithParam<unsigned> {};
INSTANTIATE_TEST_SUITE_P(Lanes, GeometryTerm, ::testing::Values(1u, 16u),
                         [](const auto& lanes) { return "LANES" + std::to_string(lanes.param); });

double ulps(float value, double exact) {
  const float near = static_cast<float>(exact);
  return std::abs(value - exact) / (std::nextafter(near, 1e30f) - near);
}

TEST_P(GeometryTerm, WithinEightUlp) {
  KernelBench bench(GetParam());
  constexpr std::size_t count = 1 << 14;
  std::mt19937 random(5);
  std::uniform_real_distribution<float> unit(0, 1);
  for (const bool triangle : {true, false}) {
    scene::SceneBuilder b("one light");
    b.mesh("lamp");
    const Vec lamp{0.3, 1.7, -0.4};
    const std::uint32_t first = b.vertex({0.2, 1.5, -0.3});
    b.vertex({0.9, 1.6, 0.1});
    b.vertex({0.4, 1.9, 0.6});
    b.triangle(first, first + 1, first + 2,
               b.material("lamp", triangle ? scene::emitter(scene::grey(1)) : scene::lambert(scene::grey(0.5))));
    if (!triangle) b.point_light(lamp, scene::grey(1));
    b.camera("camera", {0, 5, 5}, {}, 40, 16, 16);
    const Held lights(b.finish());
    worker::DeviceScene held = bench.hold(lights.scene);
    cl::Program program = bench.build(kText, held.kernel_options());
    const Vec p0 = lights.vec(0, EMITTER_P0), e1 = lights.vec(0, EMITTER_E1), e2 = lights.vec(0, EMITTER_E2);
    const Vec n = scene::cross(e1, e2);
    std::vector<Vec> points;
    std::vector<float> u;
    while (points.size() < count) {
      const Vec p{4 * unit(random) - 2.0f, 4 * unit(random) - 2.0f, 4 * unit(random) - 2.0f};
      // At glancing angles and from close by the cancellation is the question's own.
      const Vec d = (triangle ? p0 : lamp) - p;
      const double distance = std::sqrt(scene::dot(d, d));
      if (distance < 1 || (triangle && -scene::dot(n, d) < 0.3 * distance * std::sqrt(scene::dot(n, n)))) continue;
      points.push_back(p);
      u.push_back(unit(random));
      u.push_back(unit(random));
    }
    cl::Kernel kernel(program, "draw_at");
    const cl::Buffer bp = bench.buffer(flat(points)), bu = bench.buffer(u), out = bench.space(count * kRow);
    set_arguments(kernel, held.set_arguments(kernel, 0), bp, bu, out);
    bench.run(kernel, count);
    const auto rows = bench.read<float>(out, count * kRow);
    double worst = 0;
    for (std::size_t i = 0; i < count; ++i) {
      const Vec p{static_cast<float>(points[i].x), static_cast<float>(points[i].y), static_cast<float>(points[i].z)};
      const float* row = &rows[i * kRow];
      if (triangle) {
        const double s = std::sqrt(double{u[2 * i]}), b1 = s * (1 - double{u[2 * i + 1]}), b2 = s * u[2 * i + 1];
        const Vec d = p0 + b1 * e1 + b2 * e2 - p;
        const double d2 = scene::dot(d, d);
        worst = std::max(worst, ulps(row[6], 2 * d2 * std::sqrt(d2) / -scene::dot(n, d)));
      } else {
        const Vec d = Vec{static_cast<float>(lamp.x), static_cast<float>(lamp.y), static_cast<float>(lamp.z)} - p;
        worst = std::max(worst, ulps(row[7], 1 / scene::dot(d, d)));
      }
    }
    std::printf("  %s: %.2f ulp at worst\n", triangle ? "triangle" : "point light", worst);
    EXPECT_LE(worst, 8);
  }
}

}  // namespace
}  // namespace gleaner::test

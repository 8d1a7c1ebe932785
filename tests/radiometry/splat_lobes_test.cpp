// Method `splat` with `splat.order`: hemispherical harmonics, lobes in them, records of incoming radiance, and pictures
// with rough lobes against the path tracer.

#include <algorithm>
#include <cmath>
#include <functional>
#include <numbers>

#include "scene/library/library.h"
#include "tests/radiometry/rendered_frame.h"
#include "worker/stages/splat/harmonics.h"
#include "worker/stages/splat/lobe_table.h"
#include "worker/stages/splat/radiance.h"

namespace gleaner::test {
namespace {

using Vec = std::array<double, 3>;
constexpr double kPi = std::numbers::pi;
constexpr std::uint32_t kOrder = 10;

Vec direction(double z, double phi) {
  const double r = std::sqrt(1 - z * z);
  return {r * std::cos(phi), r * std::sin(phi), z};
}
double dot(const Vec& a, const Vec& b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

// Of f(z, phi) over the hemisphere, by solid angle. Midpoints of the angle from the normal: harmonics of odd m have a
// root at the horizon.
double integral(const std::function<double(double z, double phi)>& f, int steps = 400) {
  double sum = 0;
  for (int j = 0; j < steps; ++j) {
    const double theta = kPi / 2 * (j + 0.5) / steps;
    for (int k = 0; k < 64; ++k) sum += std::sin(theta) * f(std::cos(theta), 2 * kPi * (k + 0.5) / 64);
  }
  return sum * kPi / 2 / steps * 2 * kPi / 64;
}

std::vector<double> polar(std::uint32_t order, double z) {
  std::vector<double> values(worker::harmonic_pairs(order));
  worker::hemispherical_harmonics(order, z, values);
  return values;
}

TEST(SplatLobes, HarmonicsAreOrthonormal) {
  constexpr std::uint32_t pairs = worker::harmonic_pairs(kOrder);
  std::vector<double> sums(std::size_t{pairs} * pairs);
  constexpr int steps = 4000;
  for (int j = 0; j < steps; ++j) {
    const double theta = kPi / 2 * (j + 0.5) / steps;
    const auto values = polar(kOrder, std::cos(theta));
    for (std::uint32_t a = 0; a < pairs; ++a)
      for (std::uint32_t b = 0; b < pairs; ++b)
        sums[a * pairs + b] += values[a] * values[b] * std::sin(theta) * kPi / 2 / steps;
  }
  for (std::uint32_t m = 0; m < kOrder; ++m)
    for (std::uint32_t l = m; l < kOrder; ++l)
      for (std::uint32_t k = m; k < kOrder; ++k) {
        // Over the azimuth, cosines of equal m give pi, or 2 pi.
        const double sum = sums[(l * (l + 1) / 2 + m) * pairs + k * (k + 1) / 2 + m] * (m > 0 ? kPi : 2 * kPi);
        EXPECT_NEAR(sum, l == k ? 1 : 0, 1e-4) << l << ", " << k << ", " << m;
      }
}

// The lobe of kernels/bsdf.h at the local directions v and l, with its cosine; f0 and f90 are grey.
double lobe(double alpha, double f0, double f90, const Vec& v, const Vec& l) {
  Vec h{v[0] + l[0], v[1] + l[1], v[2] + l[2]};
  const double length = std::sqrt(dot(h, h));
  for (double& x : h) x /= length;
  const double a2 = alpha * alpha, t = h[2] * h[2] * (a2 - 1) + 1, d = a2 / (kPi * t * t);
  const double gv = v[2] + std::sqrt(a2 + (1 - a2) * v[2] * v[2]), gl = l[2] + std::sqrt(a2 + (1 - a2) * l[2] * l[2]);
  return d / (gv * gl) * l[2] * (f0 + (f90 - f0) * std::pow(1 - dot(v, h), 5));
}

// Bright towards one side, with some detail; defined all around.
double sky(const Vec& w) { return 1 + 0.8 * w[0] - 0.5 * w[1] * w[2] + 0.6 * std::sin(2 * w[0] + 3 * w[1]); }

// A record on the plane z = 0 at (x, 0, 0), of what `radiance` says of a position and a direction; `nearness` as
// HemisphereSample.
std::vector<float> record_at(const std::function<double(double x, const Vec& w)>& radiance, double x, float nearness) {
  const worker::HemisphereGrid grid{64, 256};
  std::vector<worker::HemisphereSample> samples;
  for (std::uint32_t j = 0; j < grid.polar; ++j)
    for (std::uint32_t k = 0; k < grid.azimuthal; ++k) {
      const Vec w = direction(1 - (j + 0.5) / grid.polar, 2 * kPi * (k + 0.5) / grid.azimuthal);
      const auto light = static_cast<float>(radiance(x, w));
      samples.push_back({{light, light, light}, nearness, static_cast<float>(w[0]), static_cast<float>(w[1])});
    }
  worker::SplatPoint place{};
  place.position = {static_cast<float>(x), 0, 0};
  place.normal = place.geometric = {0, 0, 1};
  place.factor = {1, 0.5f, 0};
  place.footprint = 1;
  std::vector<float> record(RADIANCE_WORDS(kOrder));
  worker::make_radiance_record(place, grid, samples, kOrder, record);
  return record;
}

TEST(SplatLobes, GradientsOfInfinitelyFarLightVanish) {
  const std::vector<float> record = record_at([](double, const Vec& w) { return sky(w); }, 0, 0);
  for (std::size_t i = CACHE_WORDS; i < record.size(); i += 3) {
    EXPECT_EQ(record[i + 1], 0) << i;
    EXPECT_EQ(record[i + 2], 0) << i;
  }
}

// On a sphere of 2 m about the origin light changes with the place: gradients tell how coefficients do.
TEST(SplatLobes, GradientsAreTheCoefficientsChange) {
  const auto on_sphere = [](double x, const Vec& w) {
    const double along = x * w[0], t = -along + std::sqrt(along * along + 4 - x * x);
    return sky({(x + t * w[0]) / 2, t * w[1] / 2, t * w[2] / 2});
  };
  constexpr double step = 0.1;
  const auto here = record_at(on_sphere, 0, 0.5f), there = record_at(on_sphere, step, 0.5f);
  double change = 0, off = 0;
  for (std::size_t i = CACHE_WORDS; i < here.size(); i += 3) {
    const double moved = there[i] - here[i];
    change += moved * moved;
    off += (moved - step * here[i + 1]) * (moved - step * here[i + 1]);
  }
  std::printf("  coefficients change by %.4f, of which gradients miss %.1f %%\n", std::sqrt(change),
              100 * std::sqrt(off / change));
  EXPECT_LT(off, 0.01 * change);
}

// What stage splat_shade makes of one record and of points with these normals, which see it along `view`.
std::vector<float> shade(const std::vector<float>& record, const std::vector<Vec>& normals, const Vec& view,
                         float alpha, float f0, float f90) {
  std::vector<worker::SplatPoint> points(SPLAT_TILE_PIXELS);
  std::vector<float> lobes(points.size() * LOBE_WORDS);
  for (std::size_t i = 0; i < points.size(); ++i) {
    worker::SplatPoint& point = points[i];
    point = {};
    for (std::size_t k = 0; k < 3; ++k) point.normal[k] = static_cast<float>(normals[i % normals.size()][k]);
    point.geometric = {0, 0, 1};
    point.footprint = 0.01f;
    point.table = GLEANER_NONE;
    float* lobe = &lobes[i * LOBE_WORDS];
    for (std::size_t k = 0; k < 3; ++k) {
      lobe[LOBE_VIEW + k] = static_cast<float>(view[k]);
      lobe[LOBE_THROUGHPUT + k] = 1;
      lobe[LOBE_F0 + k] = f0;
    }
    lobe[LOBE_F90] = f90;
    lobe[LOBE_ALPHA] = alpha;
  }
  const auto bytes_of = [](const auto& rows) {
    auto bytes = std::make_shared<scene::Bytes>(rows.size() * sizeof rows[0]);
    std::memcpy(bytes->data(), rows.data(), bytes->size());
    return bytes;
  };
  worker::Executor& on = executor(worker::TraceKind::automatic);
  kernels::SplatShadeParameters p{.tiles = 1, .samples = 1, .order = kOrder, .reserved = 0};
  worker::StageTask task;
  task.kind = "splat_shade";
  task.scene = load(on, std::make_shared<const Scene>(scene::make_scene("cornell-box", {})));
  task.parameters.resize(sizeof p);
  std::memcpy(task.parameters.data(), &p, sizeof p);
  task.inputs["points"] = bytes_of(points);
  task.inputs["lobes"] = bytes_of(lobes);
  task.inputs["cache"] = bytes_of(record);
  const worker::BatchResult result = on.run(task, 0, 1);
  std::vector<float> rgb(result.records.size() / 4), red;
  std::memcpy(rgb.data(), result.records.data(), result.records.size());
  for (std::size_t i = 0; i < rgb.size(); i += 3) red.push_back(rgb[i]);
  return red;
}

// The integral of lobe and sky, for a normal that is turned by `tilt` towards x.
double reflected(double alpha, double f0, double f90, const Vec& view, double tilt) {
  const double c = std::cos(tilt), s = std::sin(tilt);
  const Vec local{c * view[0] - s * view[2], view[1], s * view[0] + c * view[2]};
  return integral([&](double z, double phi) {
    const Vec l = direction(z, phi);
    return lobe(alpha, f0, f90, local, l) * sky({c * l[0] + s * l[2], l[1], -s * l[0] + c * l[2]});
  });
}

TEST(SplatLobes, LightOnALobeIsItsIntegral) {
  const std::vector<float> record = record_at([](double, const Vec& w) { return sky(w); }, 0, 0);
  for (const double alpha : {0.2, 0.27, 0.5, 1.0})
    for (const double angle : {2.0, 25.0, 50.0, 70.0}) {
      const Vec view = direction(std::cos(angle * kPi / 180), 2.1);
      const double expected = reflected(alpha, 0.3, 1, view, 0);
      const double found = shade(record, {{0, 0, 1}}, view, static_cast<float>(alpha), 0.3f, 1)[0];
      std::printf("  alpha %.2f, %2.0f degrees: %.4f, expected %.4f, %+.2f %%\n", alpha, angle, found, expected,
                  100 * (found / expected - 1));
      EXPECT_NEAR(found / expected, 1, 0.02) << alpha << ", " << angle;
    }
}

// Surfaces that curve: records are read at other normals than their own. The lobe that is read has its mirror direction
// where it should; of the cosine's pull towards the normal it knows the record's.
TEST(SplatLobes, ALobeTurnsWithTheNormal) {
  const std::vector<float> record = record_at([](double, const Vec& w) { return sky(w); }, 0, 0);
  const Vec view = direction(std::cos(0.5), 2.1);
  double off = 0, unturned = 0;
  for (const double tilt : {-0.15, -0.08, 0.08, 0.15}) {
    const double expected = reflected(0.25, 0.3, 1, view, tilt), plain = reflected(0.25, 0.3, 1, view, 0);
    const double found = shade(record, {{std::sin(tilt), 0, std::cos(tilt)}}, view, 0.25f, 0.3f, 1)[0];
    std::printf("  turned by %+.2f: %.4f, expected %.4f, unturned %.4f\n", tilt, found, expected, plain);
    EXPECT_NEAR(found / expected, 1, 0.03) << tilt;
    off = std::max(off, std::abs(found - expected));
    unturned = std::max(unturned, std::abs(plain - expected));
  }
  EXPECT_LT(off, 0.2 * unturned);
}

// The Cornell box with a back wall of metal, its lobe as broad as Phong's of exponent 20 (Gautron et al. 2005, figure
// 9b), or less. Lit by a point: few samples tell the mean.
Scene glossy_wall() {
  Scene scene = scene::make_scene("cornell-box", {});
  for (auto& material : scene.materials) std::fill_n(material.emission, 3, 0.0f);
  scene::Light light{};
  light.type = GLEANER_LIGHT_POINT;
  light.position[1] = 1.5f;
  light.position[2] = 0.3f;
  light.direction[2] = -1;
  std::fill_n(light.intensity, 3, 2.0f);
  light.cos_inner = 1;
  light.cos_outer = -1;
  scene.lights.push_back(light);
  const auto metal = static_cast<std::uint32_t>(scene.materials.size());
  scene.materials.push_back(scene.materials[0]);
  scene.material_names.push_back("glossy wall");
  scene.materials[metal].metallic = 1;
  scene.materials[metal].specular = 1;
  scene.materials[metal].roughness = 0.45f;
  for (const auto& mesh : scene.meshes)
    if (mesh.name == "back wall")
      std::fill_n(scene.triangle_material.begin() + mesh.first_triangle, mesh.triangle_count, metal);
  scene::finish_materials(scene);
  return scene;
}

double wall_error(const Film& film, const Film& truth) {
  double square = 0, sum = 0, n = 0;
  for (const char* name : {"indirect.R", "indirect.G", "indirect.B"}) {
    const auto &found = film.find(name)->values, &expected = truth.find(name)->values;
    for (std::uint32_t y = film.height / 5; y < film.height * 9 / 20; ++y)
      for (std::uint32_t x = film.width * 3 / 10; x < film.width * 7 / 10; ++x, ++n) {
        const std::size_t i = std::size_t{y} * film.width + x;
        const double off = double{found[i]} - expected[i];
        square += off * off;
        sum += double{expected[i]};
      }
  }
  return std::sqrt(square / n) / (sum / n);
}

TEST(SplatLobes, AGlossyWallIsThePathTracers) {
  Frame frame = square_frame("path", glossy_wall(), {}, 64, 4096, {});
  const Rendered path = render(frame);
  frame.settings.method = "splat";
  frame.settings.spp = 64;
  for (const char* order : {"5", "10"}) {
    frame.settings.set = {{"splat.order", order}, {"splat.accuracy", "0.25"}, {"splat.gather_rays", "4096"}};
    const Rendered made = render(frame);
    EXPECT_GT(made.parameters.at("splat").at("lobe_records").get<int>(), 50);
    const double error = wall_error(made.film, path.film);
    std::printf("  order %s: error on the wall %.2f %%\n", order, 100 * error);
    // An order of 5 does not do for a lobe as narrow as this.
    EXPECT_LT(error, order == std::string("10") ? 0.05 : 0.08) << order;
    for (const char* channel : {"indirect.R", "indirect.G", "indirect.B"}) {
      const double expected = mean_of(path.film, channel), found = mean_of(made.film, channel);
      std::printf("  %s: %.6f, expected %.6f, %+.2f %%\n", channel, found, expected, 100 * (found / expected - 1));
      EXPECT_NEAR(found / expected, 1, 0.01) << channel;
    }
  }
}

Scene rough_boxes() {
  Scene scene = scene::make_scene("cornell-glossy", {});
  for (auto& material : scene.materials)
    if (material.roughness < 1) material.roughness = material.metallic > 0 ? 0.5f : 0.6f;
  scene::finish_materials(scene);
  return scene;
}

// Over layers and bare; boxes turned.
TEST(SplatLobes, MeanIsThePathTracers) {
  Frame frame = square_frame("path", rough_boxes(), {}, 32, 4096, {});
  const Rendered path = render(frame);
  frame.settings.method = "splat";
  frame.settings.spp = 1024;
  frame.settings.set = {{"splat.order", "10"}};
  const Rendered made = render(frame);
  for (const char* channel : {"R", "G", "B"}) {
    const double expected = mean_of(path.film, channel), found = mean_of(made.film, channel);
    std::printf("  %s: %.6f, expected %.6f\n", channel, found, expected);
    EXPECT_NEAR(found / expected, 1, 0.005) << channel;
  }
}

TEST(SplatLobes, SceneWithoutLobesHasNoneOfTheStages) {
  Frame frame = square_frame("splat", scene::make_scene("cornell-box", {}), {}, 16, 1,
                             {{"splat.order", "10"}, {"splat.gather_rays", "16"}});
  const Rendered with = render(frame);
  EXPECT_FALSE(with.specs.contains("splat.lobe_points"));
  frame.settings.set["splat.order"] = "0";
  EXPECT_EQ(with.film.find("R")->values, render(frame).film.find("R")->values);
}

}  // namespace
}  // namespace gleaner::test

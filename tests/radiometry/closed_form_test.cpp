// Light whose effect is known in closed form: form factors, punctual lights, environments; and what the camera sees
// first.

#include <cmath>
#include <cstdio>

#include "scene/library/builder.h"
#include "scene/library/library.h"
#include "tests/radiometry/shot.h"

namespace gleaner::test {
namespace {

using scene::SceneBuilder;
using scene::Vec;

constexpr double kFamily = 1e-3;

// The form factor from a point with normal n to a polygon above its horizon, whose corners run counterclockwise seen
// from the point (Lambert 1760: each edge gives half its angle times the cosine of its plane).
double polygon_form_factor(Vec p, Vec n, const std::vector<Vec>& corners) {
  double sum = 0;
  for (std::size_t i = 0; i < corners.size(); ++i) {
    const Vec a = scene::normalize(corners[i] - p), b = scene::normalize(corners[(i + 1) % corners.size()] - p);
    const Vec across = scene::cross(a, b);
    const double sine = std::sqrt(scene::dot(across, across));
    if (sine > 0) sum += std::atan2(sine, scene::dot(a, b)) * scene::dot(n, (1 / sine) * across);
  }
  return std::abs(sum) / (2 * M_PI);
}

// Of parallel unit squares, a distance apart (Howell's catalogue, C-11).
double parallel_squares(double distance) {
  const double c = 1 / distance, c2 = c * c, root = std::sqrt(1 + c2);
  return 2 / (M_PI * c2) *
         (std::log((1 + c2) / std::sqrt(1 + 2 * c2)) + 2 * c * root * std::atan(c / root) - 2 * c * std::atan(c));
}

// Of unit squares that share an edge at a right angle (C-14).
double perpendicular_squares() {
  const double root = std::sqrt(2.0);
  return (2 * std::atan(1.0) - root * std::atan(1 / root) + std::log(3.0 / 4) / 4) / M_PI;
}

void check_squares(const std::string& name, const std::map<std::string, std::string>& parameters, double expected,
                   const std::vector<Vec>& emitter, std::size_t family) {
  constexpr double albedo = 0.5;
  Shot shot{.scene = std::make_shared<const Scene>(scene::make_scene(name, parameters))};
  shot.camera = camera_of(*shot.scene);
  shot.width = shot.height = 16;
  shot.chunks = 32;
  const Picture picture = shoot(shot);
  bool fine = expect_mean(picture.mean(0), albedo * expected, name, sidak(kFamily, family), 2e-3);

  // And pixel by pixel: the receiver is the unit square about the origin, row 0 at z = -1/2.
  double worst = 0, sum = 0;
  for (int y = 0; y < 16; ++y)
    for (int x = 0; x < 16; ++x) {
      double factor = 0;
      constexpr int grid = 8;
      for (int i = 0; i < grid; ++i)
        for (int j = 0; j < grid; ++j)
          factor += polygon_form_factor({(x + (i + 0.5) / grid) / 16 - 0.5, 0, (y + (j + 0.5) / grid) / 16 - 0.5},
                                        {0, 1, 0}, emitter);
      factor /= grid * grid;
      sum += factor / 256;
      const Sample seen = picture.pixel(static_cast<std::size_t>(16 * y + x), 2);
      worst = std::max(worst, std::abs(seen.mean - albedo * factor) / seen.standard_error());
    }
  const double critical = student_critical(sidak(kFamily, 256 * family), shot.chunks - 1);
  std::printf("  %s: quadrature of the form factor %.6f, worst pixel %.2f standard errors of %.2f allowed\n",
              name.c_str(), sum, worst, critical);
  EXPECT_NEAR(sum, expected, 2e-3 * expected) << "the two closed forms disagree";
  EXPECT_LT(worst, critical);
  fine &= worst < critical;
  if (!fine) keep_failure(picture, name);
}

TEST(ClosedForm, ParallelSquares) {
  EXPECT_NEAR(parallel_squares(1), 0.199825, 1e-6);
  for (const double d : {0.5, 1.0, 3.0})
    check_squares("parallel-squares", {{"distance", std::to_string(d)}}, parallel_squares(d),
                  {{-0.5, d, -0.5}, {0.5, d, -0.5}, {0.5, d, 0.5}, {-0.5, d, 0.5}}, 3);
}

TEST(ClosedForm, PerpendicularSquares) {
  EXPECT_NEAR(perpendicular_squares(), 0.200044, 1e-6);
  check_squares("perpendicular-squares", {}, perpendicular_squares(),
                {{-0.5, 0, 0.5}, {-0.5, 0, -0.5}, {-0.5, 1, -0.5}, {-0.5, 1, 0.5}}, 1);
}

// A Lambert floor of albedo 0.8, looked down upon at (x, z) through a keyhole.
constexpr double kFloor = 0.8;
Picture floor_picture(const SceneBuilder& lit, double x, double z, std::uint32_t chunks,
                      worker::TraceKind trace = worker::TraceKind::automatic) {
  SceneBuilder b = lit;
  b.mesh("floor");
  b.quad({-9, 0, 9}, {9, 0, 9}, {9, 0, -9}, {-9, 0, -9}, b.material("floor", scene::lambert(scene::grey(kFloor))));
  b.camera("camera", {0, 5, 5}, {}, 40, 16, 16);
  Shot shot{.scene = std::make_shared<const Scene>(b.finish())};
  shot.camera = orthographic({x, 0.1, z}, {1, 0, 0}, {0, 0, -1}, 1e-6);
  shot.width = shot.height = 4;
  shot.chunks = chunks;
  shot.trace = trace;
  return shoot(shot);
}
double floor_radiance(const SceneBuilder& lit, double x, double z) { return floor_picture(lit, x, z, 1).mean(1).mean; }

// KHR_lights_punctual: the inner and outer cone's falloff, and the window that ends at the range.
double spot_factor(double cosine, double inner, double outer) {
  const double t = std::clamp((cosine - std::cos(outer)) / (std::cos(inner) - std::cos(outer)), 0.0, 1.0);
  return t * t;
}

TEST(ClosedForm, PunctualLights) {
  const auto check = [](const std::string& what, double seen, double expected) {
    std::printf("  %-28s %.8g, expected %.8g\n", what.c_str(), seen, expected);
    EXPECT_NEAR(seen, expected, 4e-6 * expected) << what;
  };
  const Vec lamp{0.3, 1.2, -0.4};
  for (const auto& [x, z] : {std::pair{0.3, -0.4}, {1.0, 0.5}, {-2.5, 3.0}}) {
    const Vec to = lamp - Vec{x, 0, z};
    const double d2 = scene::dot(to, to), cosine = lamp.y / std::sqrt(d2);
    const std::string where = " at " + std::to_string(x).substr(0, 4);
    SceneBuilder point("point"), spot("spot"), sun("sun");
    point.point_light(lamp, scene::grey(7));
    check("point light" + where, floor_radiance(point, x, z), kFloor / M_PI * 7 * cosine / d2);
    // The cone's axis hangs straight down: the angle at the lamp is that at the floor.
    spot.spot_light(lamp, {0, -1, 0}, scene::grey(7), 0.4, 1.0);
    check("spot" + where, floor_radiance(spot, x, z), kFloor / M_PI * 7 * cosine / d2 * spot_factor(cosine, 0.4, 1.0));
    sun.directional_light({0.3, -0.5, 0.2}, scene::grey(3));
    check("directional light" + where, floor_radiance(sun, x, z),
          kFloor / M_PI * 3 * 0.5 / std::sqrt(0.09 + 0.25 + 0.04));
  }
  SceneBuilder under("under");
  under.point_light({0, -1, 0}, scene::grey(7));
  check("light under the floor", floor_radiance(under, 0, 0), 0);
}

// One of many is chosen at a time: by power, distance and side, but the sum is the sum of all.
TEST(ClosedForm, ManyPunctualLights) {
  SceneBuilder b("many");
  double expected = 0;
  for (std::uint64_t i = 0; i < 40; ++i) {
    const Vec at{6 * scene::hash_unit(i, 0) - 3, 0.5 + 2 * scene::hash_unit(i, 1), 6 * scene::hash_unit(i, 2) - 3};
    const double intensity = std::exp2(6 * scene::hash_unit(i, 3));
    b.point_light(at, scene::grey(intensity));
    expected += kFloor / M_PI * intensity * at.y / std::pow(scene::dot(at, at), 1.5);
  }
  b.directional_light({0.1, -1, 0.4}, scene::grey(2));
  b.directional_light({0.1, 1, 0.4}, scene::grey(2));  // shines from below
  expected += kFloor / M_PI * 2 / std::sqrt(1.17);
  const Picture picture = floor_picture(b, 0, 0, 256);
  if (!expect_mean(picture.mean(1), expected, "42 punctual lights", kFamily, 2e-3)) keep_failure(picture, "many");
}

// Black sheets over the floor at heights 0.3, 0.4, ..., wide enough to shade all of it, of these opacities. A negative
// one is cut out by a texture: its mask leaves three quarters open, and the light falls through the middle of a hole.
SceneBuilder veiled(const std::vector<double>& opacities) {
  SceneBuilder b("veiled");
  b.mesh("sheets");
  double height = 0.3;
  for (const double opacity : opacities) {
    scene::Material m = scene::lambert(scene::grey(0));
    m.flags |= opacity < 0 ? GLEANER_MATERIAL_ALPHA_MASK : GLEANER_MATERIAL_ALPHA_BLEND;
    m.alpha = static_cast<float>(std::abs(opacity));
    if (opacity < 0)
      m.base_color_texture = b.texture(64, 64, true, [](std::uint32_t x, std::uint32_t y) {
        return scene::Texel{255, 255, 255, static_cast<std::uint8_t>(x < 32 && y < 32 ? 255 : 100)};
      });
    b.quad({-9, height, 9}, {9, height, 9}, {9, height, -9}, {-9, height, -9}, b.material("sheet", m));
    height += 0.1;
  }
  return b;
}

// Alpha lets light go on in proportion, that of lights which no scattering finds as well; and the light of an emitter
// that both ways find is not counted twice.
TEST(ClosedForm, LightThroughAlpha) {
  const Vec lamp{0.3, 1.2, -0.4};
  const struct {
    std::vector<double> opacities;
    double passes;
  } cases[] = {{{0.25}, 0.75}, {{0.5, 0.25, 0.9}, 0.0375}, {{1}, 0}, {{0}, 1}, {{-1}, 1}, {{-1, 0.5}, 0.5}};
  for (const auto trace : {worker::TraceKind::automatic, worker::TraceKind::opencl})
    for (const auto& c : cases) {
      const auto check = [&](const std::string& what, const SceneBuilder& lit, double unveiled) {
        const double seen = floor_picture(lit, 1.5, -2.5, 1, trace).mean(1).mean;
        const double expected = c.passes * unveiled;
        std::printf("  %-12s through %zu sheets: %.8g, expected %.8g\n", what.c_str(), c.opacities.size(), seen,
                    expected);
        EXPECT_NEAR(seen, expected, 4e-6 * unveiled) << what;
      };
      const Vec to = lamp - Vec{1.5, 0, -2.5};
      const double d2 = scene::dot(to, to), cosine = lamp.y / std::sqrt(d2);
      SceneBuilder point = veiled(c.opacities), spot = veiled(c.opacities), sun = veiled(c.opacities);
      point.point_light(lamp, scene::grey(7));
      check("point light", point, kFloor / M_PI * 7 * cosine / d2);
      spot.spot_light(lamp, {0, -1, 0}, scene::grey(7), 1.2, 1.4);
      check("spot", spot, kFloor / M_PI * 7 * cosine / d2 * spot_factor(cosine, 1.2, 1.4));
      sun.directional_light({0.3, -0.5, 0.2}, scene::grey(3));
      check("sun", sun, kFloor / M_PI * 3 * 0.5 / std::sqrt(0.09 + 0.25 + 0.04));
    }

  // Sheets beyond the lamp are not in its way.
  SceneBuilder beyond = veiled({0.5});
  beyond.point_light({1.5, 0.25, -2.5}, scene::grey(7));
  EXPECT_NEAR(floor_radiance(beyond, 1.5, -2.5), kFloor / M_PI * 7 / 0.0625, 4e-6 * kFloor / M_PI * 7 / 0.0625);

  // An emitter and a sun together, behind a sheet.
  SceneBuilder both = veiled({0.4});
  const std::vector<Vec> corners{{0, 2, -4}, {4, 2, -4}, {4, 2, -1}, {0, 2, -1}};
  both.mesh("emitter");
  both.quad(corners[0], corners[1], corners[2], corners[3], both.material("emitter", scene::emitter(scene::grey(5))));
  both.directional_light({0.8, -0.3, 0.2}, scene::grey(1));
  const double expected =
      kFloor * 0.6 *
      (5 * polygon_form_factor({1.5, 0, -2.5}, {0, 1, 0}, corners) + 0.3 / std::sqrt(0.64 + 0.09 + 0.04) / M_PI);
  const Picture picture = floor_picture(both, 1.5, -2.5, 512);
  if (!expect_mean(picture.mean(1), expected, "emitter and sun behind a sheet", kFamily, 5e-3))
    keep_failure(picture, "sheet");
}

// A small lamp far away is seen whole: none of its triangles stands in the way of the light samples on it, although a
// query's own rounding grows with the distance (the lamp's coordinates do not: it is the origin) and many of them are
// seen at a grazing angle.
TEST(ClosedForm, DistantLamp) {
  const Vec eye{-20, -60, 10};
  SceneBuilder b("lamp");
  b.mesh("lamp");
  b.sphere({}, 0.1, 64, b.material("lamp", scene::emitter(scene::grey(1e5))));
  b.mesh("floor");
  b.quad(eye + Vec{-9, 0, 9}, eye + Vec{9, 0, 9}, eye + Vec{9, 0, -9}, eye + Vec{-9, 0, -9},
         b.material("floor", scene::lambert(scene::grey(kFloor))));
  b.camera("camera", {0, 5, 5}, {}, 40, 16, 16);
  Shot shot{.scene = std::make_shared<const Scene>(b.finish())};
  const Scene& scene = *shot.scene;
  double irradiance = 0;
  for (std::size_t i = 0; i < scene.triangle_count(); ++i) {
    Vec corner[3];
    for (std::size_t k = 0; k < 3; ++k) {
      const float* p = &scene.positions[3 * std::size_t{scene.indices[3 * i + k]}];
      corner[k] = Vec{p[0], p[1], p[2]} - eye;
    }
    if (corner[0].y < 1) continue;  // the floor
    const Vec n = scene::cross(corner[1] - corner[0], corner[2] - corner[0]);
    const Vec at = (1.0 / 3) * (corner[0] + corner[1] + corner[2]);
    const double d2 = scene::dot(at, at), facing = -scene::dot(n, at) / 2;
    if (facing > 0) irradiance += 1e5 * facing * at.y / (d2 * d2);
  }
  shot.camera = orthographic({eye.x, eye.y + 1, eye.z}, {1, 0, 0}, {0, 0, -1}, 1e-6);
  shot.width = shot.height = 64;
  shot.chunks = 16;
  for (const auto trace : {worker::TraceKind::automatic, worker::TraceKind::opencl}) {
    shot.trace = trace;
    expect_mean(shoot(shot).mean(1), kFloor / M_PI * irradiance,
                trace == worker::TraceKind::opencl ? "distant lamp, OpenCL" : "distant lamp", sidak(kFamily, 2), 1e-3);
  }
}

TEST(ClosedForm, RangeEndsALight) {
  for (const double range : {1.2, 2.0, 5.0}) {
    SceneBuilder b("range");
    b.mesh("floor");
    b.quad({-9, 0, 9}, {9, 0, 9}, {9, 0, -9}, {-9, 0, -9}, b.material("floor", scene::lambert(scene::grey(kFloor))));
    b.camera("camera", {0, 5, 5}, {}, 40, 16, 16);
    b.point_light({0, 1.5, 0}, scene::grey(7));
    Scene scene = b.finish();
    scene.lights[0].range = static_cast<float>(range);
    Shot shot{.scene = std::make_shared<const Scene>(std::move(scene))};
    shot.camera = orthographic({0, 1, 0}, {1, 0, 0}, {0, 0, -1}, 1e-6);
    shot.width = shot.height = 4;
    shot.chunks = 1;
    const double window = std::max(0.0, 1 - std::pow(1.5 / range, 4));
    EXPECT_NEAR(shoot(shot).mean(1).mean, kFloor / M_PI * 7 / 2.25 * window, 1e-5) << "range " << range;
  }
}

// scene.h: bilinear between texel centres, wrapped in u, clamped at the poles.
double radiance_from(const scene::Environment& e, Vec d, int channel) {
  const double p = std::atan2(d.x, -d.z) / (2 * M_PI), u = p - std::floor(p), v = std::acos(d.y) / M_PI;
  const double x = u * e.width - 0.5, y = v * e.height - 0.5;
  const int w = static_cast<int>(e.width), h = static_cast<int>(e.height);
  const int x0 = static_cast<int>(std::floor(x)), y0 = static_cast<int>(std::floor(y));
  const auto texel = [&](int column, int row) {
    column = (column + w) % w;
    row = std::clamp(row, 0, h - 1);
    return static_cast<double>(e.radiance[static_cast<std::size_t>(3 * (row * w + column) + channel)]);
  };
  const double fx = x - x0, fy = y - y0;
  return (1 - fy) * ((1 - fx) * texel(x0, y0) + fx * texel(x0 + 1, y0)) +
         fy * ((1 - fx) * texel(x0, y0 + 1) + fx * texel(x0 + 1, y0 + 1));
}

// Random texels, one of them a sun.
scene::Environment sky() {
  scene::Environment e{12, 6, {}};
  for (std::uint64_t i = 0; i < 3u * 12 * 6; ++i)
    e.radiance.push_back(static_cast<float>(0.2 + scene::hash_unit(i, 0)));
  for (int k = 0; k < 3; ++k) e.radiance[static_cast<std::size_t>(3 * (1 * 12 + 4) + k)] = 60.0f + 10.0f * k;
  return e;
}

TEST(ClosedForm, EnvironmentOnAFloor) {
  for (const Vec normal : {Vec{0, 1, 0}, scene::normalize(Vec{0.6, 0.4, -0.7})}) {
    const Vec across = scene::normalize(scene::cross(normal, {0.2, 0.3, 0.9})), up = scene::cross(normal, across);
    SceneBuilder b("sky");
    b.mesh("floor");
    b.quad(-1.0 * across - up, across - up, across + up, -1.0 * across + up,
           b.material("floor", scene::lambert(scene::grey(kFloor))));
    b.camera("camera", {0, 5, 5}, {}, 40, 16, 16);
    Scene made = b.finish();
    made.environment = sky();
    double irradiance[3] = {};
    constexpr int nu = 1536, nv = 768;
    for (int j = 0; j < nv; ++j)
      for (int i = 0; i < nu; ++i) {
        const double phi = 2 * M_PI * (i + 0.5) / nu, theta = M_PI * (j + 0.5) / nv;
        const Vec d{std::sin(theta) * std::sin(phi), std::cos(theta), -std::sin(theta) * std::cos(phi)};
        const double cosine = scene::dot(d, normal);
        if (cosine <= 0) continue;
        for (int k = 0; k < 3; ++k)
          irradiance[k] +=
              radiance_from(made.environment, d, k) * cosine * std::sin(theta) * 2 * M_PI * M_PI / (double(nu) * nv);
      }
    Shot shot{.scene = std::make_shared<const Scene>(std::move(made))};
    const Vec eye = 0.5 * normal;
    shot.camera = orthographic({eye.x, eye.y, eye.z}, {across.x, across.y, across.z}, {up.x, up.y, up.z}, 0.5);
    shot.width = shot.height = 8;
    shot.samples = 64;
    shot.chunks = 64;
    const Picture picture = shoot(shot);
    for (int k = 0; k < 3; ++k)
      if (!expect_mean(picture.mean(k), kFloor / M_PI * irradiance[k],
                       "environment on a floor, channel " + std::to_string(k), sidak(kFamily, 6), 2e-3))
        keep_failure(picture, "environment");
  }
}

// Which way is up, left and forward: the sky as a camera sees it.
TEST(ClosedForm, EnvironmentSeen) {
  SceneBuilder b("seen");
  b.mesh("speck");
  b.quad({8, -9, 8}, {8.1, -9, 8}, {8.1, -9, 7.9}, {8, -9, 7.9}, b.material("m", scene::lambert(scene::grey(0))));
  b.camera("camera", {}, {0.3, 0.8, -0.5}, 0.01, 16, 16);
  b.camera("left", {}, {-0.9, 0.1, 0.2}, 0.01, 16, 16);
  b.camera("back", {}, {0.02, -0.6, 0.9}, 0.01, 16, 16);
  Scene made = b.finish();
  made.environment = sky();
  const auto scene = std::make_shared<const Scene>(std::move(made));
  for (const auto& camera : scene->cameras) {
    Shot shot{.scene = scene, .camera = camera.camera, .width = 4, .height = 4, .chunks = 1};
    const Picture picture = shoot(shot);
    const float* f = camera.camera.forward;
    for (int k = 0; k < 3; ++k) {
      const double expected = radiance_from(scene->environment, {f[0], f[1], f[2]}, k);
      EXPECT_NEAR(picture.mean(k).mean, expected, 1e-4 * expected) << camera.name << ", channel " << k;
    }
  }
}

// Albedo, normal, depth and the share of samples that hit, of a slanted square that covers half the picture.
TEST(ClosedForm, Features) {
  SceneBuilder b("features");
  b.mesh("half");
  // In the plane y = z, for x < 0; seen from above its distance is 2 - z.
  b.quad({-3, 3, 3}, {0, 3, 3}, {0, -3, -3}, {-3, -3, -3}, b.material("m", scene::lambert({0.1, 0.4, 0.7})));
  b.camera("camera", {0, 5, 5}, {}, 40, 16, 16);
  b.point_light({0, 3, 0}, scene::grey(1));
  Shot shot{.scene = std::make_shared<const Scene>(b.finish())};
  shot.camera = orthographic({0, 2, 0}, {1, 0, 0}, {0, 0, -1}, 1);
  shot.width = shot.height = 3;
  kernels::PathParameters parameters = parameters_of(shot);
  parameters.features = 1;
  parameters.items_low = 9;
  worker::Executor& on = executor(shot.trace);
  const auto result = on.run(task_of(parameters, load(on, shot.scene)), 0, 9);
  for (std::size_t pixel = 0; pixel < 9; ++pixel) {
    kernels::PathFeatureRecord record;
    std::memcpy(&record, result.records.data() + pixel * sizeof record, sizeof record);
    const std::size_t x = pixel % 3, y = pixel / 3;
    const double z = (static_cast<double>(y) - 1) * 2 / 3;
    // The middle column's samples are a net: exactly half of them hit.
    const double hits = x == 0 ? 16 : x == 1 ? 8 : 0;
    EXPECT_EQ(record.hits, hits) << "pixel " << pixel;
    EXPECT_NEAR(record.albedo[2], 0.7 * hits, 1e-4);
    EXPECT_NEAR(record.normal[0], 0, 1e-5);
    EXPECT_NEAR(record.normal[1], hits * std::sqrt(0.5), 1e-4);
    EXPECT_NEAR(record.normal[2], -hits * std::sqrt(0.5), 1e-4);
    if (x == 0) {
      // Rows of samples are 1/24 m apart.
      EXPECT_NEAR(record.depth, hits * (2 - z), hits / 24 / 4) << "pixel " << pixel;
    }
    if (x == 2) {
      EXPECT_EQ(record.depth, 0);
    }
  }
}

}  // namespace
}  // namespace gleaner::test

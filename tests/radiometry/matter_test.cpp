// What light does at matter, in closed forms: lamps with two faces and with holes, panes, frosted sheets, metal that
// claims to transmit, solids that absorb and lie in one another, and surfaces whose normals for shading are not their
// own. Each by both tracers; where light comes by way of a surface, by `path` and by `vpl` alike.

#include <cmath>
#include <cstdio>
#include <functional>

#include "cli/local_frame.h"
#include "coordinator/plan/plan.h"
#include "scene/library/builder.h"
#include "scene/library/library.h"
#include "tests/radiometry/shot.h"

namespace gleaner::test {
namespace {

using scene::grey;
using scene::Material;
using scene::SceneBuilder;
using scene::Vec;
using worker::TraceKind;

constexpr double kFamily = 1e-3;
constexpr double kFloor = 0.8;
constexpr TraceKind kTracers[] = {TraceKind::automatic, TraceKind::opencl};

// Form factor from the origin of a floor (normal +y) to a polygon above it (Lambert 1760).
double form_factor(const std::vector<Vec>& corners, Vec p = {}, Vec n = {0, 1, 0}) {
  double sum = 0;
  for (std::size_t i = 0; i < corners.size(); ++i) {
    const Vec a = scene::normalize(corners[i] - p), b = scene::normalize(corners[(i + 1) % corners.size()] - p);
    const Vec across = scene::cross(a, b);
    const double sine = std::sqrt(scene::dot(across, across));
    if (sine > 0) sum += std::atan2(sine, scene::dot(a, b)) * scene::dot(n, (1 / sine) * across);
  }
  return std::abs(sum) / (2 * M_PI);
}

// Exact unpolarized Fresnel reflectance; of a thin sheet with its inner reflections.
double fresnel(double c, double eta) {
  const double sin2 = (1 - c * c) / (eta * eta);
  if (sin2 >= 1) return 1;
  const double t = std::sqrt(1 - sin2);
  const double s = (c - eta * t) / (c + eta * t), p = (eta * c - t) / (eta * c + t);
  return (s * s + p * p) / 2;
}
double sheet_passes(double c, double ior = 1.5) { return (1 - fresnel(c, ior)) / (1 + fresnel(c, ior)); }

Material pane(scene::Rgb tint, double roughness = 0, double transmission = 1) {
  Material m = scene::dielectric(tint, roughness);
  m.transmission = static_cast<float>(transmission);
  return m;
}

void level(SceneBuilder& b, double y, std::uint32_t material, double half = 9) {
  b.quad({-half, y, half}, {half, y, half}, {half, y, -half}, {-half, y, -half}, material);
}

// A Lambert floor at y = 0, looked down upon at the origin through a keyhole: its own radiance alone.
Picture floor_picture(SceneBuilder b, std::uint32_t chunks, TraceKind trace, std::uint32_t depth = 1) {
  b.mesh("floor");
  level(b, 0, b.material("floor", scene::lambert(grey(kFloor))));
  b.camera("camera", {0, 5, 5}, {}, 40, 16, 16);
  Shot shot{.scene = std::make_shared<const Scene>(b.finish())};
  shot.camera = orthographic({0, 0.1, 0}, {1, 0, 0}, {0, 0, -1}, 1e-6);
  shot.width = shot.height = 4;
  shot.chunks = chunks;
  shot.depth = depth;
  shot.trace = trace;
  return shoot(shot);
}

// Of a family of so many.
void expect_floor(const SceneBuilder& lit, double expected, const std::string& what, std::size_t family,
                  std::uint32_t chunks = 256, double noise = 6e-3, std::uint32_t depth = 1, int channel = 1) {
  for (const TraceKind trace : kTracers) {
    const Picture picture = floor_picture(lit, chunks, trace, depth);
    const std::string name = what + (trace == TraceKind::opencl ? ", OpenCL" : "");
    if (!expect_mean(picture.mean(channel), expected, name, sidak(kFamily, 2 * family), noise))
      keep_failure(picture, what);
  }
}

const std::vector<Vec> kLamp{{-0.6, 1.25, -0.4}, {0.6, 1.25, -0.4}, {0.6, 1.25, 0.4}, {-0.6, 1.25, 0.4}};
// Its front looks down where `down`.
void lamp(SceneBuilder& b, const Material& m, bool down) {
  b.mesh("lamp");
  const auto& c = kLamp;
  const std::uint32_t material = b.material("lamp", m);
  if (down)
    b.quad(c[0], c[1], c[2], c[3], material);
  else
    b.quad(c[3], c[2], c[1], c[0], material);
}

Material with(Material m, const std::function<void(Material&)>& change) {
  change(m);
  return m;
}
Material two_sided(Material m) {
  m.flags |= GLEANER_MATERIAL_DOUBLE_SIDED;
  return m;
}

TEST(Matter, LampsShineFromBothFaces) {
  const double expected = kFloor * 6 * form_factor(kLamp);
  for (const bool down : {true, false}) {
    SceneBuilder b("lamp");
    lamp(b, two_sided(scene::emitter(grey(6))), down);
    expect_floor(b, expected, down ? "two-sided lamp, front" : "two-sided lamp, back", 2);
  }
  SceneBuilder one("one-sided");
  lamp(one, scene::emitter(grey(6)), false);
  EXPECT_EQ(floor_picture(one, 2, TraceKind::automatic).mean(1).mean, 0);
}

// Half of the lamp is cut out, or it is there to a share.
TEST(Matter, AlphaWeighsEmission) {
  const double whole = kFloor * 6 * form_factor(kLamp);
  SceneBuilder masked("mask"), blend("blend"), gone("gone");
  Material m = scene::emitter(grey(6));
  m.flags |= GLEANER_MATERIAL_ALPHA_MASK;
  m.base_color_texture = masked.texture(64, 1, true, [](std::uint32_t x, std::uint32_t) {
    return scene::Texel{255, 255, 255, static_cast<std::uint8_t>(x < 32 ? 255 : 0)};
  });
  lamp(masked, m, true);
  // The texture's left half is the lamp's left half.
  expect_floor(masked, kFloor * 6 * form_factor({kLamp[0], {0, 1.25, -0.4}, {0, 1.25, 0.4}, kLamp[3]}),
               "lamp with a hole", 2, 256, 2e-2);
  lamp(blend,
       with(scene::emitter(grey(6)),
            [](Material& x) {
              x.flags |= GLEANER_MATERIAL_ALPHA_BLEND;
              x.alpha = 0.3f;
            }),
       true);
  expect_floor(blend, 0.3 * whole, "lamp of alpha 0.3", 2);
  lamp(gone,
       with(scene::emitter(grey(6)),
            [](Material& x) {
              x.flags |= GLEANER_MATERIAL_ALPHA_BLEND;
              x.alpha = 0;
            }),
       true);
  EXPECT_EQ(floor_picture(gone, 2, TraceKind::automatic).mean(1).mean, 0);
}

// Sun, point lights, lamps and skies through panes. A surface without light samples of its own (unlit) is found by
// scattered rays alone; a punctual light by shadow rays alone; a lamp by both: all of them pass the same panes, and
// none is counted twice.
TEST(Matter, LightThroughPanes) {
  const double tint[3] = {0.9, 0.5, 0.2};
  const auto panes = [&](int count) {
    SceneBuilder b("panes");
    b.mesh("panes");
    const std::uint32_t glass = b.material("glass", pane({tint[0], tint[1], tint[2]}));
    for (int k = 0; k < count; ++k) level(b, 0.3 + 0.1 * k, glass, 40);
    return b;
  };
  for (const int count : {1, 2, 3}) {
    const std::string through = " through " + std::to_string(count);
    const auto passes = [&](double c) { return std::pow(sheet_passes(c) * tint[1], count); };
    // Depth 1: passing is no scattering. What panes mirror back and forth is left to other depths.
    SceneBuilder sun = panes(count), point = panes(count);
    const Vec from = scene::normalize(Vec{0.4, 0.8, 0.2});
    sun.directional_light(-1.0 * from, grey(3));
    expect_floor(sun, kFloor / M_PI * 3 * from.y * passes(from.y), "sun" + through, 15, 1, 1e-5);
    const Vec at{0.3, 2, -0.7};
    const double d2 = scene::dot(at, at), cosine = at.y / std::sqrt(d2);
    point.point_light(at, grey(7));
    expect_floor(point, kFloor / M_PI * 7 * cosine / d2 * passes(cosine), "point light" + through, 15, 1, 1e-5);

    // A lamp at one cosine to within a thousandth; the same lamp, unlit.
    const double half = 0.05, height = 3;
    const std::vector<Vec> corners{
        {-half, height, -half}, {half, height, -half}, {half, height, half}, {-half, height, half}};
    const double expected = kFloor * form_factor(corners) * passes(1);
    SceneBuilder lamps = panes(count), sky = panes(count), unlit = panes(count);
    lamps.mesh("lamp");
    lamps.quad(corners[0], corners[1], corners[2], corners[3], lamps.material("lamp", scene::emitter(grey(1))));
    expect_floor(lamps, expected, "lamp" + through, 15, 256, 6e-3);
    // Wide: by quadrature over the sky of radiance 1.
    double wide = 0;
    for (int k = 0; k < 4000; ++k) {
      const double mu = (k + 0.5) / 4000;
      wide += 2 * mu * passes(mu) / 4000;
    }
    sky.environment(4, [](Vec) { return grey(1); });
    expect_floor(sky, kFloor * wide, "sky" + through, 15, 512, 6e-3);
    unlit.mesh("unlit");
    Material plain = scene::lambert(grey(1));
    plain.flags |= GLEANER_MATERIAL_UNLIT;
    level(unlit, 900, unlit.material("unlit", plain), 4e5);
    expect_floor(unlit, kFloor * wide, "unlit ceiling" + through, 15, 512, 6e-3);
  }
}

// What is not opaque and what transmits, in one surface.
TEST(Matter, PanesThatAreNotOpaque) {
  SceneBuilder b("both");
  b.mesh("pane");
  Material m = pane(grey(0.6), 0, 0.5);
  m.flags |= GLEANER_MATERIAL_ALPHA_BLEND;
  m.alpha = 0.7f;
  level(b, 0.5, b.material("pane", m));
  b.directional_light({0, -1, 0}, grey(2));
  expect_floor(b, kFloor / M_PI * 2 * (0.3 + 0.7 * 0.5 * 0.6 * sheet_passes(1)), "half a pane of alpha 0.7", 1, 1,
               1e-5);
}

// --- Path and virtual point lights ---

struct Means {
  Sample path, vpl;
};
// The picture's mean by both methods, over seeds.
Means means_of(const std::shared_ptr<const Scene>& made, std::uint32_t spp, std::uint32_t seeds) {
  Means means;
  worker::Executor& on = executor(TraceKind::automatic);
  const std::string id = load(on, made);
  for (const char* method : {"path", "vpl"})
    for (std::uint32_t seed = 1; seed <= seeds; ++seed) {
      coordinator::FrameSettings settings;
      settings.method = method;
      settings.width = settings.height = 16;
      settings.spp = spp;
      settings.seed = seed;
      settings.camera = camera_of(*made);
      settings.camera.half_width = settings.camera.half_height;
      if (settings.method == "vpl")
        settings.set = {{"vpl.count", "4000"}, {"vpl.clusters", "0"}, {"vpl.point_clusters", "0"}};
      auto plan = coordinator::make_plan(settings, coordinator::summarize(*made));
      cli::run_frame(*plan, on, id);
      const coordinator::Film film = plan->film();
      double sum = 0;
      for (const char* channel : {"R", "G", "B"})
        for (const float value : film.find(channel)->values) sum += value;
      (settings.method == "vpl" ? means.vpl : means.path).add(sum / (3.0 * 256));
    }
  return means;
}
void expect_same_means(const std::shared_ptr<const Scene>& made, const std::string& what, std::size_t family,
                       std::uint32_t spp = 256, std::uint32_t seeds = 8) {
  const Means m = means_of(made, spp, seeds);
  const double error = std::hypot(m.path.standard_error(), m.vpl.standard_error());
  const double t = (m.vpl.mean - m.path.mean) / error;
  std::printf("  %-32s path %.5f +- %.5f, vpl %.5f +- %.5f, t = %.2f\n", what.c_str(), m.path.mean,
              m.path.standard_error(), m.vpl.mean, m.vpl.standard_error(), t);
  EXPECT_GE(student_p(t, seeds - 1.0), sidak(kFamily, family)) << what;
  EXPECT_LT(error, 0.01 * m.path.mean) << what << ": too noisy to prove anything";
}

// A room with a window in its ceiling; what is above is given.
SceneBuilder room(const Material& window, const std::string& name) {
  SceneBuilder b(name);
  b.mesh("walls");
  const std::uint32_t wall = b.material("wall", scene::lambert({0.7, 0.6, 0.5}));
  const std::uint32_t glass = b.material("window", window);
  level(b, -1, wall, 1);
  b.quad({-1, -1, -1}, {1, -1, -1}, {1, 1, -1}, {-1, 1, -1}, wall);
  b.quad({-1, -1, 1}, {-1, -1, -1}, {-1, 1, -1}, {-1, 1, 1}, wall);
  b.quad({1, -1, -1}, {1, -1, 1}, {1, 1, 1}, {1, 1, -1}, wall);
  b.quad({1, -1, 1}, {-1, -1, 1}, {-1, 1, 1}, {1, 1, 1}, wall);
  // The ceiling around the window.
  b.quad({-1, 1, -1}, {1, 1, -1}, {1, 1, -0.6}, {-1, 1, -0.6}, wall);
  b.quad({-1, 1, 0.6}, {1, 1, 0.6}, {1, 1, 1}, {-1, 1, 1}, wall);
  b.quad({-1, 1, -0.6}, {-0.6, 1, -0.6}, {-0.6, 1, 0.6}, {-1, 1, 0.6}, wall);
  b.quad({0.6, 1, -0.6}, {1, 1, -0.6}, {1, 1, 0.6}, {0.6, 1, 0.6}, wall);
  b.mesh("window");
  b.quad({-0.6, 1, -0.6}, {0.6, 1, -0.6}, {0.6, 1, 0.6}, {-0.6, 1, 0.6}, glass);
  b.camera("camera", {0, -0.2, 0.95}, {0, -0.4, -1}, 70, 16, 16);
  return b;
}

TEST(Matter, SunlitRoomByPathAndVpl) {
  SceneBuilder b = room(pane({0.9, 0.95, 1}), "sunlit");
  b.directional_light({0.3, -0.9, -0.2}, grey(8));
  expect_same_means(std::make_shared<const Scene>(b.finish()), "sun through a window", 4);
  SceneBuilder sky = room(pane({0.9, 0.95, 1}), "skylit");
  sky.environment(4, [](Vec) { return grey(1); });
  expect_same_means(std::make_shared<const Scene>(sky.finish()), "sky through a window", 4, 1024);
  SceneBuilder frosted = room(pane(grey(0.9), 0.6), "frosted");
  frosted.environment(4, [](Vec) { return grey(1); });
  expect_same_means(std::make_shared<const Scene>(frosted.finish()), "sky through frosted glass", 4, 1024);
  SceneBuilder lit = room(scene::lambert(grey(0.5)), "two-sided");
  lit.mesh("lamp");
  lit.quad({-0.3, 0.3, 0.3}, {0.3, 0.3, 0.3}, {0.3, 0.3, -0.3}, {-0.3, 0.3, -0.3},
           lit.material("lamp", two_sided(scene::emitter(grey(3)))));
  expect_same_means(std::make_shared<const Scene>(lit.finish()), "two-sided lamp", 4);
}

// No shadow ray finds its way through a refracting solid or by a mirror: what punctual lights send there is left out,
// by all methods alike.
TEST(Matter, NoMethodCarriesPunctualLightThroughSolids) {
  for (const bool mirror : {false, true}) {
    SceneBuilder b = room(scene::lambert(grey(0.5)), mirror ? "mirror" : "ball");
    b.mesh("body");
    if (mirror)
      b.quad({-0.9, -0.9, -0.5}, {0.9, -0.9, -0.5}, {0.9, 0.6, -0.9}, {-0.9, 0.6, -0.9},
             b.material("mirror", scene::metal(grey(0.9), 0)));
    else
      b.sphere({0.1, 0, -0.2}, 0.45, 32, b.material("glass", scene::solid_glass(1.5)));
    b.point_light({-0.2, 0.8, 0.1}, grey(3));
    expect_same_means(std::make_shared<const Scene>(b.finish()),
                      mirror ? "mirror and point light" : "glass and point light", 2);
  }
}

// --- Frosted glass ---

// Beneath what `build` adds, a floor under a lamp: light samples and scattered rays add up to what scattered rays alone
// find, where the lamp is a surface that takes no light samples.
void expect_lit_alike(const std::string& name, const std::function<void(SceneBuilder&)>& build, double least_p) {
  double mean[2], error[2];
  for (const bool unlit : {false, true}) {
    SceneBuilder b("lit alike");
    build(b);
    Material light = scene::emitter(grey(1));
    if (unlit) {
      light = scene::lambert(grey(1));
      light.flags |= GLEANER_MATERIAL_UNLIT;
    }
    b.mesh("lamp");
    b.quad({-0.7, 1.4, -0.7}, {0.7, 1.4, -0.7}, {0.7, 1.4, 0.7}, {-0.7, 1.4, 0.7}, b.material("lamp", light));
    const Sample seen = floor_picture(b, 512, TraceKind::automatic, 6).mean(1);
    mean[unlit] = seen.mean;
    error[unlit] = seen.standard_error();
  }
  const double t = (mean[0] - mean[1]) / std::hypot(error[0], error[1]);
  std::printf("  %s: %.5f +- %.5f with light samples, %.5f +- %.5f without, t = %.2f\n", name.c_str(), mean[0],
              error[0], mean[1], error[1], t);
  EXPECT_GE(student_p(t, 511), least_p) << name;
  EXPECT_LT(error[0], error[1]) << name << ": light samples are worth nothing";
  EXPECT_LT(std::hypot(error[0], error[1]), 0.03 * mean[1]) << name << ": too noisy to prove anything";
}

// Thin and solid.
TEST(Matter, RoughGlassIsLitAlike) {
  for (const bool solid : {false, true})
    for (const double roughness : {0.3, 0.7}) {
      const auto build = [&](SceneBuilder& b) {
        b.mesh("glass");
        const Material glass = solid ? scene::solid_glass(1.5, roughness) : pane(grey(0.9), roughness);
        if (solid)
          b.box({0, 0.6, 0}, {2, 0.2, 2}, 0, b.material("glass", glass));
        else
          level(b, 0.6, b.material("glass", glass), 2);
      };
      expect_lit_alike((solid ? "solid, roughness " : "sheet, roughness ") + std::to_string(roughness), build,
                       sidak(kFamily, 4));
    }
}

// --- Solids ---

// What a pixel in the middle of a camera at `from` that looks along -z sees.
double seen_along_z(SceneBuilder b, Vec from, TraceKind trace, int channel, std::uint32_t depth = 0) {
  b.camera("camera", from, from - Vec{0, 0, 1}, 1e-4, 16, 16);
  Shot shot{.scene = std::make_shared<const Scene>(b.finish())};
  shot.camera = camera_of(*shot.scene);
  shot.width = shot.height = 4;
  shot.chunks = 4;
  shot.depth = depth;
  shot.trace = trace;
  return shoot(shot).mean(channel).mean;
}
Material tinted(double ior, std::array<float, 3> absorption) {
  Material m = scene::solid_glass(ior);
  std::copy(absorption.begin(), absorption.end(), m.attenuation);
  return m;
}
constexpr float kAbsorbs[3] = {0.7f, 0.0f, 1.3f};

void card(SceneBuilder& b, double z, double radiance, double half = 0.3) {
  b.mesh("card");
  b.quad({-half, -half, z}, {half, -half, z}, {half, half, z}, {-half, half, z},
         b.material("card", scene::emitter(grey(radiance))));
}

// Absorption is over every metre inside, whatever a segment begins and ends on.
TEST(Matter, SolidsAbsorbOverEveryMetre) {
  for (const TraceKind trace : kTracers)
    for (int k = 0; k < 3; ++k) {
      const auto left = [&](double metres) { return std::exp(-double{kAbsorbs[k]} * metres); };
      const auto block = [&](SceneBuilder& b, double near, double far, const Material& m) {
        b.mesh("block");
        b.box({0, 0, (near + far) / 2}, {1, 1, (near - far) / 2}, 0, b.material("block", m));
      };
      const Material clear = tinted(1, {kAbsorbs[0], kAbsorbs[1], kAbsorbs[2]});
      const auto check = [&](const char* what, double seen, double expected) {
        std::printf("  %-40s channel %d: %.6f, expected %.6f\n", what, k, seen, expected);
        EXPECT_NEAR(seen, expected, 2e-5 * expected) << what;
      };
      {
        SceneBuilder b("within");
        block(b, -1, -4, clear);
        card(b, -2, 6);
        check("lamp 1 m deep", seen_along_z(b, {}, trace, k), 6 * left(1));
      }
      {
        SceneBuilder b("behind");
        block(b, -1, -4, clear);
        card(b, -6, 6);
        check("lamp behind 3 m", seen_along_z(b, {}, trace, k), 6 * left(3));
      }
      {
        SceneBuilder b("camera within");
        block(b, 1.5, -4, clear);
        card(b, -6, 6);
        check("camera 4 m deep, lamp outside", seen_along_z(b, {}, trace, k), 6 * left(4));
        card(b, -2, 5);
        check("camera and lamp within", seen_along_z(b, {}, trace, k), 5 * left(2));
      }
      {
        // The inner solid, whose box is the smaller, fills its space.
        SceneBuilder b("nested");
        block(b, -1, -6, clear);
        b.mesh("bubble");
        b.box({0, 0, -3}, {0.5, 0.5, 1}, 0, b.material("bubble", tinted(1, {0, 0.4f, 0})));
        card(b, -8, 6);
        check("bubble in a block", seen_along_z(b, {}, trace, k), 6 * left(3) * (k == 1 ? std::exp(-0.8) : 1));
      }
      {
        // They overlap by half a metre, which is the smaller one's.
        SceneBuilder b("overlapping");
        block(b, -1, -4, clear);
        b.mesh("other");
        b.box({0, 0, -4}, {0.5, 0.5, 0.5}, 0, b.material("other", tinted(1, {0, 0.4f, 0})));
        card(b, -8, 6);
        check("overlapping blocks", seen_along_z(b, {}, trace, k), 6 * left(2.5) * (k == 1 ? std::exp(-0.4) : 1));
        SceneBuilder back("overlapping, from the other side");
        block(back, -4, -7, clear);
        back.mesh("other");
        back.box({0, 0, -4}, {0.5, 0.5, 0.5}, 0, back.material("other", tinted(1, {0, 0.4f, 0})));
        card(back, -9, 6);
        check("the same from the other side", seen_along_z(back, {}, trace, k),
              6 * left(2.5) * (k == 1 ? std::exp(-0.4) : 1));
      }
      {
        // A light sample inside: a point light half a metre above a card that reflects, 1 m from the camera.
        SceneBuilder b("lit within");
        block(b, 2, -4, clear);
        b.mesh("floor");
        b.quad({-0.2, -0.2, -1}, {0.2, -0.2, -1}, {0.2, 0.2, -1}, {-0.2, 0.2, -1},
               b.material("floor", scene::lambert(grey(0.5))));
        b.point_light({0.3, 0, -0.6}, grey(2));
        check("lit within", seen_along_z(b, {}, trace, k, 1), 0.5 / M_PI * 2 * 0.8 / 0.25 * left(0.5) * left(1));
      }
    }
}

// Who leaves a solid that was never entered, since it is open, has been in it since the ray began.
TEST(Matter, OpenSolidsAbsorbFromWhereTheRayBegan) {
  for (const TraceKind trace : kTracers) {
    SceneBuilder b("open");
    b.mesh("back");
    b.quad({1, -1, -4}, {-1, -1, -4}, {-1, 1, -4}, {1, 1, -4}, b.material("back", tinted(1, {0.7f, 0.7f, 0.7f})));
    card(b, -6, 6);
    EXPECT_NEAR(seen_along_z(b, {}, trace, 1), 6 * std::exp(-0.7 * 4), 1e-5);
  }
}

// What of a solid lies within another of higher rank is not there: it tints nothing either.
TEST(Matter, HiddenBoundariesDoNotTint) {
  for (const TraceKind trace : kTracers) {
    SceneBuilder b("hidden");
    Material half = tinted(1, {0, 0, 0});
    std::fill(half.base_color, half.base_color + 3, 0.5f);
    b.mesh("wide");
    b.box({0, 0, -2}, {2, 2, 1}, 0, b.material("wide", half));
    b.mesh("narrow");
    b.box({0, 0, -3}, {1, 1, 1}, 0, b.material("narrow", tinted(1, {0, 0, 0})));
    card(b, -6, 6);
    EXPECT_NEAR(seen_along_z(b, {}, trace, 1), 6 * 0.5, 1e-5);
  }
}

// A solid of index 1 does not bend light: shadow rays go through it, weakened, from outside, from within and into it;
// and a lamp's light is not counted twice.
TEST(Matter, ShadowRaysPassWhatDoesNotBend) {
  const auto tank = [](double low, double high) {
    SceneBuilder b("tank");
    b.mesh("block");
    b.box({0, (low + high) / 2, 0}, {8, (high - low) / 2, 8}, 0,
          b.material("block", tinted(1, {kAbsorbs[0], kAbsorbs[1], kAbsorbs[2]})));
    return b;
  };
  const auto left = [](double metres) { return std::exp(-double{kAbsorbs[0]} * metres); };
  SceneBuilder sun = tank(0.5, 1.5), point = tank(0.5, 1.5), into = tank(0.5, 4), lamps = tank(0.5, 1.5);
  sun.directional_light({0, -0.8, 0.6}, grey(2));
  expect_floor(sun, kFloor / M_PI * 2 * 0.8 * left(1 / 0.8), "sun through a tinted block", 4, 1, 1e-5, 1, 0);
  point.point_light({0, 3, 0}, grey(7));
  expect_floor(point, kFloor / M_PI * 7 / 9 * left(1), "point light through a tinted block", 4, 1, 1e-5, 1, 0);
  into.point_light({0, 3, 0}, grey(7));
  expect_floor(into, kFloor / M_PI * 7 / 9 * left(2.5), "point light within a tinted block", 4, 1, 1e-5, 1, 0);
  const double half = 0.05, height = 3;
  const std::vector<Vec> corners{
      {-half, height, -half}, {half, height, -half}, {half, height, half}, {-half, height, half}};
  lamps.mesh("lamp");
  lamps.quad(corners[0], corners[1], corners[2], corners[3], lamps.material("lamp", scene::emitter(grey(1))));
  // The lamp's corners are seen through a little more of the block than its middle: by midpoints of 32 x 32 pieces.
  constexpr int pieces = 32;
  double lit = 0;
  for (int i = 0; i < pieces; ++i)
    for (int j = 0; j < pieces; ++j) {
      const double x = half * (2 * (i + 0.5) / pieces - 1), z = half * (2 * (j + 0.5) / pieces - 1);
      const double d2 = x * x + z * z + height * height, cosine = height / std::sqrt(d2);
      lit += cosine * cosine / (M_PI * d2) * std::pow(2 * half / pieces, 2) * left(1 / cosine);
    }
  expect_floor(lamps, kFloor * lit, "lamp through a tinted block", 4, 256, 6e-3, 1, 0);
}

// The index beyond a boundary is that of what fills the space there: glass in water of its own index is not seen.
TEST(Matter, NestedSolidsBendByTheirRatio) {
  for (const TraceKind trace : kTracers) {
    const auto fish_tank = [](double ior) {
      SceneBuilder b("tank");
      b.mesh("water");
      b.box({0, 0, -3}, {4, 4, 2}, 0, b.material("water", tinted(1.33, {})));
      b.mesh("ball");
      b.box({0, 0, -3}, {1, 1, 1}, 0, b.material("ball", tinted(ior, {})));
      card(b, -8, 1, 3);
      return b;
    };
    // At normal incidence all that is lost is mirrored; inner reflections end at depth 4.
    const double outer = 1 - fresnel(1, 1.33);
    const double inner = 1 - fresnel(1, 1.8 / 1.33);
    EXPECT_NEAR(seen_along_z(fish_tank(1.33), {}, trace, 1, 2), outer * outer, 1e-2);
    Sample sample;
    const double seen = seen_along_z(fish_tank(1.8), {}, trace, 1, 4);
    std::printf("  glass in water: %.5f, expected %.5f\n", seen, outer * outer * inner * inner);
    EXPECT_NEAR(seen, outer * outer * inner * inner, 3e-2);
  }
}

// --- Normals for shading ---

// An opaque sheet whose vertices' normals lean by 50 degrees, or whose normal map does.
void leaning_sheet(SceneBuilder& b, bool mapped) {
  b.mesh("sheet");
  Material m = scene::lambert(grey(0.6));
  const double angle = 50 * M_PI / 180;
  const Vec n = mapped ? Vec{} : Vec{std::sin(angle), std::cos(angle), 0};
  if (mapped)
    m.normal_texture = b.texture(1, 1, false, [&](std::uint32_t, std::uint32_t) {
      const auto byte = [](double c) { return static_cast<std::uint8_t>(std::lround((c + 1) / 2 * 255)); };
      return scene::Texel{byte(std::sin(angle)), 128, byte(std::cos(angle)), 255};
    });
  const std::uint32_t material = b.material("sheet", m);
  const std::uint32_t first = b.vertex({-9, 0, 9}, n, 0, 1);
  b.vertex({9, 0, 9}, n, 1, 1);
  b.vertex({9, 0, -9}, n, 1, 0);
  b.vertex({-9, 0, -9}, n, 0, 0);
  b.triangle(first, first + 1, first + 2, material);
  b.triangle(first, first + 2, first + 3, material);
}
double sheet_radiance(SceneBuilder b, TraceKind trace) {
  Shot shot{.scene = std::make_shared<const Scene>(b.finish())};
  shot.camera = orthographic({0, 1, 0}, {1, 0, 0}, {0, 0, -1}, 0.1);
  shot.width = shot.height = 4;
  shot.chunks = 2;
  shot.trace = trace;
  return shoot(shot).mean(1).mean;
}

TEST(Matter, NoSheetIsLitFromBehind) {
  for (const TraceKind trace : kTracers)
    for (const bool mapped : {false, true}) {
      // 8 degrees below the horizon, on the side to which the normals lean.
      SceneBuilder night("night"), day("day"), lamp_below("lamp"), sky("sky");
      for (SceneBuilder* b : {&night, &day, &lamp_below, &sky}) {
        leaning_sheet(*b, mapped);
        b->camera("camera", {0, 5, 5}, {}, 40, 16, 16);
      }
      const double angle = 8 * M_PI / 180;
      night.directional_light({-std::cos(angle), std::sin(angle), 0}, grey(3));
      EXPECT_EQ(sheet_radiance(night, trace), 0);
      lamp_below.mesh("lamp");
      lamp_below.quad({3, -2, 3}, {3, -2, -3}, {3, -0.1, -3}, {3, -0.1, 3},
                      lamp_below.material("lamp", two_sided(scene::emitter(grey(5)))));
      EXPECT_EQ(sheet_radiance(lamp_below, trace), 0);
      // Bright below the horizon alone: neither samples nor scattered rays leak.
      sky.environment(64, [](Vec d) { return grey(d.y < -0.3 ? 5 : 0); });
      EXPECT_EQ(sheet_radiance(sky, trace), 0);
      // From above it is lit by its bent normal.
      day.directional_light(scene::normalize({-1, -1, 0}), grey(3));
      EXPECT_NEAR(sheet_radiance(day, trace), 0.6 / M_PI * 3 * std::cos(5 * M_PI / 180), 0.08);
    }
}

// --- Sheets that light shines through ---

Material shining(Material m, double share, double color) {
  m.diffuse_transmission = static_cast<float>(share);
  std::fill(m.diffuse_transmission_color, m.diffuse_transmission_color + 3, static_cast<float>(color));
  return m;
}

// A sheet at y = 0 under the lamp, seen at the origin from one side.
Picture lit_sheet(const Material& sheet, bool from_below, TraceKind trace) {
  SceneBuilder b("sheet");
  lamp(b, scene::emitter(grey(6)), true);
  b.mesh("sheet");
  level(b, 0, b.material("sheet", sheet));
  b.camera("camera", {0, 5, 5}, {}, 40, 16, 16);
  Shot shot{.scene = std::make_shared<const Scene>(b.finish())};
  shot.camera = from_below ? orthographic({0, -0.1, 0}, {1, 0, 0}, {0, 0, 1}, 1e-6)
                           : orthographic({0, 0.1, 0}, {1, 0, 0}, {0, 0, -1}, 1e-6);
  shot.width = shot.height = 4;
  shot.chunks = 256;
  shot.depth = 1;
  shot.trace = trace;
  return shoot(shot);
}

TEST(Matter, LightShinesThroughSheets) {
  const double irradiance = 6 * form_factor(kLamp);  // over pi
  const Material sheet = shining(scene::lambert(grey(0.8)), 0.4, 0.5);
  for (const TraceKind trace : kTracers) {
    const std::string by = trace == TraceKind::opencl ? ", OpenCL" : "";
    expect_mean(lit_sheet(sheet, true, trace).mean(1), 0.4 * 0.5 * irradiance, "lit from behind" + by,
                sidak(kFamily, 4), 6e-3);
    expect_mean(lit_sheet(sheet, false, trace).mean(1), 0.6 * 0.8 * irradiance, "lit from the front" + by,
                sidak(kFamily, 4), 6e-3);
    EXPECT_EQ(lit_sheet(scene::lambert(grey(0.8)), true, trace).mean(1).mean, 0);
  }
}

TEST(Matter, SheetsThatShineAreLitAlike) {
  const auto build = [](SceneBuilder& b) {
    b.mesh("shade");
    level(b, 0.6, b.material("shade", shining(scene::dielectric(grey(0.5), 0.3), 0.7, 0.9)), 2);
  };
  expect_lit_alike("glossy sheet that light shines through", build, kFamily);
}

TEST(Matter, PaperWindowByPathAndVpl) {
  const Material paper = shining(scene::dielectric({0.6, 0.5, 0.4}, 0.5), 0.6, 0.8);
  SceneBuilder sun = room(paper, "paper");
  sun.directional_light({0.3, -0.9, -0.2}, grey(8));
  expect_same_means(std::make_shared<const Scene>(sun.finish()), "sun on a paper window", 2, 1024);
  SceneBuilder inside = room(paper, "lantern");
  inside.mesh("screen");
  inside.quad({-0.9, -1, -0.2}, {0.9, -1, -0.2}, {0.9, 0.7, -0.2}, {-0.9, 0.7, -0.2}, inside.material("screen", paper));
  inside.point_light({0.2, 0.2, -0.6}, grey(2));
  expect_same_means(std::make_shared<const Scene>(inside.finish()), "point light behind a screen", 2, 1024);
}

// A white sphere of few triangles in a white furnace gives back at most what it gets, and hardly less; no speck is
// black.
TEST(Matter, FewTrianglesMakeNoSpecks) {
  SceneBuilder b("sphere");
  b.mesh("sphere");
  b.sphere({}, 1, 12, b.material("white", scene::lambert(grey(1))));
  b.environment(4, [](Vec) { return grey(1); });
  b.camera("camera", {0, 0, 5}, {}, 26, 32, 32);
  Shot shot{.scene = std::make_shared<const Scene>(b.finish())};
  shot.camera = camera_of(*shot.scene);
  shot.samples = 64;
  const Picture picture = shoot(shot);
  double darkest = 1e9, brightest = 0;
  for (std::size_t i = 0; i < picture.pixels(); ++i) {
    const double value = picture.pixel(i, 1).mean;
    darkest = std::min(darkest, value);
    brightest = std::max(brightest, value);
  }
  const double mean = picture.mean(1).mean;
  std::printf("  mean %.4f, darkest pixel %.4f, brightest %.4f\n", mean, darkest, brightest);
  EXPECT_LT(mean, 1);
  EXPECT_GT(mean, 0.95);
  EXPECT_GT(darkest, 0.6);
  if (HasFailure()) keep_failure(picture, "sphere");
}

}  // namespace
}  // namespace gleaner::test

// Whatever geometry comes: a clear error, or a picture without a value that is not finite.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <bit>
#include <random>

#include "scene/library/builder.h"
#include "scene/library/library.h"
#include "scene/model/error.h"
#include "scene/model/limits.h"
#include "tests/numerics/rendering.h"

namespace gleaner::test {
namespace {

using testing::HasSubstr;
using Vec = scene::Vec;

class Random {
 public:
  explicit Random(std::uint64_t seed) : engine_(seed) {}
  std::uint32_t bits() { return static_cast<std::uint32_t>(engine_()); }
  bool chance(unsigned one_in) { return bits() % one_in == 0; }
  double unit() { return bits() * 0x1p-32; }
  double within(double most) { return most * (2 * unit() - 1); }
  // Any bit pattern that a coordinate may have: zeros, denormals, all magnitudes up to 10^9.
  float coordinate() {
    for (;;) {
      const auto x = std::bit_cast<float>(bits());
      if (std::fabs(x) <= 1e9f) return x;
    }
  }

 private:
  std::mt19937_64 engine_;
};

// A lit floor of 4 m, which keeps the variants of the kernels few; what a test is about comes on top.
scene::SceneBuilder stage(const std::string& name, double emission = 6) {
  scene::SceneBuilder b(name);
  b.mesh("stage");
  const auto wall = b.material("wall", scene::lambert(scene::grey(0.7)));
  b.quad({-2, 0, 2}, {2, 0, 2}, {2, 0, -2}, {-2, 0, -2}, wall);
  const auto light = b.material("light", scene::emitter(scene::grey(emission)));
  b.quad({-0.5, 3, -0.5}, {0.5, 3, -0.5}, {0.5, 3, 0.5}, {-0.5, 3, 0.5}, light);
  return b;
}
constexpr std::uint32_t kWall = 0;

scene::Camera from(std::array<float, 3> eye, std::array<float, 3> target) {
  return scene::look_at(eye, target, 0.9f).camera;
}
const scene::Camera kOverlook = from({0, 1.5f, 5}, {0, 1, 0});

class Hostile : public WithRenderer {
 protected:
  // True where the picture is finite, false where the scene was refused; anything else fails the test.
  bool survives(const scene::Scene& scene, const scene::Camera& camera = kOverlook, const Shot& shot = {}) {
    Picture picture;
    try {
      picture = renderer_->render(scene, camera, shot);
    } catch (const Error& error) {
      refusal_ = error.what();
      EXPECT_EQ(error.kind(), ErrorKind::bad_input) << scene.name << ": " << refusal_;
      EXPECT_THAT(refusal_, HasSubstr("expected")) << scene.name;
      return false;
    }
    EXPECT_EQ(picture.counters.nonfinite, 0u) << scene.name;
    sum_ = 0;
    for (const auto& record : picture.records) {
      const auto* values = reinterpret_cast<const float*>(&record);
      for (std::size_t k = 0; k < sizeof record / sizeof(float); ++k) {
        if (!std::isfinite(values[k])) {
          ADD_FAILURE() << scene.name << ": record word " << k << " is " << values[k];
          return true;
        }
      }
      for (int c = 0; c < 3; ++c) {
        EXPECT_GE(record.direct[c], 0) << scene.name;
        EXPECT_GE(record.indirect[c], 0) << scene.name;
        sum_ += static_cast<double>(record.direct[c]) + static_cast<double>(record.indirect[c]);
      }
    }
    return true;
  }
  void refused(const scene::Scene& scene, const std::string& element, const scene::Camera& camera = kOverlook) {
    EXPECT_FALSE(survives(scene, camera)) << scene.name;
    EXPECT_THAT(refusal_, HasSubstr(element)) << scene.name;
  }

  std::string refusal_;
  double sum_ = 0;  // of the last picture's radiance
};

TEST_P(Hostile, RandomBitsAsCoordinates) {
  Random random(12);
  int refusals = 0;
  for (int i = 0; i < 60; ++i) {
    scene::SceneBuilder b = stage("bits " + std::to_string(i));
    for (int t = 0; t < 8; ++t) {
      std::uint32_t corner[3];
      for (auto& c : corner) c = b.vertex({random.coordinate(), random.coordinate(), random.coordinate()});
      b.triangle(corner[0], corner[1], corner[2], t % 2 ? kWall : 1);
    }
    scene::Scene scene = b.finish();
    // From anywhere to anywhere, but never from a point at itself.
    const std::array<float, 3> eye{random.coordinate(), random.coordinate(), random.coordinate()};
    const std::array<float, 3> target{eye[0] + 1 + std::fabs(eye[0]), random.coordinate(), random.coordinate()};
    EXPECT_TRUE(survives(scene)) << "valid coordinates were refused: " << refusal_;
    EXPECT_TRUE(survives(scene, from(eye, target))) << "valid coordinates were refused: " << refusal_;
    // Now bits that may be anything, in one coordinate or in all.
    for (std::size_t k = 24; k < scene.positions.size(); ++k)
      if (i % 2 || random.chance(16)) scene.positions[k] = std::bit_cast<float>(random.bits());
    const bool valid =
        std::all_of(scene.positions.begin(), scene.positions.end(), [](float x) { return std::fabs(x) <= 1e9f; });
    EXPECT_EQ(survives(scene), valid);
    if (!valid) {
      EXPECT_THAT(refusal_, HasSubstr("positions["));
    }
    refusals += !valid;
  }
  std::printf("120 scenes of valid bits rendered; of 60 of any bits, %d refused\n", refusals);
  EXPECT_GT(refusals, 30);
}

TEST_P(Hostile, RandomIndices) {
  Random random(13);
  const scene::Scene good = scene::make_scene("cornell-box");
  const scene::Camera camera = good.cameras[0].camera;
  for (int i = 0; i < 20; ++i) {
    scene::Scene scene = good;
    scene.name = "indices " + std::to_string(i);
    for (auto& index : scene.indices)
      if (random.chance(32)) index = random.bits() % static_cast<std::uint32_t>(scene.vertex_count());
    EXPECT_TRUE(survives(scene, camera));
    scene.indices[random.bits() % scene.indices.size()] =
        static_cast<std::uint32_t>(scene.vertex_count()) + random.bits() / 2;
    refused(scene, "indices[", camera);
  }
}

TEST_P(Hostile, TrianglesWithoutAreaOrWithoutNumber) {
  scene::SceneBuilder b = stage("degenerate");
  Random random(14);
  for (int i = 0; i < 300; ++i) {
    const Vec p{random.within(2), 3 * random.unit(), random.within(2)},
        e{random.within(1), random.within(1), random.within(1)};
    const auto a = b.vertex(p), c = b.vertex(p + e);
    const std::uint32_t material = i % 2 ? kWall : 1;  // emitters without area, too
    b.triangle(a, a, a, material);
    b.triangle(a, c, a, material);
    b.triangle(a, c, b.vertex(p + 0.5 * e), material);
  }
  EXPECT_TRUE(survives(b.finish()));
  EXPECT_GT(sum_, 0);

  b = stage("duplicates");
  for (int i = 0; i < 2000; ++i)
    b.triangle(b.vertex({-1, 1, 0}), b.vertex({1, 1, 0}), b.vertex({0, 2, 0}), i % 2 ? kWall : 1);
  EXPECT_TRUE(survives(b.finish()));

  EXPECT_TRUE(survives(scene::make_scene("needles"), scene::make_scene("needles").cameras[0].camera));
  b = stage("specks and plains");
  for (int i = 0; i < 40; ++i) {
    const double size = std::pow(10.0, -30 + i);
    const Vec p{random.within(1), 1, random.within(1)};
    b.triangle(b.vertex(p), b.vertex(p + Vec{std::min(size, 5e8), 0, 0}), b.vertex(p + Vec{0, std::min(size, 5e8), 0}),
               i % 2 ? kWall : 1);
  }
  EXPECT_TRUE(survives(b.finish()));
}

TEST_P(Hostile, Nothing) {
  scene::SceneBuilder b("nothing");
  EXPECT_TRUE(survives(b.finish()));
  EXPECT_EQ(sum_, 0);
  b = scene::SceneBuilder("no lights");
  b.mesh("wall");
  b.quad({-2, 0, 2}, {2, 0, 2}, {2, 0, -2}, {-2, 0, -2}, b.material("wall", scene::lambert(scene::grey(0.7))));
  EXPECT_TRUE(survives(b.finish()));
  EXPECT_EQ(sum_, 0);
  EXPECT_TRUE(survives(stage("no light to speak of", 0).finish()));
  EXPECT_EQ(sum_, 0);
  b = scene::SceneBuilder("only a light that shines away");
  b.mesh("light");
  b.quad({-2, 0, 2}, {-2, 0, -2}, {2, 0, -2}, {2, 0, 2}, b.material("light", scene::emitter(scene::grey(6))));
  EXPECT_TRUE(survives(b.finish()));
  EXPECT_EQ(sum_, 0);
}

TEST_P(Hostile, FilmsOfOddShapes) {
  const scene::Scene scene = stage("film").finish();
  for (const Shot shot : {Shot{1, 1, 64}, Shot{1, 65535, 1}, Shot{65535, 1, 1}, Shot{17, 3, 2}}) {
    EXPECT_TRUE(survives(scene, kOverlook, shot)) << shot.width << "x" << shot.height;
    EXPECT_GT(sum_, 0);
  }
}

TEST_P(Hostile, MaterialsAtTheirEnds) {
  scene::SceneBuilder b = stage("black");
  b.box({0, 1, 0}, {0.5, 0.5, 0.5}, 0.3, b.material("black", scene::lambert(scene::grey(0))));
  EXPECT_TRUE(survives(b.finish()));

  // Nothing is absorbed: paths end by roulette alone.
  b = scene::SceneBuilder("white");
  b.mesh("box");
  const auto white = b.material("white", scene::lambert(scene::grey(1)));
  b.box({}, {1, 1, 1}, 0, white, true);
  const auto light = b.material("light", scene::emitter(scene::grey(1)));
  b.quad({-0.5, 0.9, -0.5}, {0.5, 0.9, -0.5}, {0.5, 0.9, 0.5}, {-0.5, 0.9, 0.5}, light);
  EXPECT_TRUE(survives(b.finish(), from({0, 0, 0}, {0, 0, -1})));
  EXPECT_GT(sum_, 0);

  // 1.05e-5 is about the least that is no mirror.
  for (const double roughness : {0.0, 1e-30, 1e-10, 1e-6, 1.05e-5, 1e-3, 1.0})
    for (const double ior : {1.0, 1.0000001, 1.5, 1e6}) {
      b = stage("lobes");
      b.mesh("balls");
      b.sphere({-1, 1, 0}, 0.5, 12, b.material("coated", scene::dielectric(scene::grey(1), roughness, ior)));
      b.sphere({0, 1, 0}, 0.5, 12, b.material("metal", scene::metal(scene::grey(1), roughness)));
      b.sphere({1, 1, 0}, 0.5, 12, b.material("glass", scene::solid_glass(ior, roughness)));
      // Both kinds of lobe everywhere, so that one variant of the kernels serves all.
      b.sphere({0, 1, 1}, 0.2, 12, b.material("mirror", scene::metal(scene::grey(1), 0)));
      b.sphere({0, 1, -1}, 0.2, 12, b.material("rough glass", scene::solid_glass(1.5, 0.3)));
      EXPECT_TRUE(survives(b.finish())) << "roughness " << roughness << ", ior " << ior;
      EXPECT_GT(sum_, 0);
    }
}

TEST_P(Hostile, LightsOnSurfaces) {
  // Emitters in the floor's own plane, a point light in it, on a corner, and one on the emitter.
  scene::SceneBuilder b = stage("lights on surfaces");
  b.quad({-1, 0, 1}, {1, 0, 1}, {1, 0, -1}, {-1, 0, -1}, 1);
  for (const Vec at : {Vec{0.3, 0, 0.4}, Vec{2, 0, 2}, Vec{0, 3, 0}, Vec{0, 1e-30, 0}})
    b.point_light(at, scene::grey(3));
  b.spot_light({1, 0, 1}, {0, -1, 0}, scene::grey(3), 0, 1e-6);
  EXPECT_TRUE(survives(b.finish()));
  EXPECT_GT(sum_, 0);
}

TEST_P(Hostile, CamerasInAndOnSurfaces) {
  scene::SceneBuilder b = stage("camera");
  b.box({0, 0.5, 0}, {0.5, 0.5, 0.5}, 0, kWall);
  const scene::Scene scene = b.finish();
  const std::array<float, 3> up{0, 9, 0}, ahead{0.1f, 0.2f, -9};
  for (const std::array<float, 3> eye : {
           std::array<float, 3>{0, 0.5f, 0},  // within the box
           {0, 1, 0},                         // on its top
           {0.5f, 1, 0.5f},                   // on its corner
           {0.5f, 1, 0},                      // on its edge
           {0, 0, 1.5f},                      // on the floor
           {0, 3, 0},                         // on the light
       }) {
    EXPECT_TRUE(survives(scene, from(eye, up)));
    EXPECT_TRUE(survives(scene, from(eye, ahead)));
  }
}

TEST_P(Hostile, HugeNumbers) {
  scene::Scene scene = stage("huge").finish();
  for (const float x : {1e30f, -2e9f, kInfinity, -kInfinity, std::nanf("")}) {
    scene::Scene far = scene;
    far.positions[4] = x;
    refused(far, "positions[1]");
  }
  scene::SceneBuilder b = stage("plain of 10^9 m");
  b.quad({-1e9, -1, 1e9}, {1e9, -1, 1e9}, {1e9, -1, -1e9}, {-1e9, -1, -1e9}, kWall);
  b.quad({-1e9, 1e9, -1e9}, {1e9, 1e9, -1e9}, {1e9, 1e9, 1e9}, {-1e9, 1e9, 1e9}, 1);
  EXPECT_TRUE(survives(b.finish()));
  EXPECT_GT(sum_, 0);
  EXPECT_TRUE(survives(stage("emission of 10^30", 1e30).finish()));
  EXPECT_GT(sum_, 1e29);
}

// A metal wall that shows nothing but a lamp is as bright as the lamp, however smooth.
TEST_P(Hostile, NearMirrors) {
  for (const double roughness : {0.0, 1e-30, 1e-12, 1e-10, 1e-8, 1.05e-5, 1e-4}) {
    scene::SceneBuilder b("mirror of roughness " + std::to_string(roughness));
    b.mesh("wall and lamp");
    b.quad({-2, 0, 2}, {2, 0, 2}, {2, 0, -2}, {-2, 0, -2}, b.material("wall", scene::metal(scene::grey(1), roughness)));
    // Beneath the ceiling's lamp, behind the camera.
    b.quad({-9, 3, -9}, {9, 3, -9}, {9, 3, 9}, {-9, 3, 9}, b.material("lamp", scene::emitter(scene::grey(2))));
    constexpr Shot shot{.width = 8, .height = 8, .samples = 4, .depth = 4};
    ASSERT_TRUE(survives(b.finish(), scene::look_at({0, 1, 0.3f}, {0, 0, 0}, 0.7f).camera, shot)) << refusal_;
    EXPECT_NEAR(sum_ / (3.0 * shot.width * shot.height * shot.samples), 2, 2e-3) << "roughness " << roughness;
  }
}

// A lamp is as bright as its power says wherever it hangs: from 10^9 m the square of its density is beyond float.
TEST_P(Hostile, FarLamps) {
  for (const double distance : {1e2, 1e5, 1e9}) {
    scene::SceneBuilder b("lamp at " + std::to_string(distance));
    b.mesh("stage");
    b.quad({-2, 0, 2}, {2, 0, 2}, {2, 0, -2}, {-2, 0, -2}, b.material("wall", scene::lambert(scene::grey(0.7))));
    const double half = 0.05, y = distance, area = 4 * half * half;
    b.quad({-half, y, -half}, {half, y, -half}, {half, y, half}, {-half, y, half},
           b.material("lamp", scene::emitter(scene::grey(y * y / area))));
    constexpr Shot shot{.width = 4, .height = 4, .samples = 16};
    ASSERT_TRUE(survives(b.finish(), scene::look_at({0, 1, 0}, {0, 0, 0.01f}, 0.5f).camera, shot)) << refusal_;
    const double expected = 0.7 / M_PI;  // one unit of irradiance
    const double mean = sum_ / (3.0 * shot.width * shot.height * shot.samples);
    // At 100 m the floor's corners are 10^-4 further than its middle, to the power of four.
    EXPECT_NEAR(mean, expected, 5e-4 * expected) << "a lamp of 0.1 m from " << distance << " m";
  }
}

// What is no ray hits nothing, and its neighbours in the packet are answered all the same.
TEST_P(Hostile, RaysWithoutNumbers) {
  constexpr std::size_t kRays = 4096;
  const scene::Scene scene = stage("rays").finish();
  TracedScene traced(*device_, scene);
  const float nan = std::nanf(""), none[] = {nan, kInfinity, -kInfinity};
  Random random(15);
  std::vector<Ray> rays;
  std::vector<bool> sound;
  for (std::size_t i = 0; i < kRays; ++i) {
    Ray ray{{static_cast<float>(random.within(1.9)), 1, static_cast<float>(random.within(1.9))}, {0, -1, 0}};
    sound.push_back(!random.chance(4));
    if (!sound.back()) {
      const std::size_t axis = random.bits() % 3;
      (random.chance(2) ? ray.origin : ray.direction)[axis] = none[random.bits() % 3];
    }
    rays.push_back(ray);
  }
  for (const Packing packing : {Packing::single, Packing::packets}) {
    const auto make = [&](std::size_t i) { return rays[i]; };
    std::size_t wrong = 0;
    traced.closest(
        kRays, make, [&](std::size_t i, const Ray&, const Hit& hit) { wrong += hit.found() != sound[i]; }, packing);
    EXPECT_EQ(wrong, 0u) << "closest hits";
    traced.any(
        kRays, make, [&](std::size_t i, const Ray&, bool blocked) { wrong += blocked != sound[i]; }, packing);
    EXPECT_EQ(wrong, 0u) << "any hits";
  }
}

TEST_P(Hostile, CamerasThatMakeNoRays) {
  const scene::Scene scene = stage("camera").finish();
  const float nan = std::nanf("");
  const auto bent = [&](const std::function<void(scene::Camera&)>& bend) {
    scene::Camera camera = kOverlook;
    bend(camera);
    return camera;
  };
  refused(scene, "origin", bent([&](scene::Camera& c) { c.origin[0] = nan; }));
  refused(scene, "origin", bent([](scene::Camera& c) { c.origin[2] = 1e30f; }));
  refused(scene, "origin", bent([](scene::Camera& c) { c.origin[1] = -kInfinity; }));
  refused(scene, "forward", bent([](scene::Camera& c) { std::fill_n(c.forward, 3, 0.0f); }));
  refused(scene, "forward", bent([&](scene::Camera& c) { c.forward[0] = nan; }));
  refused(scene, "right", bent([](scene::Camera& c) { c.right[0] = 1e30f; }));
  refused(scene, "film", bent([&](scene::Camera& c) { c.half_width = nan; }));
  refused(scene, "film", bent([](scene::Camera& c) { c.half_height = 0; }));
  refused(scene, "type", bent([](scene::Camera& c) { c.type = 7; }));
  refused(scene, "film", bent([](scene::Camera& c) { c.half_width = 3e38f; }));
  // As wide as a film may be: no ray to speak of, but numbers all the same.
  const auto widest = [](scene::Camera& c) { c.half_width = c.half_height = scene::kMaxCoordinate; };
  EXPECT_TRUE(survives(scene, bent(widest)));
  EXPECT_TRUE(survives(scene, bent([&](scene::Camera& c) {
                         c.type = GLEANER_CAMERA_ORTHOGRAPHIC;
                         widest(c);
                       })));
  EXPECT_TRUE(survives(scene, bent([](scene::Camera& c) { std::fill_n(c.origin, 3, 8e9f); })));
}

INSTANTIATE_TEST_SUITE_P(Tracer, Hostile, both_tracers(), tracer_name);

}  // namespace
}  // namespace gleaner::test

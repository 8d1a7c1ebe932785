// The furnace (radiance in a closed box of albedo r and emission Le is Le / (1 - r) everywhere), and a unit sphere
// about a point light.

#include <cmath>
#include <cstdio>

#include "scene/library/builder.h"
#include "scene/library/library.h"
#include "tests/radiometry/shot.h"

namespace gleaner::test {
namespace {

constexpr double kFamily = 1e-3;  // chance of a false alarm of one test

std::shared_ptr<const Scene> made(const std::string& name, const std::map<std::string, std::string>& parameters) {
  return std::make_shared<const Scene>(scene::make_scene(name, parameters));
}

// The mean of the picture over three seeds.
bool expect_furnace(Shot shot, double expected, const std::string& what, double level) {
  Sample all;
  Picture last;
  for (const std::uint64_t seed : {11, 12, 13}) {
    shot.seed = seed;
    last = shoot(shot);
    last.add_means(all, 0, 0, last.width, last.height, 1);
  }
  const bool fine = expect_mean(all, expected, what, level, 3e-3);
  if (!fine) keep_failure(last, what);
  return fine;
}

TEST(Furnace, BoxWithoutEnd) {
  for (const char* albedo : {"0.2", "0.5", "0.8", "0.95"}) {
    Shot shot{.scene = made("furnace", {{"albedo", albedo}, {"emission", "0.5"}})};
    shot.camera = camera_of(*shot.scene, "corner");
    expect_furnace(shot, 0.5 / (1 - std::atof(albedo)), std::string("box of albedo ") + albedo, sidak(kFamily, 4));
  }
}

TEST(Furnace, BoxOfSoManyBounces) {
  for (const char* albedo : {"0.5", "0.95"})
    for (const std::uint32_t depth : {1u, 2u, 5u}) {
      Shot shot{.scene = made("furnace", {{"albedo", albedo}, {"emission", "1"}})};
      shot.camera = camera_of(*shot.scene);
      shot.depth = depth;
      const double r = std::atof(albedo);
      expect_furnace(shot, (1 - std::pow(r, depth + 1)) / (1 - r),
                     std::string("box of albedo ") + albedo + ", depth " + std::to_string(depth), sidak(kFamily, 6));
    }
}

TEST(Furnace, BoxTracedInOpenCl) {
  for (const std::uint32_t depth : {0u, 2u}) {
    Shot shot{.scene = made("furnace", {{"albedo", "0.5"}, {"emission", "0.5"}})};
    shot.camera = camera_of(*shot.scene);
    shot.width = shot.height = 16;
    shot.depth = depth;
    shot.trace = worker::TraceKind::opencl;
    expect_furnace(shot, depth == 0 ? 1 : 0.875, "OpenCL box, depth " + std::to_string(depth), sidak(kFamily, 2));
  }
}

// A closed polyhedron that glows is as exact a furnace as the sphere it stands for, be it ever so coarse.
TEST(Furnace, SphereThatGlows) {
  for (const char* segments : {"8", "48"}) {
    Shot shot{.scene = made("furnace-sphere", {{"albedo", "0.5"}, {"emission", "0.5"}, {"segments", segments}})};
    shot.camera = camera_of(*shot.scene);
    shot.width = shot.height = 20;
    expect_furnace(shot, 1, std::string("sphere of ") + segments + " segments", sidak(kFamily, 2));
  }
}

// An unlit surface shows its colour and scatters nothing: it lights the others as a black emitter of that radiance
// does, though no light sample asks for it.
TEST(Furnace, UnlitSurfacesAreBlackEmitters) {
  const auto room = [](bool unlit) {
    scene::SceneBuilder b(unlit ? "unlit" : "emitter");
    scene::Material ceiling = unlit ? scene::lambert(scene::grey(1)) : scene::emitter(scene::grey(1));
    if (unlit) ceiling.flags |= GLEANER_MATERIAL_UNLIT;
    const std::uint32_t wall = b.material("wall", scene::lambert(scene::grey(0.8)));
    b.mesh("walls");
    b.quad({-1, -1, 1}, {1, -1, 1}, {1, -1, -1}, {-1, -1, -1}, wall);
    b.quad({-1, -1, -1}, {1, -1, -1}, {1, 1, -1}, {-1, 1, -1}, wall);
    b.quad({1, -1, 1}, {-1, -1, 1}, {-1, 1, 1}, {1, 1, 1}, wall);
    b.quad({-1, -1, 1}, {-1, -1, -1}, {-1, 1, -1}, {-1, 1, 1}, wall);
    b.quad({1, -1, -1}, {1, -1, 1}, {1, 1, 1}, {1, 1, -1}, wall);
    b.mesh("ceiling");
    b.quad({-1, 1, -1}, {1, 1, -1}, {1, 1, 1}, {-1, 1, 1}, b.material("ceiling", ceiling));
    b.camera("camera", {0.1, 0.05, 0.9}, {0.1, -0.3, -1}, 60, 64, 64);
    return std::make_shared<const Scene>(b.finish());
  };
  Sample seen[2];
  for (const bool unlit : {false, true}) {
    Shot shot{.scene = room(unlit), .chunks = 16};
    shot.camera = camera_of(*shot.scene);
    const Picture picture = shoot(shot);
    EXPECT_EQ(picture.counters.shadow_rays == 0, unlit);
    seen[unlit] = picture.mean(1);
  }
  Sample difference = seen[1];
  difference.square += seen[0].square;  // of two independent sums
  difference.mean -= seen[0].mean;
  const double error = difference.standard_error(), t = std::abs(difference.mean) / error;
  std::printf("  unlit %.5f, emitter %.5f, difference %.5f +- %.5f\n", seen[1].mean, seen[0].mean, difference.mean,
              error);
  EXPECT_LT(t, student_critical(kFamily, 30));
  EXPECT_LT(error, 5e-3 * seen[0].mean) << "too noisy to prove anything";
}

using Vector = std::array<double, 3>;
double dot(const Vector& a, const Vector& b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

struct Face {
  Vector normal;  // outward
  double height;  // of the plane over the origin
};

struct Polyhedron {
  std::vector<Face> faces;
  double area = 0;

  explicit Polyhedron(const Scene& scene) {
    for (std::size_t t = 0; t < scene.triangle_count(); ++t) {
      Vector p[3], n;
      for (int c = 0; c < 3; ++c)
        for (int k = 0; k < 3; ++k) p[c][k] = scene.positions[3 * std::size_t{scene.indices[3 * t + c]} + k];
      const Vector a{p[1][0] - p[0][0], p[1][1] - p[0][1], p[1][2] - p[0][2]};
      const Vector b{p[2][0] - p[0][0], p[2][1] - p[0][1], p[2][2] - p[0][2]};
      n = {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
      const double twice = std::sqrt(dot(n, n));
      area += twice / 2;
      for (double& c : n) c /= twice;
      double height = dot(n, p[0]);
      if (height < 0) {
        for (double& c : n) c = -c;
        height = -height;
      }
      faces.push_back({n, height});
    }
  }

  // Irradiance at the point seen along a ray from within, of a light of intensity pi at the origin: the polyhedron is
  // convex, so the nearest plane ahead is the one that is hit.
  double irradiance(const Vector& origin, const Vector& direction) const {
    double nearest = 1e300;
    const Face* hit = nullptr;
    for (const Face& face : faces) {
      const double approach = dot(face.normal, direction);
      if (approach <= 0) continue;
      const double t = (face.height - dot(face.normal, origin)) / approach;
      if (t < nearest) nearest = t, hit = &face;
    }
    Vector x;
    for (int k = 0; k < 3; ++k) x[k] = origin[k] + nearest * direction[k];
    return M_PI * hit->height / std::pow(dot(x, x), 1.5);
  }

  // The mean of that over the picture.
  double mean_irradiance(const Shot& shot) const {
    const scene::Camera camera = parameters_of(shot).camera;
    constexpr int grid = 256;
    double sum = 0;
    for (int y = 0; y < grid; ++y)
      for (int x = 0; x < grid; ++x) {
        const double u = (2 * (x + 0.5) / grid - 1) * camera.half_width;
        const double v = (1 - 2 * (y + 0.5) / grid) * camera.half_height;
        Vector origin, direction;
        for (int k = 0; k < 3; ++k) {
          origin[k] = camera.origin[k];
          direction[k] = camera.forward[k] + u * camera.right[k] + v * camera.up[k];
        }
        sum += irradiance(origin, direction);
      }
    return sum / (grid * grid);
  }
};

// A light of intensity pi at the centre of a unit sphere of albedo r: irradiance pi, radiance r / (1 - r), exactly 1 at
// r = 0.5. What the tessellation takes: a facet of height h < 1 gets pi h / d^3. All power is absorbed in the end, so
// that the mean over the surface, of area A, is 4 pi / A times the sphere's; scattered light is nearly even, so that
// L = r / pi E(x) + r (4 pi / A) r / (1 - r). At one scattering only the first term is left, and it is exact.
TEST(Furnace, PointLightInSphere) {
  constexpr double r = 0.5;
  for (const char* segments : {"16", "64"}) {
    Shot shot{.scene = made("furnace-point", {{"albedo", "0.5"}, {"segments", segments}})};
    shot.camera = camera_of(*shot.scene);
    const Polyhedron polyhedron(*shot.scene);
    const double direct = r / M_PI * polyhedron.mean_irradiance(shot);
    const double enlarged = 4 * M_PI / polyhedron.area;
    std::printf("  %s segments: 4 pi / A = %.5f, direct light %.5f of the sphere's\n", segments, enlarged, direct / r);
    // The test is of the tessellation too: it must show.
    if (segments == std::string("16")) {
      EXPECT_GT(enlarged, 1.02);
    }
    shot.depth = 1;
    expect_furnace(shot, direct, std::string("point light, depth 1, ") + segments + " segments", sidak(kFamily, 4));

    shot.depth = 0;
    shot.chunks = 8;
    Sample all;
    Picture last;
    for (const std::uint64_t seed : {21, 22, 23}) {
      shot.seed = seed;
      last = shoot(shot);
      last.add_means(all, 0, 0, last.width, last.height, 1);
    }
    // Evenness holds to the square of the unevenness of the direct light: a tenth of what the tessellation takes.
    const double allowance = 0.1 * (enlarged - 1);
    const std::string what = std::string("point light, ") + segments + " segments";
    if (!expect_mean(all, direct + r * enlarged * r / (1 - r), what, sidak(kFamily, 4), 1e-3, allowance))
      keep_failure(last, what);
  }
}

}  // namespace
}  // namespace gleaner::test

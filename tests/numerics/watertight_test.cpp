// No ray leaves a closed surface through a seam. The spheres stand far from the origin, where floats are 1/64 m apart,
// so that every product of an edge test is rounded.

#include <gtest/gtest.h>

#include <cmath>
#include <random>
#include <set>

#include "scene/library/builder.h"
#include "tests/numerics/tracing.h"

namespace gleaner::test {
namespace {

constexpr std::array<float, 3> kCentre{148376, 1234, -223423};
constexpr double kRadii[] = {2, 1000};

scene::Scene sphere(double radius) {
  scene::SceneBuilder b("sphere");
  b.mesh("sphere");
  b.sphere({kCentre[0], kCentre[1], kCentre[2]}, radius, 200, b.material("wall", scene::lambert(scene::grey(0.5))));
  return b.finish();
}

class Random {
 public:
  explicit Random(std::uint64_t seed) : engine_(seed) {}
  float signed_unit() { return static_cast<float>(static_cast<std::int64_t>(engine_())) * 0x1p-63f; }
  std::array<float, 3> in_cube() { return {signed_unit(), signed_unit(), signed_unit()}; }

 private:
  std::mt19937_64 engine_;
};

// Well within the polyhedron: the corner of its cube lies at 0.87 of the radius.
std::array<float, 3> inside(double radius, const std::array<float, 3>& unit) {
  std::array<float, 3> p;
  for (int k = 0; k < 3; ++k) p[k] = kCentre[k] + static_cast<float>(radius) * 0.5f * unit[k];
  return p;
}

// In half steps of the grid of floats: sums of two corners are exact.
struct Seams {
  std::set<std::array<double, 3>> vertices, midpoints;
};

Seams seams_of(const scene::Scene& scene) {
  Seams seams;
  for (std::size_t t = 0; t < scene.triangle_count(); ++t)
    for (int e = 0; e < 3; ++e) {
      std::array<double, 3> a, middle;
      for (int k = 0; k < 3; ++k) {
        a[k] = scene.positions[3 * std::size_t{scene.indices[3 * t + e]} + k];
        middle[k] = (a[k] + scene.positions[3 * std::size_t{scene.indices[3 * t + (e + 1) % 3]} + k]) / 2;
      }
      seams.vertices.insert(a);
      if (a != middle) seams.midpoints.insert(middle);
    }
  for (const auto& vertex : seams.vertices) seams.midpoints.erase(vertex);
  return seams;
}

struct Lost {
  std::size_t count = 0;
  bool quiet = false;
  void look(const Ray& ray, bool hit, const char* query) {
    if (hit || count++ >= 5 || quiet) return;
    ADD_FAILURE() << query << " lost a ray from (" << std::hexfloat << ray.origin[0] << ", " << ray.origin[1] << ", "
                  << ray.origin[2] << ") along (" << ray.direction[0] << ", " << ray.direction[1] << ", "
                  << ray.direction[2] << ")";
  }
};

using Watertight = WithTracer;

TEST_P(Watertight, SpheresLoseNoRandomRay) {
  // The OpenCL tracer runs one ray at a time on a CPU: a tenth of the rays.
  const std::size_t each = embree() ? 5'000'000 : 500'000;
  for (const double radius : kRadii) {
    TracedScene traced(*device_, sphere(radius));
    Random random(8);
    Lost lost{};
    const auto make = [&](std::size_t) { return Ray{inside(radius, random.in_cube()), random.in_cube()}; };
    traced.closest(each, make,
                   [&](std::size_t, const Ray& ray, const Hit& hit) { lost.look(ray, hit.found(), "closest"); });
    traced.any(each / 10, make, [&](std::size_t, const Ray& ray, bool hit) { lost.look(ray, hit, "any"); });
    traced.closest(
        each / 10, make, [&](std::size_t, const Ray& ray, const Hit& hit) { lost.look(ray, hit.found(), "packets"); },
        Packing::packets);
    EXPECT_EQ(lost.count, 0u);
    std::printf("radius %g m: %zu of %zu random rays lost\n", radius, lost.count, each + 2 * (each / 10));
  }
}

class SeamRays {
 public:
  SeamRays(TracedScene& traced, double radius, std::size_t origins)
      : traced_(traced), radius_(radius), origins_(origins) {}

  // How many rays at the points are lost, each asked as closest and as any hit.
  std::size_t lost(const std::set<std::array<double, 3>>& at, bool complain) {
    const std::vector<std::array<double, 3>> points(at.begin(), at.end());
    Lost lost{.count = 0, .quiet = !complain};
    Random random(9);
    for (std::size_t o = 0; o < origins_; ++o) {
      const auto from = o == 0 ? kCentre : inside(radius_, random.in_cube());
      // Exact: both ends lie on the grid of half steps, and near each other.
      const auto make = [&](std::size_t i) {
        Ray ray{from, {}};
        for (int k = 0; k < 3; ++k) ray.direction[k] = static_cast<float>(points[i][k] - from[k]);
        return ray;
      };
      traced_.closest(points.size(), make,
                      [&](std::size_t, const Ray& ray, const Hit& hit) { lost.look(ray, hit.found(), "closest"); });
      traced_.any(points.size(), make, [&](std::size_t, const Ray& ray, bool hit) { lost.look(ray, hit, "any"); });
    }
    return lost.count;
  }
  std::size_t rays(const std::set<std::array<double, 3>>& at) const { return 2 * origins_ * at.size(); }

 private:
  TracedScene& traced_;
  double radius_;
  std::size_t origins_;
};

TEST_P(Watertight, SpheresLoseNoRayThroughAnEdgesMiddle) {
  for (const double radius : kRadii) {
    const scene::Scene scene = sphere(radius);
    TracedScene traced(*device_, scene);
    const Seams seams = seams_of(scene);
    SeamRays rays(traced, radius, embree() ? 16 : 4);
    const std::size_t lost = rays.lost(seams.midpoints, true);
    EXPECT_EQ(lost, 0u);
    std::printf("radius %g m: %zu of %zu rays at %zu edges' middles lost\n", radius, lost, rays.rays(seams.midpoints),
                seams.midpoints.size());
  }
}

// Embree's edge tests are Pluecker products d . (e x (a + b)), rounded in proportion to the corners' distance; what it
// forgives is in proportion to the three products' sum, less by edge over distance. The two triangles of an edge round
// alike, so that edges are tight. But edges that meet in a vertex do not agree where it is, and a ray aimed exactly
// there is lost where all of them say "outside": 1.15 % of such rays on the sphere of 1000 m. It is not the place: 1.3
// % are lost around the origin, and none on the sphere of 2 m only because its coordinates have so few digits here that
// the products are exact. rtcIntersect1, 4, 8 and 16 lose the same rays; instruction sets without fused multiply-add
// lose 0.2 %.
//
// Outside Embree it cannot be mended. A lost ray goes on to what lies behind, so that asking again the rays that hit
// nothing would help before the void alone, at the price of a second query for every ray that leaves an open scene;
// filters see accepted hits alone; a geometry with a test of our own (that of the OpenCL tracer: it loses none) would
// be called back for each triangle. A stated rate, not a promise of none; no random ray has ever found one.
constexpr double kEmbreeLosesAtVertices = 0.02;

TEST_P(Watertight, SpheresLoseNoRayThroughAVertex) {
  for (const double radius : kRadii) {
    const scene::Scene scene = sphere(radius);
    TracedScene traced(*device_, scene);
    const Seams seams = seams_of(scene);
    SeamRays rays(traced, radius, embree() ? 16 : 4);
    const std::size_t lost = rays.lost(seams.vertices, !embree());
    EXPECT_LE(static_cast<double>(lost),
              (embree() ? kEmbreeLosesAtVertices : 0) * static_cast<double>(rays.rays(seams.vertices)));
    std::printf("radius %g m: %zu of %zu rays at %zu vertices lost\n", radius, lost, rays.rays(seams.vertices),
                seams.vertices.size());
  }
}

INSTANTIATE_TEST_SUITE_P(Tracer, Watertight, both_tracers(), tracer_name);

}  // namespace
}  // namespace gleaner::test

// Rays that leave a surface as the path tracer sends them (surface_point() and offset_ray_origin() of kernels/rays.h)
// do not find it again, whatever its size, and miss nothing that lies close before them.

#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "scene/library/builder.h"
#include "tests/kernels/kernel_bench.h"
#include "tests/numerics/tracing.h"

namespace gleaner::test {
namespace {

constexpr const char* kSpawn = R"(
#include "kernels/rays.h"
kernel void spawn(global const float* corners, global const float* weights, global const float* directions, uint count,
                  global float* origins) {
  uint block = (uint)get_global_id(0);
  v3 p[3], w, d, error;
  for (uint k = 0; k < 3; ++k)
    p[k] = make3(load_f(corners + (3 * k) * count, block), load_f(corners + (3 * k + 1) * count, block),
                 load_f(corners + (3 * k + 2) * count, block));
  d = make3(load_f(directions, block), load_f(directions + count, block), load_f(directions + 2 * count, block));
  v3 e1 = sub3(p[1], p[0]), e2 = sub3(p[2], p[0]);
  v3 at = surface_point(p[0], e1, e2, load_f(weights, block), load_f(weights + count, block), &error);
  v3 o = offset_ray_origin(at, error, normalize3(cross3(e1, e2)), d);
  store_f(origins, block, o.x);
  store_f(origins + count, block, o.y);
  store_f(origins + 2 * count, block, o.z);
}
)";

using Vector = std::array<float, 3>;
struct Departure {
  std::array<Vector, 3> corners;
  float b1, b2;
  Vector direction;
};

// The origins, as the device computes them.
std::vector<Vector> spawn(KernelBench& bench, const std::vector<Departure>& departures) {
  const std::size_t count = (departures.size() + 15) / 16 * 16;
  std::vector<float> corners(9 * count), weights(2 * count), directions(3 * count);
  for (std::size_t i = 0; i < departures.size(); ++i) {
    const Departure& d = departures[i];
    for (std::size_t k = 0; k < 3; ++k) {
      for (std::size_t c = 0; c < 3; ++c) corners[(3 * k + c) * count + i] = d.corners[k][c];
      directions[k * count + i] = d.direction[k];
    }
    weights[i] = d.b1;
    weights[count + i] = d.b2;
  }
  cl::Kernel kernel(bench.build(kSpawn), "spawn");
  // Kernels do not keep their arguments alive.
  const cl::Buffer in[] = {bench.buffer(corners), bench.buffer(weights), bench.buffer(directions)};
  const cl::Buffer out = bench.space(3 * count);
  set_arguments(kernel, 0, in[0], in[1], in[2], static_cast<cl_uint>(count), out);
  bench.run(kernel, count);
  const std::vector<float> origins = bench.read<float>(out, 3 * count);
  std::vector<Vector> result(departures.size());
  for (std::size_t i = 0; i < result.size(); ++i) result[i] = {origins[i], origins[count + i], origins[2 * count + i]};
  return result;
}

class Random {
 public:
  explicit Random(std::uint64_t seed) : engine_(seed) {}
  float unit() { return static_cast<float>(engine_() >> 40) * 0x1p-24f; }
  float coordinate() { return std::pow(10.0f, 16 * unit() - 8) * (engine_() & 1 ? 1 : -1); }
  Vector direction() {
    const double z = 2 * unit() - 1, phi = 2 * scene::pi * unit(), r = std::sqrt(1 - z * z);
    return {static_cast<float>(r * std::cos(phi)), static_cast<float>(r * std::sin(phi)), static_cast<float>(z)};
  }
  void weights(float& b1, float& b2) {
    b1 = unit();
    b2 = unit();
    if (b1 + b2 > 1) b1 = 1 - b1, b2 = 1 - b2;
  }

 private:
  std::mt19937_64 engine_;
};

scene::Scene lone_triangle(const std::array<Vector, 3>& corners) {
  scene::SceneBuilder b("triangle");
  b.mesh("triangle");
  const auto wall = b.material("wall", scene::lambert(scene::grey(0.5)));
  std::uint32_t index[3];
  for (int k = 0; k < 3; ++k) index[k] = b.vertex({corners[k][0], corners[k][1], corners[k][2]});
  b.triangle(index[0], index[1], index[2], wall);
  return b.finish();
}

using SelfHits = WithTracer;

TEST_P(SelfHits, NoneOfSpawnedRaysOnAnyScale) {
  constexpr std::size_t kTriangles = 200, kRays = 1000;
  Random random(10);
  std::vector<Departure> all;
  for (std::size_t t = 0; t < kTriangles; ++t) {
    Departure d;
    for (auto& corner : d.corners)
      for (float& x : corner) x = random.coordinate();
    for (std::size_t i = 0; i < kRays; ++i) {
      random.weights(d.b1, d.b2);
      d.direction = random.direction();
      all.push_back(d);
    }
  }
  KernelBench bench(device_->lanes());
  const std::vector<Vector> origins = spawn(bench, all);
  std::size_t closest = 0, any = 0, with_source = 0;
  for (std::size_t t = 0; t < kTriangles; ++t) {
    TracedScene traced(*device_, lone_triangle(all[t * kRays].corners));
    const auto make = [&](std::size_t i) { return Ray{origins[t * kRays + i], all[t * kRays + i].direction}; };
    // Without the source's number, which would hide what the offset fails to do.
    traced.closest(kRays, make, [&](std::size_t, const Ray&, const Hit& hit) { closest += hit.found(); });
    traced.any(kRays, make, [&](std::size_t, const Ray&, bool hit) { any += hit; });
    traced.closest(
        kRays,
        [&](std::size_t i) {
          Ray ray = make(i);
          ray.source = 0;
          return ray;
        },
        [&](std::size_t, const Ray&, const Hit& hit) { with_source += hit.found(); });
  }
  std::printf("%zu rays of %zu triangles: %zu closest and %zu any-hit queries found their own, %zu told of it\n",
              all.size(), kTriangles, closest, any, with_source);
  EXPECT_EQ(closest, 0u);
  EXPECT_EQ(any, 0u);
  EXPECT_EQ(with_source, 0u);
}

// The any-hit query once met floors at y = 0, where the bound of the rounding error is 0 across the plane.
TEST_P(SelfHits, NoneInCoordinatePlanes) {
  constexpr std::size_t kRays = 10000;
  Random random(11);
  KernelBench bench(device_->lanes());
  for (int axis = 0; axis < 3; ++axis)
    for (const float at : {0.0f, 1e-30f, -3.0f, 1e5f}) {
      std::vector<Departure> all(kRays);
      Departure d;
      for (int k = 0; k < 3; ++k) {
        d.corners[k][axis] = at;
        d.corners[k][(axis + 1) % 3] = k == 1 ? 7.0f : -3.0f;
        d.corners[k][(axis + 2) % 3] = k == 2 ? 11.0f : -5.0f;
      }
      for (auto& one : all) {
        one = d;
        random.weights(one.b1, one.b2);
        one.direction = random.direction();
      }
      const std::vector<Vector> origins = spawn(bench, all);
      TracedScene traced(*device_, lone_triangle(d.corners));
      const auto make = [&](std::size_t i) { return Ray{origins[i], all[i].direction}; };
      std::size_t found = 0;
      traced.closest(kRays, make, [&](std::size_t, const Ray&, const Hit& hit) { found += hit.found(); });
      traced.any(kRays, make, [&](std::size_t, const Ray&, bool hit) { found += hit; });
      EXPECT_EQ(found, 0u) << "plane " << axis << " at " << at;
    }
}

// A ray that passes through the first shell starts anew on it and must not start behind the second.
TEST_P(SelfHits, TwoCloseShellsAreBothHit) {
  constexpr double kGap = 4e-5;
  constexpr std::size_t kRays = 100000;
  scene::SceneBuilder b("shells");
  const auto wall = b.material("wall", scene::lambert(scene::grey(0.5)));
  b.mesh("outer");
  b.sphere({}, 1, 200, wall);
  b.mesh("inner");
  b.sphere({}, 1 - kGap, 200, wall);
  const scene::Scene scene = b.finish();
  const std::uint32_t outer = scene.meshes[0].triangle_count;
  TracedScene traced(*device_, scene);
  Random random(12);
  std::vector<Departure> through;
  std::vector<std::uint32_t> left;
  std::size_t first_missed = 0;
  traced.closest(
      kRays,
      [&](std::size_t) {
        const Vector from = random.direction(), to = random.direction();
        Ray ray;
        for (int k = 0; k < 3; ++k) {
          ray.origin[k] = 3 * from[k];
          ray.direction[k] = 0.5f * to[k] - 3 * from[k];
        }
        return ray;
      },
      [&](std::size_t, const Ray& ray, const Hit& hit) {
        if (hit.primitive >= outer) {
          ++first_missed;
          return;
        }
        Departure d;
        for (int k = 0; k < 3; ++k) {
          const float* corner = &scene.positions[3 * std::size_t{scene.indices[3 * std::size_t{hit.primitive} + k]}];
          d.corners[k] = {corner[0], corner[1], corner[2]};
        }
        d.b1 = hit.u;
        d.b2 = hit.v;
        d.direction = ray.direction;
        through.push_back(d);
        left.push_back(hit.primitive);
      });
  EXPECT_EQ(first_missed, 0u);
  KernelBench bench(device_->lanes());
  const std::vector<Vector> origins = spawn(bench, through);
  std::size_t second_missed = 0;
  traced.closest(
      through.size(),
      [&](std::size_t i) {
        return Ray{origins[i], through[i].direction, kInfinity, left[i]};
      },
      [&](std::size_t, const Ray&, const Hit& hit) {
        // The next surface is the inner shell, not the far side of the outer one.
        second_missed += !(hit.found() && hit.primitive >= outer && hit.t < 0.01f);
      });
  std::printf("%zu rays: %zu missed the first shell, %zu the second\n", kRays, first_missed, second_missed);
  EXPECT_EQ(second_missed, 0u);
}

INSTANTIATE_TEST_SUITE_P(Tracer, SelfHits, both_tracers(), tracer_name);

}  // namespace
}  // namespace gleaner::test

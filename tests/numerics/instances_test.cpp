// A mesh in several places is what as many copies of it would be: for ray queries, for what kernels make of a hit, and
// for pictures.

#include <gtest/gtest.h>

#include <cmath>
#include <random>
#include <set>

#include "scene/library/bake.h"
#include "scene/library/builder.h"
#include "scene/library/library.h"
#include "scene/model/error.h"
#include "tests/kernels/kernel_bench.h"
#include "tests/numerics/rendering.h"

namespace gleaner::test {
namespace {

using scene::Vec;
using Vector = std::array<float, 3>;

class Random {
 public:
  explicit Random(std::uint64_t seed) : engine_(seed) {}
  float unit() { return static_cast<float>(engine_() >> 40) * 0x1p-24f; }
  std::uint32_t below(std::uint32_t count) { return static_cast<std::uint32_t>(engine_() % count); }
  Vec direction() {
    const double z = 2.0 * unit() - 1, phi = 2 * scene::pi * unit(), r = std::sqrt(1 - z * z);
    return {r * std::cos(phi), r * std::sin(phi), z};
  }
  void weights(float& b1, float& b2) {
    b1 = unit();
    b2 = unit();
    if (b1 + b2 > 1) b1 = 1 - b1, b2 = 1 - b2;
  }
  // Axes that are turned at random, of lengths 10^U(-spread, spread), and a place of about that size.
  std::array<Vec, 4> axes(double spread, bool mirrored) {
    const Vec x = direction(), y = scene::normalize(scene::cross(direction(), x)), z = scene::cross(x, y);
    const auto length = [&] { return std::pow(10.0, spread * (2.0 * unit() - 1)); };
    return {length() * x, length() * y, (mirrored ? -1 : 1) * length() * z, length() * 10 * direction()};
  }

 private:
  std::mt19937_64 engine_;
};

Vector rounded(Vec v) { return {static_cast<float>(v.x), static_cast<float>(v.y), static_cast<float>(v.z)}; }

// Triangle of the baked scene -> where it comes from.
struct Origin {
  std::uint32_t primitive, instance;
};
std::vector<Origin> origins_of(const scene::Scene& scene) {
  std::vector<Origin> origins;
  const auto add = [&](const scene::Mesh& mesh, std::uint32_t instance) {
    for (std::uint32_t t = 0; t < mesh.triangle_count; ++t) origins.push_back({mesh.first_triangle + t, instance});
  };
  for (const scene::Mesh& mesh : scene.meshes)
    if (!mesh.instanced) add(mesh, GLEANER_NONE);
  for (std::uint32_t i = 0; i < scene.instances.size(); ++i) add(scene.meshes[scene.instances[i].mesh], i);
  return origins;
}

// A small stack that has everything a hit may carry: textures, normal maps, grain, smooth normals.
scene::Scene small_stack(std::uint32_t count, double spread, std::uint64_t seed, Vec place = {}) {
  scene::SceneBuilder b("small stack");
  Random random(seed);
  const auto texture = b.texture(4, 4, false, [](std::uint32_t x, std::uint32_t y) {
    return scene::Texel{static_cast<std::uint8_t>(90 + 20 * x), static_cast<std::uint8_t>(150 - 15 * y), 230, 255};
  });
  scene::Material grained = scene::metal({0.8, 0.6, 0.5}, 0.4);
  grained.anisotropy = 0.7f;
  grained.normal_texture = texture;
  const auto wall = b.material("wall", scene::lambert(scene::grey(0.6))), ring = b.material("ring", grained);
  b.mesh("floor");
  b.quad(place + Vec{-30, -12, 30}, place + Vec{30, -12, 30}, place + Vec{30, -12, -30}, place + Vec{-30, -12, -30},
         wall);
  b.instanced_mesh("torus");
  b.torus({0.3, 0.2, -0.1}, 1, 0.4, 24, ring);
  for (std::uint32_t i = 0; i < count; ++i) {
    const auto [x, y, z, at] = random.axes(spread, i % 2 == 1);
    b.instance(x, y, z, place + at);
  }
  b.mesh("ceiling");
  b.quad(place + Vec{-30, 12, -30}, place + Vec{30, 12, -30}, place + Vec{30, 12, 30}, place + Vec{-30, 12, 30}, wall);
  b.camera("camera", place + Vec{0, 0, 25}, place, 40, 64, 64);
  return b.finish();
}

using Instances = WithTracer;

// Rays between random points about the stack.
Ray across(Random& random, Vec place) {
  const Vec from = place + 11 * random.unit() * random.direction();
  const Vec to = place + 11 * random.unit() * random.direction();
  return {rounded(from), rounded(to - from)};
}

TEST_P(Instances, AreHitWhereCopiesWouldBe) {
  struct Case {
    const char* name;
    double spread;
    Vec place;
    double most_differ, tolerance;  // share of rays; of t, in metres per metre
  };
  // Far from the origin, where floats are 1/128 m apart, corners of copies lie somewhere else by as much.
  const Case cases[] = {{"near", 0.5, {}, 1e-3, 1e-5}, {"far", 0.5, {100000, 3000, -120000}, 0.05, 0.1}};
  for (const Case& c : cases) {
    const scene::Scene scene = small_stack(60, c.spread, 3, c.place), copies = scene::baked(scene);
    TracedScene instanced(*device_, scene), plain(*device_, copies);
    const std::vector<Origin> origins = origins_of(scene);
    const std::size_t count = embree() ? 400'000 : 60'000;
    for (const Packing packing : {Packing::single, Packing::packets}) {
      std::vector<Hit> expected(count);
      Random first(5), second(5), third(5);
      plain.closest(
          count, [&](std::size_t) { return across(first, c.place); },
          [&](std::size_t i, const Ray&, const Hit& hit) { expected[i] = hit; }, packing);
      std::size_t differ = 0, mirrored = 0, of_instances = 0, blocked_differ = 0;
      double worst = 0;
      instanced.closest(
          count, [&](std::size_t) { return across(second, c.place); },
          [&](std::size_t i, const Ray& ray, const Hit& hit) {
            const Hit& copy = expected[i];
            if (hit.found() != copy.found()) {
              ++differ;
              return;
            }
            if (!hit.found()) return;
            const Origin& origin = origins[copy.primitive];
            if (hit.primitive != origin.primitive || hit.instance != origin.instance) {
              ++differ;
              return;
            }
            of_instances += hit.instance != GLEANER_NONE;
            mirrored += hit.instance != GLEANER_NONE && hit.instance % 2 == 1;
            double length = 0;
            for (const float d : ray.direction) length += double{d} * d;
            worst = std::max(worst, std::abs(double{hit.t} - copy.t) * std::sqrt(length) / 11);
          },
          packing);
      instanced.any(
          count, [&](std::size_t) { return across(third, c.place); },
          [&](std::size_t i, const Ray&, bool hit) { blocked_differ += hit != expected[i].found(); }, packing);
      std::printf("%s: %zu of %zu rays on instances, %zu mirrored; %zu closest and %zu any differ, t by %.2g\n", c.name,
                  of_instances, count, mirrored, differ, blocked_differ, worst);
      EXPECT_GT(of_instances, count / 10);
      EXPECT_GT(mirrored, count / 30);
      EXPECT_LE(static_cast<double>(differ), c.most_differ * static_cast<double>(count));
      EXPECT_LE(static_cast<double>(blocked_differ), c.most_differ * static_cast<double>(count));
      if (c.place.x == 0) {
        EXPECT_LE(worst, 1e-3);
      }
    }
  }
}

// Two shells that are one mesh: what a ray leaves is a triangle of one instance.
TEST_P(Instances, RaysLeaveTheirOwnInstanceAlone) {
  scene::SceneBuilder b("shells");
  const auto wall = b.material("wall", scene::lambert(scene::grey(0.5)));
  b.instanced_mesh("shell");
  b.quad({-1, -1, 0}, {1, -1, 0}, {1, 1, 0}, {-1, 1, 0}, wall);
  for (const double z : {0.0, 1.0, 2.0}) b.instance({1, 0, 0}, {0, 1, 0}, {0, 0, 1}, {0, 0, z});
  b.mesh("back");
  b.quad({-1, -1, 3}, {1, -1, 3}, {1, 1, 3}, {-1, 1, 3}, wall);
  TracedScene traced(*device_, b.finish());
  struct Case {
    float z;
    std::uint32_t source, instance, hit_instance;
    float t;
  };
  const Case cases[] = {
      {-0.5f, GLEANER_NONE, 0, 0, 0.5f}, {-0.5f, 0, 0, 1, 1.5f}, {-0.5f, 0, 1, 0, 0.5f}, {0.5f, 0, 0, 1, 0.5f},
      {1.5f, 0, 2, GLEANER_NONE, 1.5f},  {0.5f, 0, 1, 2, 1.5f}};
  traced.closest(
      std::size(cases),
      [&](std::size_t i) {
        return Ray{{0.5f, -0.25f, cases[i].z}, {0, 0, 1}, kInfinity, cases[i].source, cases[i].instance};
      },
      [&](std::size_t i, const Ray&, const Hit& hit) {
        EXPECT_EQ(hit.instance, cases[i].hit_instance) << "case " << i;
        EXPECT_NEAR(hit.t, cases[i].t, 1e-6f) << "case " << i;
      });
}

constexpr const char* kMeet = R"(
#include "kernels/surface.h"
kernel void meet(SCENE_PARAMETERS, global const uint* primitives, global const uint* instances_hit,
                 global const float* weights, global const float* directions, uint count, global float* out) {
  uint block = (uint)get_global_id(0);
  Scene scene_value = SCENE_FROM_PARAMETERS;
  Hit h = load_hit(&scene_value, load_u(primitives, block), load_u(instances_hit, block), load_f(weights, block),
                   load_f(weights + count, block), all_lanes());
  v3 d = make3(load_f(directions, block), load_f(directions + count, block), load_f(directions + 2 * count, block));
  v3 told[8] = {h.p, h.error, h.geometric, h.normal, h.outward, d, d,
                offset_ray_origin(h.p, h.error, h.geometric, d)};
#ifdef NEED_ANISOTROPY
  told[5] = h.tangent;
  told[6] = h.bitangent;
#endif
  for (uint k = 0; k < 8; ++k) {
    store_f(out + (3 * k) * count, block, told[k].x);
    store_f(out + (3 * k + 1) * count, block, told[k].y);
    store_f(out + (3 * k + 2) * count, block, told[k].z);
  }
}
)";
enum Told { kPoint, kError, kGeometric, kNormal, kOutward, kTangent, kBitangent, kLeaves, kTold };

struct Meeting {
  std::uint32_t primitive, instance;
  float b1, b2;
  Vector direction;
};

// What load_hit() makes of hits on a scene: [vector][hit].
std::array<std::vector<Vec>, kTold> met(KernelBench& bench, const scene::Scene& scene,
                                        const std::vector<Meeting>& meetings) {
  worker::DeviceScene held = bench.hold(std::make_shared<scene::Scene>(scene));
  cl::Program program = bench.build(kMeet, held.kernel_options());
  cl::Kernel kernel(program, "meet");
  const std::size_t count = (meetings.size() + 15) / 16 * 16;
  std::vector<std::uint32_t> primitives(count), instances(count, GLEANER_NONE);
  std::vector<float> weights(2 * count), directions(3 * count);
  for (std::size_t i = 0; i < meetings.size(); ++i) {
    primitives[i] = meetings[i].primitive;
    instances[i] = meetings[i].instance;
    weights[i] = meetings[i].b1;
    weights[count + i] = meetings[i].b2;
    for (std::size_t k = 0; k < 3; ++k) directions[k * count + i] = meetings[i].direction[k];
  }
  const cl::Buffer in[] = {bench.buffer(primitives), bench.buffer(instances), bench.buffer(weights),
                           bench.buffer(directions)};
  const cl::Buffer out = bench.space(3 * kTold * count);
  set_arguments(kernel, held.set_arguments(kernel, 0), in[0], in[1], in[2], in[3], static_cast<cl_uint>(count), out);
  bench.run(kernel, count);
  const std::vector<float> told = bench.read<float>(out, 3 * kTold * count);
  std::array<std::vector<Vec>, kTold> result;
  for (std::size_t k = 0; k < kTold; ++k)
    for (std::size_t i = 0; i < meetings.size(); ++i)
      result[k].push_back({told[3 * k * count + i], told[(3 * k + 1) * count + i], told[(3 * k + 2) * count + i]});
  return result;
}

double length(Vec v) { return std::sqrt(dot(v, v)); }

// A corner as the instance's transform places it, exactly.
Vec corner_of(const scene::Scene& scene, const Meeting& m, int k) {
  const float* p = &scene.positions[3 * std::size_t{scene.indices[3 * std::size_t{m.primitive} + k]}];
  if (m.instance == GLEANER_NONE) return {p[0], p[1], p[2]};
  const gl_float* t = scene.instances[m.instance].transform;
  const auto row = [&](int r) {
    return double{t[4 * r]} * p[0] + double{t[4 * r + 1]} * p[1] + double{t[4 * r + 2]} * p[2] + t[4 * r + 3];
  };
  return {row(0), row(1), row(2)};
}

std::vector<Meeting> meetings_on(const scene::Scene& scene, std::size_t count, Random& random) {
  std::vector<Meeting> meetings;
  const std::vector<Origin> all = origins_of(scene);
  for (std::size_t i = 0; i < count; ++i) {
    const Origin& o = all[random.below(static_cast<std::uint32_t>(all.size()))];
    Meeting m{o.primitive, o.instance, 0, 0, rounded(random.direction())};
    random.weights(m.b1, m.b2);
    meetings.push_back(m);
  }
  return meetings;
}

// Hits on an instanced scene, and the same ones on its copies.
struct SameHits {
  scene::Scene scene, copies;
  std::vector<Meeting> meetings, of_copies;
};
SameHits same_hits(double spread, std::size_t count) {
  SameHits same{small_stack(40, spread, 7), {}, {}, {}};
  same.copies = scene::baked(same.scene);
  const std::vector<Origin> origins = origins_of(same.scene);
  Random random(11);
  for (std::size_t i = 0; i < count; ++i) {
    const std::uint32_t t = random.below(static_cast<std::uint32_t>(origins.size()));
    Meeting m{origins[t].primitive, origins[t].instance, 0, 0, rounded(random.direction())};
    random.weights(m.b1, m.b2);
    same.meetings.push_back(m);
    const bool mirrored = m.instance != GLEANER_NONE && m.instance % 2 == 1;
    same.of_copies.push_back({t, GLEANER_NONE, mirrored ? m.b2 : m.b1, mirrored ? m.b1 : m.b2, m.direction});
  }
  return same;
}

TEST(InstancedHits, HaveTheFramesThatCopiesHave) {
  const SameHits same = same_hits(0.5, 20000);
  KernelBench bench(16);
  const auto a = met(bench, same.scene, same.meetings), b = met(bench, same.copies, same.of_copies);
  const char* names[] = {"point", "error", "geometric", "normal", "outward", "tangent", "bitangent", "origin"};
  for (const Told k : {kPoint, kGeometric, kNormal, kOutward, kTangent, kBitangent}) {
    double worst = 0;
    for (std::size_t i = 0; i < same.meetings.size(); ++i) worst = std::max(worst, length(a[k][i] - b[k][i]));
    std::printf("%s: at most %.2g apart\n", names[k], worst);
    EXPECT_LT(worst, 2e-4) << names[k];
  }
}

// The bound holds for the place itself. It is wider than a copy's, of whose place p little more than the last bit is
// rounded: a query multiplies by the transform's inverse W, so that about 12 |M| |W| |t| units are added, of a matrix M
// and a translation t. |M| |W| is at most 3 where M turns, and grows with the stretch.
TEST(InstancedHits, BoundsHoldAndAreNotMuchWiderThanCopies) {
  struct Case {
    double spread, most;  // axes of lengths 10^U(-spread, spread); measured: 38.8 and 50.2
  };
  for (const Case& c : {Case{0, 44}, Case{0.5, 57}}) {
    const SameHits same = same_hits(c.spread, 20000);
    KernelBench bench(16);
    const auto a = met(bench, same.scene, same.meetings), b = met(bench, same.copies, same.of_copies);
    double widest = 0;
    for (std::size_t i = 0; i < same.meetings.size(); ++i) {
      const Meeting& m = same.meetings[i];
      const Vec p0 = corner_of(same.scene, m, 0), p1 = corner_of(same.scene, m, 1), p2 = corner_of(same.scene, m, 2);
      const Vec exact = p0 + m.b1 * (p1 - p0) + m.b2 * (p2 - p0), off = a[kPoint][i] - exact;
      ASSERT_LE(std::abs(off.x), a[kError][i].x);
      ASSERT_LE(std::abs(off.y), a[kError][i].y);
      ASSERT_LE(std::abs(off.z), a[kError][i].z);
      widest = std::max(widest, length(a[kError][i]) / length(b[kError][i]));
    }
    std::printf("spread %g: bounds at most %.1f times those of copies\n", c.spread, widest);
    EXPECT_LT(widest, c.most);
  }
}

// Of every instance alone, turned, stretched and moved.
TEST_P(Instances, SpawnedRaysDoNotFindTheirTriangleAgain) {
  KernelBench bench(device_->lanes());
  std::size_t closest = 0, any = 0, rays = 0;
  for (std::uint64_t seed = 0; seed < 60; ++seed) {
    Random random(100 + seed);
    scene::SceneBuilder b("triangle");
    const auto wall = b.material("wall", scene::lambert(scene::grey(0.5)));
    b.instanced_mesh("triangle");
    const double size = std::pow(10.0, 4.0 * random.unit() - 2);
    std::uint32_t index[3];
    for (auto& i : index) i = b.vertex(size * (random.direction() + 3 * random.direction()));
    b.triangle(index[0], index[1], index[2], wall);
    auto [x, y, z, at] = random.axes(1.2, seed % 2 == 1);
    b.instance(x, y, z, std::pow(10.0, 5.0 * random.unit()) * at);
    const scene::Scene scene = b.finish();
    const std::vector<Meeting> meetings = meetings_on(scene, 2000, random);
    const std::vector<Vec> origins = met(bench, scene, meetings)[kLeaves];
    TracedScene traced(*device_, scene);
    // Without the source's number, which would hide what the offset fails to do.
    const auto make = [&](std::size_t i) { return Ray{rounded(origins[i]), meetings[i].direction}; };
    traced.closest(meetings.size(), make, [&](std::size_t, const Ray&, const Hit& hit) { closest += hit.found(); });
    traced.any(meetings.size(), make, [&](std::size_t, const Ray&, bool hit) { any += hit; });
    rays += meetings.size();
  }
  std::printf("%zu rays: %zu closest and %zu any found what they left\n", rays, closest, any);
  EXPECT_EQ(closest, 0u);
  EXPECT_EQ(any, 0u);
}

TEST_P(Instances, SpheresLoseNoRayFarFromTheOrigin) {
  scene::SceneBuilder b("sphere");
  const Vec centre{148376, 1234, -223423};
  b.instanced_mesh("sphere");
  b.sphere({}, 1, 200, b.material("wall", scene::lambert(scene::grey(0.5))));
  Random random(17);
  const auto [x, y, z, unused] = random.axes(0, true);
  b.instance(2 * x, 3 * y, 4 * z, centre);
  TracedScene traced(*device_, b.finish());
  std::size_t lost = 0;
  const std::size_t count = embree() ? 1'000'000 : 100'000;
  traced.closest(
      count,
      [&](std::size_t) {
        return Ray{rounded(centre + 0.5 * random.direction()), rounded(random.direction())};
      },
      [&](std::size_t, const Ray&, const Hit& hit) { lost += !hit.found(); });
  std::printf("%zu of %zu rays lost\n", lost, count);
  EXPECT_EQ(lost, 0u);
}

TEST(InstancedHits, AreTheSameForBothTracers) {
  const auto embree = open_device(worker::TraceKind::embree), opencl = open_device(worker::TraceKind::opencl);
  if (!embree || !opencl) GTEST_SKIP() << "NOT TESTED: no OpenCL device here traces with each";
  const scene::Scene scene = small_stack(60, 0.5, 3);
  TracedScene one(*embree, scene), other(*opencl, scene);
  constexpr std::size_t count = 60'000;
  std::vector<Hit> hits(count);
  Random first(23), second(23);
  one.closest(
      count, [&](std::size_t) { return across(first, {}); },
      [&](std::size_t i, const Ray&, const Hit& hit) { hits[i] = hit; });
  std::size_t differ = 0;
  double worst = 0;
  other.closest(
      count, [&](std::size_t) { return across(second, {}); },
      [&](std::size_t i, const Ray& ray, const Hit& hit) {
        if (hit.primitive != hits[i].primitive || (hit.found() && hit.instance != hits[i].instance))
          ++differ;
        else if (hit.found())
          worst = std::max(worst, std::abs(double{hit.t} - hits[i].t) *
                                      length({ray.direction[0], ray.direction[1], ray.direction[2]}));
      });
  std::printf("%zu of %zu rays differ, places by %.2g m\n", differ, count, worst);
  EXPECT_LE(differ, count / 2000);
  EXPECT_LE(worst, 1e-3);
}

// --- Motion ---

// A sheet that deforms, a ring in two places, and a floor.
scene::Scene moving_scene() {
  scene::SceneBuilder b("moving");
  const auto wall = b.material("wall", scene::lambert(scene::grey(0.5)));
  b.mesh("floor");
  b.quad({-8, -3, 8}, {8, -3, 8}, {8, -3, -8}, {-8, -3, -8}, wall);
  b.instanced_mesh("ring");
  b.torus({}, 1, 0.4, 24, wall);
  b.instance({1, 0, 0}, {0, 1, 0}, {0, 0, 1}, {3, 0, 0});
  b.instance({1, 0, 0}, {0, 2, 0}, {0, 0, -1}, {-3, 1, 0});
  b.mesh("sheet");
  b.grid(60, 60,
         [](std::uint32_t i, std::uint32_t j) {
           return Vec{0.1 * i - 3, 2, 0.1 * j - 3};
         },
         wall, {.smooth = false});
  scene::Scene scene = b.finish();
  scene.meshes[2].deforming = true;
  return scene;
}

// The sheet's vertices at `time`: waves; or, `torn`, scattered so that no box of a refitted tree is of any use.
scene::Scene moved(const scene::Scene& scene, float time, bool torn) {
  scene::Scene shown = scene;
  Random random(31);
  const scene::Mesh& sheet = scene.meshes[2];
  std::set<std::uint32_t> vertices(scene.indices.begin() + 3 * sheet.first_triangle,
                                   scene.indices.begin() + 3 * (sheet.first_triangle + sheet.triangle_count));
  for (const std::uint32_t v : vertices) {
    float* p = &shown.positions[3 * v];
    p[1] += 0.3f * std::sin(2 * p[0] + time) * std::cos(p[2]);
    if (!torn) continue;
    const Vec away = 6 * random.unit() * random.direction();
    p[0] += static_cast<float>(away.x), p[2] += static_cast<float>(away.z);
  }
  shown.instances[0].transform[3] += time;
  shown.instances[1].transform[7] -= 0.3f * time;
  return shown;
}

std::vector<Hit> hits_of(TracedScene& traced, std::size_t count) {
  std::vector<Hit> hits(count);
  Random random(37);
  traced.closest(
      count, [&](std::size_t) { return across(random, {}); },
      [&](std::size_t i, const Ray&, const Hit& hit) { hits[i] = hit; });
  return hits;
}

std::size_t differing(const std::vector<Hit>& a, const std::vector<Hit>& b) {
  std::size_t count = 0;
  for (std::size_t i = 0; i < a.size(); ++i)
    count +=
        a[i].primitive != b[i].primitive ||
        (a[i].found() && (a[i].instance != b[i].instance || a[i].t != b[i].t || a[i].u != b[i].u || a[i].v != b[i].v));
  return count;
}

TEST_P(Instances, MotionIsFollowed) {
  const scene::Scene scene = moving_scene();
  TracedScene traced(*device_, scene);
  const std::vector<std::uint32_t> sheet{2};
  constexpr std::size_t count = 40'000;
  const std::vector<Hit> at_rest = hits_of(traced, count);
  for (const bool torn : {false, true}) {
    const scene::Scene shown = moved(scene, 1.5f, torn);
    const worker::MotionReport report = traced.on_device().show(std::make_shared<const scene::Scene>(shown), sheet);
    ASSERT_EQ(report.meshes.size(), 1u);
    EXPECT_EQ(report.meshes[0].mesh, 2u);
    EXPECT_EQ(report.meshes[0].rebuilt, torn) << report.meshes[0].growth;
    EXPECT_EQ(report.meshes[0].rebuilt, report.meshes[0].growth > worker::kMostSahGrowth);
    TracedScene fresh(*device_, shown);
    const std::vector<Hit> followed = hits_of(traced, count), expected = hits_of(fresh, count);
    // Embree may settle a tie at an edge otherwise in another tree.
    const std::size_t differ = differing(followed, expected);
    std::printf("growth %.2f, %s: %zu of %zu rays differ from a scene of its own, %zu from rest\n",
                report.meshes[0].growth, torn ? "rebuilt" : "refitted", differ, count, differing(followed, at_rest));
    EXPECT_LE(differ, embree() ? 2u : 0u);
    EXPECT_GT(differing(followed, at_rest), count / 100);
  }
  // What was shown before leaves no trace.
  traced.on_device().show(std::make_shared<const scene::Scene>(scene), sheet);
  EXPECT_EQ(differing(hits_of(traced, count), at_rest), 0u);
}

TEST_P(Instances, MotionOfAnotherSceneIsRefused) {
  const scene::Scene scene = moving_scene();
  TracedScene traced(*device_, scene);
  const std::vector<std::uint32_t> floor{0}, beyond{9}, none;
  EXPECT_THROW(traced.on_device().show(std::make_shared<const scene::Scene>(scene), floor), Error);
  EXPECT_THROW(traced.on_device().show(std::make_shared<const scene::Scene>(scene), beyond), Error);
  scene::Scene other = scene;
  other.instances.pop_back();
  EXPECT_THROW(traced.on_device().show(std::make_shared<const scene::Scene>(other), none), Error);
  other = scene;
  other.positions.resize(3);
  EXPECT_THROW(traced.on_device().show(std::make_shared<const scene::Scene>(other), none), Error);
}

using InstancedPictures = WithRenderer;

TEST_P(InstancedPictures, AreThoseOfCopies) {
  const scene::Scene scene = scene::make_scene("stack", {{"count", "80"}, {"segments", "24"}});
  constexpr Shot shot{.width = 48, .height = 48, .samples = 64, .depth = 6};
  const auto a = renderer_->render(scene, scene.cameras[0].camera, shot).radiance(shot.samples);
  const auto b = renderer_->render(scene::baked(scene), scene.cameras[0].camera, shot).radiance(shot.samples);
  double squares = 0, sum = 0, difference = 0;
  for (std::size_t i = 0; i < a.size(); ++i) {
    squares += (a[i] - b[i]) * (a[i] - b[i]);
    difference += a[i] - b[i];
    sum += b[i];
  }
  const double mean = sum / static_cast<double>(b.size());
  const double error = std::sqrt(squares / static_cast<double>(b.size())) / mean, bias = difference / sum;
  std::printf("mean %.4f, error %.2g, bias %+.2g\n", mean, error, bias);
  // The same random numbers: only paths at edges differ.
  EXPECT_GT(mean, 0.03);  // 0.0354: not all black
  EXPECT_LT(error, 0.03);
  EXPECT_LT(std::abs(bias), 0.002);
}

INSTANTIATE_TEST_SUITE_P(Tracer, Instances, both_tracers(), tracer_name);
INSTANTIATE_TEST_SUITE_P(Tracer, InstancedPictures, both_tracers(), tracer_name);

}  // namespace
}  // namespace gleaner::test

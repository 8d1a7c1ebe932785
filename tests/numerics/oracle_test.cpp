// Every ray against every triangle in exact integer arithmetic, and what Embree and the OpenCL tracer say beside it.
//
// On the small grid (coordinates and directions of at most 32) every product in Embree's edge tests and in both
// tracers' distances is exact in float, and the answer must be the exact one. Of several triangles at the same distance
// (a tie) any is right; t within 4 ulp. What the tracers leave open (that no ray gets lost is the subject of
// watertight_test.cpp):
//  - the OpenCL tracer may give a ray exactly on an edge to either side: its shear has a quotient in it;
//  - so may Embree where a component of the direction is 0: it takes such a ray to leave a box whose upper face it lies
//  in;
//  - Embree finds a triangle that the ray begins on, at distance 0; the OpenCL tracer does not.
//
// On the large grid (below 2^20) products are rounded: a triangle that the ray meets or misses by less than the
// rounding is undecided, and may be the answer or not. t is asked for within 4 ulp times half the condition number of
// the quotient of two determinants (that number is at least 2).

#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <random>

#include "scene/library/builder.h"
#include "tests/numerics/tracing.h"

namespace gleaner::test {
namespace {

__extension__ typedef __int128 Wide;
using Point = std::array<std::int64_t, 3>;
using Triangle = std::array<Point, 3>;

Point operator-(const Point& a, const Point& b) { return {a[0] - b[0], a[1] - b[1], a[2] - b[2]}; }
Point operator+(const Point& a, const Point& b) { return {a[0] + b[0], a[1] + b[1], a[2] + b[2]}; }
Point operator*(std::int64_t s, const Point& a) { return {s * a[0], s * a[1], s * a[2]}; }
// Below 2^21 each: exact.
Point cross(const Point& a, const Point& b) {
  return {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
}
Wide dot(const Point& a, const Point& b) { return Wide{a[0]} * b[0] + Wide{a[1]} * b[1] + Wide{a[2]} * b[2]; }
bool is_zero(const Point& a) { return a[0] == 0 && a[1] == 0 && a[2] == 0; }

// Sums of the absolute values of all products in them: what rounding errors are in proportion to.
double magnitude(const Point& normal_of_a, const Point& and_b, const Point& with) {
  double sum = 0;
  for (int k = 0; k < 3; ++k) {
    const int i = (k + 1) % 3, j = (k + 2) % 3;
    const auto times = [](std::int64_t x, std::int64_t y) {
      return std::fabs(static_cast<double>(x) * static_cast<double>(y));
    };
    sum +=
        std::fabs(static_cast<double>(with[k])) * (times(normal_of_a[i], and_b[j]) + times(normal_of_a[j], and_b[i]));
  }
  return sum;
}

// a / b against c / d for positive numbers, without multiplying what might overflow: continued fractions.
int compare(Wide a, Wide b, Wide c, Wide d) {
  for (int sign = 1;; sign = -sign) {
    const Wide whole = a / b, other = c / d;
    if (whole != other) return whole < other ? -sign : sign;
    a -= whole * b;
    c -= other * d;
    if (a == 0 || c == 0) return a == c ? 0 : a == 0 ? -sign : sign;
    std::swap(a, b);
    std::swap(c, d);
  }
}

struct GridRay {
  Point origin, direction;
  float far = kInfinity;
  float tiny[3] = {0, 0, 0};  // what stands for zeros of the direction
  bool has_tiny() const { return tiny[0] != 0 || tiny[1] != 0 || tiny[2] != 0; }
  Ray as_ray() const {
    Ray ray;
    for (int k = 0; k < 3; ++k) {
      ray.origin[k] = static_cast<float>(origin[k]);
      ray.direction[k] = direction[k] == 0 ? tiny[k] : static_cast<float>(direction[k]);
    }
    ray.far = far;
    return ray;
  }
};

enum class Verdict { missed, at_origin, edge_on, undecided, on_edge, met };

struct Meeting {
  Verdict verdict = Verdict::missed;
  Wide numerator = 0, denominator = 0;  // t, both positive
  double t = 0, tolerance = 0;
  double nearest = 0, farthest = 0;  // edge_on: the corners, between which t must lie
};

constexpr double kRounding = 0x1p-24;
double ulp_of(double t) { return std::ldexp(1.0, std::ilogb(t) - 23); }

// The corners' distances along the direction's largest component.
void range_of(const Point corners[3], const Point& direction, Meeting& m) {
  int axis = 0;
  for (int k = 1; k < 3; ++k)
    if (std::abs(direction[k]) > std::abs(direction[axis])) axis = k;
  double along[3];
  for (int k = 0; k < 3; ++k) along[k] = static_cast<double>(corners[k][axis]) / static_cast<double>(direction[axis]);
  std::sort(along, along + 3);
  m.nearest = along[0] - ulp_of(along[0]);
  m.farthest = along[2] + ulp_of(along[2]);
}

// `exact`: the tracers round nothing but the quotient.
Meeting meet(const Triangle& triangle, const GridRay& ray, bool exact) {
  Meeting m;
  const Point corners[3] = {triangle[0] - ray.origin, triangle[1] - ray.origin, triangle[2] - ray.origin};
  const Point e1 = triangle[1] - triangle[0], e2 = triangle[2] - triangle[0], n = cross(e1, e2);
  m.denominator = dot(n, ray.direction);
  m.numerator = dot(corners[0], n);
  const bool front = m.denominator < 0;
  if (front) m.denominator = -m.denominator, m.numerator = -m.numerator;
  double condition = 2;
  if (!exact)
    condition = magnitude(e1, e2, corners[0]) / std::fabs(static_cast<double>(m.numerator)) +
                magnitude(e1, e2, ray.direction) / static_cast<double>(m.denominator);
  // A plane seen from within it, to within rounding, has no side and no distance.
  const bool edge_on = !(16 * kRounding * condition < 0.5);
  if (!edge_on && (m.denominator == 0 || m.numerator < 0)) return m;
  double products[3] = {}, largest = 0;
  if (!exact)
    for (int k = 0; k < 3; ++k) {
      const Point &p = corners[k], &q = corners[(k + 1) % 3];
      products[k] = magnitude(q - p, q + p, ray.direction);
      largest = std::max(largest, products[k]);
    }
  int inside = 0, outside = 0;
  for (int k = 0; k < 3; ++k) {
    // Twice the edge function, as Pluecker tests have it.
    Wide side = 2 * dot(cross(corners[k], corners[(k + 1) % 3]), ray.direction);
    if (front) side = -side;
    // The products' roundings, and Embree's slack of 2^-23 of the three sides' sum.
    const double rounding = 12 * kRounding * products[k] + 6 * kRounding * largest;
    const auto value = static_cast<double>(side);
    inside += value > rounding;
    outside += value < -rounding;
  }
  if (outside && (!edge_on || inside)) return m;
  if (edge_on) {
    m.verdict = Verdict::edge_on;
    range_of(corners, ray.direction, m);
    return m;
  }
  if (m.numerator == 0) {
    m.verdict = Verdict::at_origin;
    return m;
  }
  m.verdict = inside == 3 ? Verdict::met : exact ? Verdict::on_edge : Verdict::undecided;
  m.t = static_cast<double>(static_cast<long double>(m.numerator) / static_cast<long double>(m.denominator));
  m.tolerance = 4 * ulp_of(m.t) * condition / 2;
  return m;
}

struct Answer {
  std::string who;
  bool embree, any;
  std::vector<Hit> hits;
  std::vector<bool> blocked;
  std::size_t wrong = 0;
  double worst_ulp = 0;  // of t; on the large grid over half the condition number
};

class Oracle {
 public:
  // Answers wait for as many rays as a tracer was asked, then are judged together.
  Oracle(std::vector<Triangle> triangles, bool exact) : triangles_(std::move(triangles)), exact_(exact) {
    scene::SceneBuilder b("oracle");
    const auto wall = b.material("wall", scene::lambert(scene::grey(0.5)));
    b.mesh("all");
    for (const Triangle& t : triangles_) {
      std::uint32_t corner[3];
      for (int k = 0; k < 3; ++k)
        corner[k] =
            b.vertex({static_cast<double>(t[k][0]), static_cast<double>(t[k][1]), static_cast<double>(t[k][2])});
      b.triangle(corner[0], corner[1], corner[2], wall);
    }
    const scene::Scene scene = b.finish();
    for (const auto kind : {worker::TraceKind::embree, worker::TraceKind::opencl})
      if (auto device = open_device(kind)) {
        traced_.push_back({std::string(worker::trace_kind_name(kind)), kind == worker::TraceKind::embree,
                           std::make_unique<TracedScene>(*device, scene)});
        devices_.push_back(std::move(device));
      }
  }

  std::size_t tracers() const { return traced_.size(); }

  void compare(const std::string& kind, const std::vector<GridRay>& rays) {
    std::vector<Answer> answers;
    for (auto& tracer : traced_) {
      for (const Packing packing : {Packing::single, Packing::packets}) {
        if (!tracer.embree && packing == Packing::packets) continue;
        Answer a{tracer.name + (packing == Packing::packets ? " in packets" : ""), tracer.embree, false, {}, {}};
        a.hits.resize(rays.size());
        tracer.scene->closest(
            rays.size(), [&](std::size_t i) { return rays[i].as_ray(); },
            [&](std::size_t i, const Ray&, const Hit& hit) { a.hits[i] = hit; }, packing);
        answers.push_back(std::move(a));
      }
      Answer a{tracer.name + " any", tracer.embree, true, {}, {}};
      a.blocked.resize(rays.size());
      tracer.scene->any(
          rays.size(), [&](std::size_t i) { return rays[i].as_ray(); },
          [&](std::size_t i, const Ray&, bool blocked) { a.blocked[i] = blocked; });
      answers.push_back(std::move(a));
    }
    std::size_t hits = 0, ties = 0, open = 0;
    std::vector<Meeting> meetings(triangles_.size());
    for (std::size_t i = 0; i < rays.size(); ++i) {
      const GridRay& ray = rays[i];
      const Meeting* best = nullptr;
      bool tied = false, undecided = false;
      for (std::size_t k = 0; k < triangles_.size(); ++k) {
        Meeting& m = meetings[k] = meet(triangles_[k], ray, exact_);
        if (m.verdict == Verdict::edge_on) undecided = true;
        if (m.verdict == Verdict::missed || m.verdict == Verdict::edge_on || m.verdict == Verdict::at_origin) continue;
        if (std::fabs(m.t - ray.far) <= m.tolerance)
          m.verdict = Verdict::undecided;
        else if (m.t > ray.far)
          m.verdict = Verdict::missed;
        if (m.verdict == Verdict::missed) continue;
        // A component that stands for zero moves the ray off an edge, to one side or the other.
        if (m.verdict == Verdict::on_edge && ray.has_tiny()) m.verdict = Verdict::undecided;
        undecided = undecided || m.verdict == Verdict::undecided;
        const int order =
            best ? gleaner::test::compare(m.numerator, m.denominator, best->numerator, best->denominator) : -1;
        if (order <= 0) tied = order == 0, best = &m;
      }
      hits += best != nullptr;
      ties += tied;
      open += undecided;
      for (Answer& a : answers) judge(a, i, ray, meetings, best);
    }
    std::printf("%-28s %7zu rays, %7zu hit, %6zu tied, %5zu undecided", kind.c_str(), rays.size(), hits, ties, open);
    for (const Answer& a : answers) {
      EXPECT_EQ(a.wrong, 0u) << kind << ": " << a.who;
      if (!a.any) std::printf("; %s t within %.2g ulp", a.who.c_str(), a.worst_ulp);
    }
    std::printf("\n");
    rays_ += rays.size();
    undecided_ += open;
    hits_ += hits;
  }

  std::size_t rays() const { return rays_; }
  double undecided_share() const { return static_cast<double>(undecided_) / static_cast<double>(rays_); }
  double hit_share() const { return static_cast<double>(hits_) / static_cast<double>(rays_); }

 private:
  struct Traced {
    std::string name;
    bool embree;
    std::unique_ptr<TracedScene> scene;
  };

  void judge(Answer& a, std::size_t i, const GridRay& ray, const std::vector<Meeting>& meetings,
             const Meeting* best) const {
    const bool skew = ray.direction[0] != 0 && ray.direction[1] != 0 && ray.direction[2] != 0;
    // The nearest triangle that is certainly met bounds the answer from behind.
    double bound = kInfinity;
    bool possible = best != nullptr;
    for (const Meeting& m : meetings) {
      if (m.verdict == Verdict::met || (m.verdict == Verdict::on_edge && a.embree && skew))
        bound = std::min(bound, m.t + m.tolerance);
      possible = possible || m.verdict == Verdict::edge_on || (m.verdict == Verdict::at_origin && a.embree);
    }
    std::string said;
    if (a.any) {
      if (a.blocked[i] ? possible : bound == kInfinity) return;
      said = a.blocked[i] ? "blocked" : "free";
    } else if (const Hit& hit = a.hits[i]; !hit.found()) {
      if (bound == kInfinity) return;
      said = "nothing";
    } else {
      said = "triangle " + std::to_string(hit.primitive) + " at " + std::to_string(hit.t);
      if (hit.primitive < meetings.size()) {
        const Meeting& m = meetings[hit.primitive];
        // The OpenCL tracer promises the smallest index of triangles at one distance.
        const bool smaller = exact_ && !a.embree &&
                             std::any_of(meetings.begin(), meetings.begin() + hit.primitive, [&](const Meeting& other) {
                               return other.verdict == Verdict::met && m.verdict == Verdict::met && other.t == m.t;
                             });
        if (m.verdict == Verdict::edge_on) {
          // Embree lets it be anything.
          if (a.embree || (hit.t >= m.nearest && hit.t <= m.farthest && hit.t <= bound)) return;
        } else if (m.verdict == Verdict::at_origin) {
          if (a.embree && hit.t == 0) return;
        } else if (m.verdict != Verdict::missed && !smaller && std::fabs(hit.t - m.t) <= m.tolerance &&
                   m.t - m.tolerance <= bound) {
          a.worst_ulp = std::max(a.worst_ulp, 4 * std::fabs(hit.t - m.t) / m.tolerance);
          return;
        }
      }
    }
    if (a.wrong++ >= 3) return;
    const Ray r = ray.as_ray();
    ADD_FAILURE() << "from (" << r.origin[0] << ", " << r.origin[1] << ", " << r.origin[2] << ") along ("
                  << r.direction[0] << ", " << r.direction[1] << ", " << r.direction[2] << ") up to " << r.far << ": "
                  << a.who << " says " << said << ", exact is "
                  << (best ? "triangle " + std::to_string(best - meetings.data()) + " at " + std::to_string(best->t)
                           : "nothing");
  }

  std::vector<Triangle> triangles_;
  bool exact_;
  std::vector<std::unique_ptr<worker::Device>> devices_;
  std::vector<Traced> traced_;
  std::size_t rays_ = 0, undecided_ = 0, hits_ = 0;
};

class Random {
 public:
  explicit Random(std::uint64_t seed) : engine_(seed) {}
  std::int64_t within(std::int64_t most) { return std::uniform_int_distribution<std::int64_t>(-most, most)(engine_); }
  std::size_t below(std::size_t count) { return std::uniform_int_distribution<std::size_t>(0, count - 1)(engine_); }
  Point point(std::int64_t most) { return {within(most), within(most), within(most)}; }

 private:
  std::mt19937_64 engine_;
};

std::vector<Triangle> soup(Random& random, std::size_t count, std::int64_t most, std::int64_t size) {
  std::vector<Triangle> triangles;
  while (triangles.size() < count) {
    const Point at = random.point(most - size);
    const Triangle t{at + random.point(size), at + random.point(size), at + random.point(size)};
    if (!is_zero(cross(t[1] - t[0], t[2] - t[0]))) triangles.push_back(t);
  }
  return triangles;
}

// The surface of a cube of +-half, in squares of half: edges and corners that lie on each other and on axis-aligned
// boxes.
void add_cube(std::vector<Triangle>& triangles, std::int64_t half) {
  for (int axis = 0; axis < 3; ++axis)
    for (const std::int64_t side : {-half, half})
      for (const std::int64_t u : {-half, std::int64_t{0}})
        for (const std::int64_t v : {-half, std::int64_t{0}}) {
          const auto corner = [&](std::int64_t a, std::int64_t b) {
            Point p;
            p[axis] = side;
            p[(axis + 1) % 3] = a;
            p[(axis + 2) % 3] = b;
            return p;
          };
          triangles.push_back({corner(u, v), corner(u + half, v), corner(u + half, v + half)});
          triangles.push_back({corner(u, v), corner(u + half, v + half), corner(u, v + half)});
        }
}

std::vector<GridRay> many(std::size_t count, const std::function<GridRay(std::size_t)>& make) {
  std::vector<GridRay> rays;
  while (rays.size() < count) {
    GridRay ray = make(rays.size());
    if (!is_zero(ray.direction)) rays.push_back(ray);
  }
  return rays;
}

#define SKIP_WITHOUT_BOTH(oracle) \
  if ((oracle).tracers() < 2) GTEST_SKIP() << "NOT TESTED: here is only " << (oracle).tracers() << " of the two tracers"

TEST(Oracle, DecidesOnTheSmallGrid) {
  constexpr std::int64_t kMost = 32;
  Random random(9);
  std::vector<Triangle> triangles = soup(random, 24, kMost, 20);
  add_cube(triangles, 16);
  Oracle oracle(triangles, true);
  SKIP_WITHOUT_BOTH(oracle);
  const auto some_triangle = [&]() -> const Triangle& { return triangles[random.below(triangles.size())]; };
  const auto fits = [](const Point& p) {
    return std::abs(p[0]) <= kMost && std::abs(p[1]) <= kMost && std::abs(p[2]) <= kMost;
  };

  oracle.compare("random", many(400000, [&](std::size_t) {
                   return GridRay{random.point(kMost), random.point(kMost)};
                 }));
  oracle.compare("that end", many(100000, [&](std::size_t i) {
                   return GridRay{random.point(kMost), random.point(kMost), static_cast<float>(i % 8 + 1) * 0.25f};
                 }));
  oracle.compare("along axes, signed zeros", many(100000, [&](std::size_t i) {
                   GridRay ray{random.point(kMost), {}};
                   ray.direction[i % 3] = random.within(kMost);
                   for (float& zero : ray.tiny) zero = random.within(1) < 0 ? -0.0f : 0.0f;
                   return ray;
                 }));
  oracle.compare("along coordinate planes", many(100000, [&](std::size_t i) {
                   GridRay ray{random.point(kMost), random.point(kMost)};
                   ray.direction[i % 3] = 0;
                   ray.tiny[i % 3] = i % 2 ? -0.0f : 0.0f;
                   return ray;
                 }));
  oracle.compare("almost along axes", many(100000, [&](std::size_t i) {
                   GridRay ray{random.point(kMost), {}};
                   ray.direction[i % 3] = random.within(kMost);
                   for (float& zero : ray.tiny) zero = static_cast<float>(random.within(1000)) * 0x1p-149f;
                   return ray;
                 }));
  oracle.compare("from faces of boxes", many(100000, [&](std::size_t i) {
                   // Boxes are unions of triangles' own: their faces pass through corners.
                   GridRay ray{random.point(kMost), random.point(kMost)};
                   ray.origin[i % 3] = some_triangle()[i % 3][i % 3];
                   if (i % 2) ray.direction[i % 3] = 0;
                   return ray;
                 }));
  oracle.compare("at corners and edges", many(100000, [&](std::size_t i) {
                   const Triangle& t = some_triangle();
                   const Point& a = t[i % 3];
                   const Point& b = i % 2 ? a : t[(i + 1) % 3];
                   GridRay ray{random.point(kMost), {}};
                   const Point twice = (a - ray.origin) + (b - ray.origin);
                   if (a == b && fits(a - ray.origin)) ray.direction = a - ray.origin;
                   if (a != b && fits(twice)) ray.direction = twice;
                   return ray;
                 }));
  oracle.compare("in triangles' planes", many(100000, [&](std::size_t) {
                   const Triangle& t = some_triangle();
                   const Point e1 = t[1] - t[0], e2 = t[2] - t[0];
                   const Point from = t[0] + random.within(2) * e1 + random.within(2) * e2;
                   const Point along = random.within(2) * e1 + random.within(2) * e2;
                   return fits(from) && fits(along) ? GridRay{from, along} : GridRay{};
                 }));
  std::printf("small grid: %zu rays, %zu triangles\n", oracle.rays(), triangles.size());
  EXPECT_GT(oracle.hit_share(), 0.3);
}

TEST(Oracle, DecidesOnTheLargeGrid) {
  constexpr std::int64_t kMost = (1 << 20) - 1;
  Random random(10);
  std::vector<Triangle> triangles = soup(random, 30, kMost, 1 << 19);
  for (const Triangle& t : soup(random, 20, kMost, 1 << 12)) triangles.push_back(t);
  add_cube(triangles, 1 << 19);
  Oracle oracle(triangles, false);
  SKIP_WITHOUT_BOTH(oracle);
  oracle.compare("random", many(150000, [&](std::size_t) {
                   return GridRay{random.point(kMost), random.point(kMost)};
                 }));
  oracle.compare("at triangles", many(150000, [&](std::size_t i) {
                   const Triangle& t = triangles[i % triangles.size()];
                   const std::int64_t u = 8 + random.within(7), v = 8 + random.within(7);
                   GridRay ray{random.point(kMost), {}};
                   for (int k = 0; k < 3; ++k)
                     ray.direction[k] =
                         (t[0][k] * 32 + (t[1][k] - t[0][k]) * u + (t[2][k] - t[0][k]) * v) / 32 - ray.origin[k];
                   if (i % 4 == 0) ray.far = 1.25f;
                   return ray;
                 }));
  EXPECT_LT(oracle.undecided_share(), 0.001) << "too few decided to prove anything";
  oracle.compare("at corners", many(50000, [&](std::size_t i) {
                   GridRay ray{random.point(kMost), {}};
                   ray.direction = triangles[i % triangles.size()][i % 3] - ray.origin;
                   return ray;
                 }));
  oracle.compare("almost in triangles' planes", many(50000, [&](std::size_t i) {
                   const Triangle& t = triangles[i % triangles.size()];
                   const auto in_plane = [&] {
                     Point p;
                     const std::int64_t u = random.within(32), v = random.within(32);
                     for (int k = 0; k < 3; ++k)
                       p[k] = t[0][k] + ((t[1][k] - t[0][k]) * u + (t[2][k] - t[0][k]) * v) / 32;
                     return p;
                   };
                   GridRay ray{in_plane(), {}};
                   ray.direction = in_plane() - ray.origin;
                   for (const Point& p : {ray.origin, ray.direction})
                     if (std::max({std::abs(p[0]), std::abs(p[1]), std::abs(p[2])}) > kMost) return GridRay{};
                   return ray;
                 }));
  std::printf("large grid: %zu rays, %zu triangles, %.3g undecided\n", oracle.rays(), triangles.size(),
              oracle.undecided_share());
  EXPECT_GT(oracle.hit_share(), 0.3);
}

}  // namespace
}  // namespace gleaner::test

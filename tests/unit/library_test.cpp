#include "scene/library/library.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <map>
#include <random>
#include <set>

#include "scene/model/blob.h"
#include "scene/model/error.h"

namespace gleaner::scene {
namespace {

using Vector = std::array<double, 3>;

Vector minus(const Vector& a, const Vector& b) { return {a[0] - b[0], a[1] - b[1], a[2] - b[2]}; }
double dot(const Vector& a, const Vector& b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }
Vector cross(const Vector& a, const Vector& b) {
  return {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
}

Vector corner(const Scene& scene, std::size_t triangle, int c) {
  const float* p = &scene.positions[3 * std::size_t{scene.indices[3 * triangle + c]}];
  return {p[0], p[1], p[2]};
}

// Twice the area, along the front.
Vector area_vector(const Scene& scene, std::size_t triangle) {
  const Vector a = corner(scene, triangle, 0);
  return cross(minus(corner(scene, triangle, 1), a), minus(corner(scene, triangle, 2), a));
}

const Mesh& mesh_named(const Scene& scene, const std::string& name) {
  const auto found =
      std::find_if(scene.meshes.begin(), scene.meshes.end(), [&](const Mesh& m) { return m.name == name; });
  EXPECT_NE(found, scene.meshes.end()) << name;
  return *found;
}

// Does every edge have exactly one neighbour that runs along it the other way? Corners in one place are one corner.
bool is_closed(const Scene& scene, const Mesh& mesh) {
  std::map<std::pair<Vector, Vector>, int> edges;
  for (std::size_t t = mesh.first_triangle; t < std::size_t{mesh.first_triangle} + mesh.triangle_count; ++t)
    for (int c = 0; c < 3; ++c) ++edges[{corner(scene, t, c), corner(scene, t, (c + 1) % 3)}];
  return std::all_of(edges.begin(), edges.end(), [&](const auto& edge) {
    const auto back = edges.find({edge.first.second, edge.first.first});
    return edge.second == 1 && back != edges.end() && back->second == 1;
  });
}

double volume(const Scene& scene, const Mesh& mesh) {
  double sum = 0;
  const Vector origin = corner(scene, mesh.first_triangle, 0);
  for (std::size_t t = mesh.first_triangle; t < std::size_t{mesh.first_triangle} + mesh.triangle_count; ++t)
    sum += dot(minus(corner(scene, t, 0), origin),
               cross(minus(corner(scene, t, 1), origin), minus(corner(scene, t, 2), origin))) /
           6;
  return sum;
}

class EveryScene : public testing::TestWithParam<std::string> {};

TEST_P(EveryScene, IsWhole) {
  const Scene scene = make_scene(GetParam());
  validate(scene, GetParam());
  EXPECT_EQ(scene.name, GetParam());
  EXPECT_GT(scene.triangle_count(), 0u);

  std::set<std::string> meshes, materials, cameras;
  for (const Mesh& mesh : scene.meshes) {
    EXPECT_GT(mesh.triangle_count, 0u) << mesh.name;
    EXPECT_TRUE(!mesh.name.empty() && meshes.insert(mesh.name).second) << mesh.name;
  }
  ASSERT_EQ(scene.material_names.size(), scene.materials.size());
  for (const std::string& name : scene.material_names)
    EXPECT_TRUE(!name.empty() && materials.insert(name).second) << name;
  const std::set<std::uint32_t> used(scene.triangle_material.begin(), scene.triangle_material.end());
  EXPECT_EQ(used.size(), scene.materials.size()) << "a material that nothing has";

  ASSERT_FALSE(scene.cameras.empty());
  for (const NamedCamera& camera : scene.cameras) {
    EXPECT_TRUE(!camera.name.empty() && cameras.insert(camera.name).second) << camera.name;
    EXPECT_GT(camera.width, 0u);
    EXPECT_GT(camera.height, 0u);
    EXPECT_FLOAT_EQ(camera.camera.half_width / camera.camera.half_height, camera.aspect);
    EXPECT_FLOAT_EQ(static_cast<float>(camera.width) / static_cast<float>(camera.height), camera.aspect);
  }
  const SceneNeeds needs = needs_of(scene);
  EXPECT_TRUE(needs.emissive_triangles || needs.punctual_lights || needs.environment) << "no light";
  // Grain runs along the texture coordinates.
  EXPECT_EQ(scene.uvs.empty(), !needs.textures && !needs.anisotropy);
}

TEST_P(EveryScene, HasTrianglesWithArea) {
  const Scene scene = make_scene(GetParam());
  for (std::size_t t = 0; t < scene.triangle_count(); ++t) {
    const Vector area = area_vector(scene, t);
    ASSERT_GT(dot(area, area), 0) << "triangle " << t;
  }
}

TEST_P(EveryScene, FacesOutward) {
  static const std::set<std::string> seen_from_inside = {"furnace", "furnace-sphere", "furnace-point"};
  const Scene scene = make_scene(GetParam());
  for (const Mesh& mesh : scene.meshes) {
    if (!is_closed(scene, mesh)) continue;
    if (seen_from_inside.count(GetParam()))
      EXPECT_LT(volume(scene, mesh), 0) << mesh.name;
    else
      EXPECT_GT(volume(scene, mesh), 0) << mesh.name;
  }
}

TEST_P(EveryScene, HasNormalsOnTheFront) {
  const Scene scene = make_scene(GetParam());
  for (std::size_t t = 0; t < scene.triangle_count(); ++t) {
    const Vector area = area_vector(scene, t);
    for (int c = 0; c < 3; ++c) {
      const float* n = &scene.normals[3 * std::size_t{scene.indices[3 * t + c]}];
      const Vector normal{n[0], n[1], n[2]};
      if (dot(normal, normal) == 0) continue;
      ASSERT_GT(dot(normal, area), 0.5 * std::sqrt(dot(area, area))) << "triangle " << t << ", corner " << c;
    }
  }
}

TEST_P(EveryScene, IsTheSameTwice) {
  EXPECT_TRUE(serialize(make_scene(GetParam())) == serialize(make_scene(GetParam())));
}

std::vector<std::string> names() {
  std::vector<std::string> result;
  for (const LibraryEntry& entry : library()) result.push_back(entry.name);
  return result;
}

INSTANTIATE_TEST_SUITE_P(Library, EveryScene, testing::ValuesIn(names()), [](const auto& scene_name) {
  std::string name = scene_name.param;
  std::replace(name.begin(), name.end(), '-', '_');
  return name;
});

TEST(Library, KnowsWhichMeshesAreClosed) {
  const std::map<std::string, std::vector<std::string>> closed = {
      {"cornell-box", {"short box", "tall box"}},
      {"cornell-glass", {"glass sphere"}},
      {"furnace", {"walls"}},
      {"furnace-sphere", {"sphere"}},
      {"furnace-point", {"sphere"}},
      {"glass-caustic", {"glass sphere", "glass ring", "glass prism"}},
      {"white-furnace", {"sphere"}},
      {"far", {"short box", "tall box"}},
      {"thin-walls", {"box wall"}},
      {"environment-objects", {"diffuse", "glossy dielectric", "rough metal", "mirror", "glass"}},
  };
  for (const auto& [name, meshes] : closed) {
    const Scene scene = make_scene(name);
    for (const std::string& mesh : meshes)
      EXPECT_TRUE(is_closed(scene, mesh_named(scene, mesh))) << name << ": " << mesh;
  }
}

std::string error_of(const std::string& name, const std::map<std::string, std::string>& parameters) {
  try {
    make_scene(name, parameters);
  } catch (const Error& e) {
    EXPECT_EQ(e.kind(), ErrorKind::usage);
    return e.what();
  }
  return "no error";
}

TEST(Library, RefusesWhatItCannotMake) {
  using testing::AllOf;
  using testing::HasSubstr;
  EXPECT_THAT(error_of("cornel-box", {}), AllOf(HasSubstr("cornel-box"), HasSubstr("cornell-box")));
  EXPECT_THAT(error_of("cornell-box", {{"albedo", "1"}}), AllOf(HasSubstr("albedo"), HasSubstr("none")));
  EXPECT_THAT(error_of("hall", {{"triangle", "200"}}), AllOf(HasSubstr("'triangle'"), HasSubstr("triangles")));
  for (const char* bad : {"", "99", "20000001", "1e3x", " 200", "200.5", "nan", "inf", "-200", "0x200"})
    EXPECT_THAT(error_of("hall", {{"triangles", bad}}),
                AllOf(HasSubstr("a whole number from 100 to 20000000"), HasSubstr(std::string("'") + bad + "'")));
  for (const char* bad : {"1", "-0.1", "nan"})
    EXPECT_THAT(error_of("furnace", {{"albedo", bad}}), HasSubstr("a number from 0 to 0.99"));
  EXPECT_EQ(make_scene("hall", {{"triangles", "1e3"}}).triangle_count(),
            make_scene("hall", {{"triangles", "1000"}}).triangle_count());
}

TEST(Library, DefaultsAreTheDefaults) {
  for (const LibraryEntry& entry : library())
    EXPECT_TRUE(serialize(make_scene(entry.name, entry.parameters)) == serialize(make_scene(entry.name))) << entry.name;
}

TEST(Library, HallHasAsManyTrianglesAsAskedFor) {
  std::vector<std::size_t> wanted = {100, 101, 123, 150, 311, 312, 413353, 1000000, 2000003};
  for (double n = 100; n < 300000; n *= 1.07) wanted.push_back(static_cast<std::size_t>(n));
  for (std::size_t n : wanted) {
    const std::size_t found = make_scene("hall", {{"triangles", std::to_string(n)}}).triangle_count();
    EXPECT_GE(found, n);
    EXPECT_LE(static_cast<double>(found), 1.05 * static_cast<double>(n)) << n;
  }
}

TEST(Library, FarIsFarAndTheSameToTheBit) {
  const Scene far = make_scene("far"), near = make_scene("far", {{"x", "0"}, {"y", "0"}, {"z", "0"}});
  const Bounds bounds = bounds_of(far);
  const float centre[3] = {148376, 1234, -223423};
  for (int k = 0; k < 3; ++k) {
    EXPECT_EQ(bounds.lower[k], centre[k] - 1);
    EXPECT_EQ(bounds.upper[k], centre[k] + 1);
    EXPECT_EQ(far.cameras[0].camera.origin[k] - near.cameras[0].camera.origin[k], centre[k]);
    EXPECT_EQ(far.cameras[0].camera.forward[k], near.cameras[0].camera.forward[k]);
  }
  ASSERT_EQ(far.positions.size(), near.positions.size());
  for (std::size_t i = 0; i < far.positions.size(); ++i)
    ASSERT_EQ(double{far.positions[i]} - centre[i % 3], near.positions[i]) << i;
}

TEST(Library, NeedlesAreThin) {
  const Scene scene = make_scene("needles");
  const Mesh& needles = mesh_named(scene, "needles");
  EXPECT_EQ(needles.triangle_count, 2000u);
  for (std::size_t t = needles.first_triangle; t < std::size_t{needles.first_triangle} + needles.triangle_count; ++t) {
    const Vector edge = minus(corner(scene, t, 1), corner(scene, t, 0)), area = area_vector(scene, t);
    // Corners are rounded to float: up to 1.2e-7 m each way across an edge of 1 m.
    EXPECT_NEAR(std::sqrt(dot(edge, edge)), 1, 1e-6);
    EXPECT_NEAR(std::sqrt(dot(area, area) / dot(edge, edge)), 1e-6, 0.6e-6);
  }
}

TEST(Library, LampsEmitTheirPowerIntoTheHall) {
  for (const std::uint32_t count : {1u, 7u, 1000u, 20000u}) {
    const Scene scene = make_scene("many-lights", {{"lights", std::to_string(count)}});
    const Mesh& lamps = mesh_named(scene, "lamps");
    EXPECT_GE(lamps.triangle_count, count);
    EXPECT_LE(lamps.triangle_count, 2 * count);
    double watts = 0;
    for (std::size_t t = lamps.first_triangle; t < std::size_t{lamps.first_triangle} + lamps.triangle_count; ++t) {
      const Vector area = area_vector(scene, t), to_centre = minus({0, 3, 0}, corner(scene, t, 0));
      EXPECT_GT(dot(area, to_centre), 0) << "lamp triangle " << t << " shines away from the hall";
      watts += std::acos(-1) * scene.materials[scene.triangle_material[t]].emission[1] * std::sqrt(dot(area, area)) / 2;
    }
    EXPECT_NEAR(watts, 800, 1);
  }
}

// Moeller and Trumbore 1997: the nearest triangle that a ray meets, or none.
std::size_t nearest(const Scene& scene, const Vector& origin, const Vector& direction, double* distance) {
  std::size_t best = scene.triangle_count();
  *distance = std::numeric_limits<double>::infinity();
  for (std::size_t i = 0; i < scene.triangle_count(); ++i) {
    const Vector a = corner(scene, i, 0), e1 = minus(corner(scene, i, 1), a), e2 = minus(corner(scene, i, 2), a);
    const Vector n = cross(direction, e2), s = minus(origin, a), q = cross(s, e1);
    const double determinant = dot(e1, n), u = dot(s, n) / determinant, v = dot(direction, q) / determinant;
    if (!(u >= 0 && v >= 0 && u + v <= 1)) continue;
    const double t = dot(e2, q) / determinant;
    if (t > 1e-9 && t < *distance) {
      *distance = t;
      best = i;
    }
  }
  return best;
}

TEST(Library, NoLightPathLeadsBehindTheThinWalls) {
  const Scene scene = make_scene("thin-walls");
  std::mt19937 random(1);
  std::uniform_real_distribution<double> unit(0, 1);
  for (const auto& [left, right] : {std::pair(-4.5, -1.5), std::pair(1.51, 4.51)})
    for (int i = 0; i < 20000; ++i) {
      const Vector origin{left + (right - left) * (0.001 + 0.998 * unit(random)), 0.001 + 2.498 * unit(random),
                          -1.499 + 2.998 * unit(random)};
      const Vector direction{2 * unit(random) - 1, 2 * unit(random) - 1, 2 * unit(random) - 1};
      double distance = 0;
      const std::size_t hit = nearest(scene, origin, direction, &distance);
      ASSERT_LT(hit, scene.triangle_count()) << "a ray leaves the dark room";
      const double x = origin[0] + distance * direction[0];
      EXPECT_TRUE(x >= left - 1e-6 && x <= right + 1e-6) << "a ray from the dark room gets to x = " << x;
      const Material& m = scene.materials[scene.triangle_material[hit]];
      EXPECT_EQ(m.emission[0], 0) << "the light is seen from the dark room";
    }
}

TEST(Library, RoomsAreTight) {
  // From inside these, every ray must meet something.
  const std::map<std::string, std::map<std::string, std::string>> rooms = {
      {"hall", {{"triangles", "3000"}}}, {"many-lights", {{"lights", "50"}}}, {"emissive-textured", {}}};
  std::mt19937 random(2);
  std::uniform_real_distribution<double> unit(-1, 1);
  for (const auto& [name, parameters] : rooms) {
    const Scene scene = make_scene(name, parameters);
    for (const NamedCamera& camera : scene.cameras)
      for (int i = 0; i < 2000; ++i) {
        const float* o = camera.camera.origin;
        const Vector direction{unit(random), unit(random), unit(random)};
        double distance = 0;
        ASSERT_LT(nearest(scene, {o[0], o[1], o[2]}, direction, &distance), scene.triangle_count())
            << name << ": " << direction[0] << " " << direction[1] << " " << direction[2];
      }
  }
}

TEST(Library, FurnacesAreWhatTheySay) {
  const Scene box = make_scene("furnace", {{"albedo", "0.8"}, {"emission", "2.5"}});
  ASSERT_EQ(box.materials.size(), 1u);
  EXPECT_EQ(box.materials[0].base_color[1], 0.8f);
  EXPECT_EQ(box.materials[0].emission[2], 2.5f);
  EXPECT_EQ(box.materials[0].metallic, 0);
  EXPECT_EQ(box.materials[0].specular, 0);

  const Scene sphere = make_scene("furnace-point", {{"segments", "400"}});
  ASSERT_EQ(sphere.lights.size(), 1u);
  EXPECT_FLOAT_EQ(sphere.lights[0].intensity[0], 3.14159265f);
  EXPECT_EQ(sphere.lights[0].type, GLEANER_LIGHT_POINT);
  double area = 0;
  for (std::size_t t = 0; t < sphere.triangle_count(); ++t) {
    const Vector a = area_vector(sphere, t);
    area += std::sqrt(dot(a, a)) / 2;
  }
  EXPECT_NEAR(area, 4 * std::acos(-1), 0.002 * area);
}

// The receiver is the whole picture: the corners of the film are its corners.
TEST(Library, FormFactorCamerasSeeTheReceiverAlone) {
  for (const char* name : {"parallel-squares", "perpendicular-squares"}) {
    const Scene scene = make_scene(name);
    const Camera& c = scene.cameras[0].camera;
    ASSERT_EQ(c.type, GLEANER_CAMERA_ORTHOGRAPHIC);
    for (const double s : {-0.999, 0.0, 0.999})
      for (const double t : {-0.999, 0.0, 0.999}) {
        Vector origin, direction;
        for (int k = 0; k < 3; ++k) {
          origin[k] = c.origin[k] + s * c.half_width * c.right[k] + t * c.half_height * c.up[k];
          direction[k] = c.forward[k];
        }
        double distance = 0;
        const std::size_t hit = nearest(scene, origin, direction, &distance);
        const Mesh& receiver = mesh_named(scene, "receiver");
        EXPECT_TRUE(hit >= receiver.first_triangle && hit < receiver.first_triangle + receiver.triangle_count);
      }
    const Bounds bounds = bounds_of(scene);
    EXPECT_EQ(2 * c.half_width, bounds.upper[0] - bounds.lower[0]);
  }
}

TEST(Library, NeedsAreWhatTheNamesPromise) {
  const auto needs = [](const char* name) { return needs_of(make_scene(name)); };
  EXPECT_FALSE(needs("cornell-box").glossy || needs("cornell-box").specular || needs("cornell-box").textures);
  EXPECT_TRUE(needs("cornell-mirror").specular);
  EXPECT_TRUE(needs("cornell-glass").transmissive);
  EXPECT_FALSE(needs("cornell-glass").rough_transmissive);
  EXPECT_TRUE(needs("cornell-glossy").glossy);
  EXPECT_FALSE(needs("cornell-glossy").specular);
  EXPECT_TRUE(needs("cornell-textured").normal_maps && needs("cornell-textured").alpha &&
              needs("cornell-textured").material_textures);
  EXPECT_TRUE(needs("environment-objects").environment);
  EXPECT_FALSE(needs("environment-objects").emissive_triangles);
  EXPECT_TRUE(needs("punctual-lights").punctual_lights);
  EXPECT_FALSE(needs("hall").punctual_lights);
}

TEST(Library, SkyHasABrightSun) {
  const Environment sky = make_scene("environment-objects").environment;
  ASSERT_EQ(sky.width, 512u);
  ASSERT_EQ(sky.height, 256u);
  const double pi = std::acos(-1);
  double power = 0, sun = 0, solid_angle = 0;
  for (std::uint32_t y = 0; y < sky.height; ++y)
    for (std::uint32_t x = 0; x < sky.width; ++x) {
      const double texel = 2 * pi / sky.width * (std::cos(pi * y / sky.height) - std::cos(pi * (y + 1) / sky.height));
      const double green = sky.radiance[3 * (std::size_t{y} * sky.width + x) + 1];
      power += green * texel;
      if (green > 100) sun += green * texel;
      solid_angle += texel;
    }
  EXPECT_NEAR(solid_angle, 4 * pi, 1e-9);
  // 1180 over a disc of 1.5 degrees' radius.
  EXPECT_NEAR(sun, 1180 * 2 * pi * (1 - std::cos(1.5 * pi / 180)), 0.05 * sun);
  EXPECT_GT(sun, 0.2 * power);
}

}  // namespace
}  // namespace gleaner::scene

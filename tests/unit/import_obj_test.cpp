#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <chrono>
#include <cmath>
#include <random>

#include "import_files.h"
#include "scene/import/import.h"
#include "scene/import/polygon.h"
#include "scene/model/error.h"

namespace gleaner::scene {
namespace {

using testing::AllOf;
using testing::Contains;
using testing::Each;
using testing::ElementsAre;
using testing::HasSubstr;
using testing::Not;

const std::string kSquare = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n";

class Obj : public testing::Test {
 protected:
  Scene read(const std::string& text, const std::string& mtl = "") {
    if (!mtl.empty()) folder_.write("m.mtl", mtl);
    return import_text(folder_, "scene.obj", text);
  }
  // One triangle with the material `m` of an MTL that holds `properties`.
  Material material(const std::string& properties) {
    return read("mtllib m.mtl\n" + kSquare + "usemtl m\nf 1 2 3\n", "newmtl m\n" + properties + "\n").materials.at(0);
  }
  std::string refused(const std::string& text, const std::string& mtl = "") {
    if (!mtl.empty()) folder_.write("m.mtl", mtl);
    return refusal(folder_.write("scene.obj", text));
  }

  Folder folder_;
};

TEST_F(Obj, ReadsPolygonsAndNegativeIndices) {
  const Scene s = read(kSquare + "f 1 2 3 4\nf -4 -3 -2\n");
  EXPECT_EQ(s.vertex_count(), 4u);
  EXPECT_THAT(s.indices, ElementsAre(0, 1, 2, 0, 2, 3, 0, 1, 2));
  EXPECT_THAT(s.normals, Each(0.0f));
  EXPECT_TRUE(s.uvs.empty());
  EXPECT_THAT(s.materials.at(0).base_color, Each(0.8f));
  EXPECT_FLOAT_EQ(s.materials[0].specular, 0);
  EXPECT_FLOAT_EQ(s.materials[0].metallic, 0);
  ASSERT_EQ(s.cameras.size(), 1u);
  EXPECT_THAT(s.warnings, Contains(HasSubstr("no camera")));
}

TEST_F(Obj, VerticesAreDistinctCorners) {
  const Scene s = read(kSquare +
                       "vn 0 0 2\nvn 0 1 0\nvn 0 0 0\nvt 0.25 0.75\nvt 0.5\n"
                       "f 1/1/1 2/2/1 3//1\nf 1/1/1 3//1 4//2\nf 1//2 2//3 3\n");
  EXPECT_EQ(s.vertex_count(), 7u);
  EXPECT_THAT(s.indices, ElementsAre(0, 1, 2, 0, 2, 3, 4, 5, 6));
  EXPECT_THAT(s.normals, ElementsAre(0, 0, 1, 0, 0, 1, 0, 0, 1, 0, 1, 0, 0, 1, 0, 0, 0, 0, 0, 0, 0));
}

TEST_F(Obj, WhiteSpaceCommentsAndContinuations) {
  const Scene s = read(
      "# a comment\r\n\r\n  v 0 0 0 # colour follows\r\nv\t1 0 \\\r\n 0\r\nv +1 1.e0 0 0.5 0.5 0.5\r\nf 1 2 \\\n3");
  EXPECT_THAT(s.positions, ElementsAre(0, 0, 0, 1, 0, 0, 1, 1, 0));
  EXPECT_THAT(s.indices, ElementsAre(0, 1, 2));
}

// Lines are divided in one way where they hold nothing special, and in another where they hold '#' or a backslash.
TEST_F(Obj, NumbersAsProgramsWriteThem) {
  const Scene s = read("v 1E-400 -1e-400 +0\nv 1.50e+00 .5 5.\nv 2e0 1 0 # 3\nv -0 00012 1\\\n0\nf 1 2 3\nf 1 2 4\n");
  EXPECT_THAT(s.positions, ElementsAre(0, 0, 0, 1.5f, .5f, 5, 2, 1, 0, 0, 12, 1));
  EXPECT_THAT(s.indices, ElementsAre(0, 1, 2, 0, 1, 3));
}

TEST_F(Obj, GroupsAreMeshes) {
  const Scene s = read(kSquare + "f 1 2 3\no box top\nf 1 2 3\nf 1 3 4\ng empty\ng side\nf 1 2 4\n");
  ASSERT_EQ(s.meshes.size(), 3u);
  EXPECT_EQ(s.meshes[0].name, "mesh 0");
  EXPECT_EQ(s.meshes[1].name, "box top");
  EXPECT_EQ(s.meshes[1].triangle_count, 2u);
  EXPECT_EQ(s.meshes[2].name, "side");
  EXPECT_EQ(s.meshes[2].first_triangle, 3u);
}

TEST_F(Obj, Materials) {
  Material m = material("Kd 0.1 0.2 0.3\nKe 4 5 6\nKs 0 0 0\nillum 2");
  EXPECT_THAT(m.base_color, ElementsAre(0.1f, 0.2f, 0.3f));
  EXPECT_THAT(m.emission, ElementsAre(4, 5, 6));
  EXPECT_FLOAT_EQ(m.specular, 0);
  EXPECT_FLOAT_EQ(m.metallic, 0);
  EXPECT_EQ(m.flags, 0u);

  EXPECT_THAT(material("Kd 0.4").base_color, Each(0.4f));

  m = material("Kd 0 0 0\nKs 0.9 0.8 0.7\nillum 5");
  EXPECT_THAT(m.base_color, ElementsAre(0.9f, 0.8f, 0.7f));
  EXPECT_FLOAT_EQ(m.metallic, 1);
  EXPECT_FLOAT_EQ(m.roughness, 0);

  m = material("Ks 0.3 0.3 0.3\nTf 0.1 0.2 0.3\nNi 2.5\nillum 7\nd 0.2");
  EXPECT_THAT(m.base_color, ElementsAre(0.1f, 0.2f, 0.3f));
  EXPECT_FLOAT_EQ(m.transmission, 1);
  EXPECT_FLOAT_EQ(m.roughness, 0);
  EXPECT_FLOAT_EQ(m.ior, 2.5f);
  EXPECT_EQ(m.flags, GLEANER_MATERIAL_SOLID);
  EXPECT_THAT(material("Ks 0.3 0.3 0.3\nNi 1.5\nillum 7").base_color, Each(0.3f));
  EXPECT_THAT(material("Ks 0 0 0\nNi 1.5\nillum 7").base_color, Each(1.0f));
  EXPECT_FLOAT_EQ(material("illum 7").ior, 1.5f);
  EXPECT_FLOAT_EQ(material("illum 7\nNi 0").ior, 1);

  m = material("d 0.25");
  EXPECT_FLOAT_EQ(m.alpha, 0.25f);
  EXPECT_EQ(m.flags, GLEANER_MATERIAL_ALPHA_BLEND);
  EXPECT_FLOAT_EQ(material("Tr 0.25").alpha, 0.75f);
  EXPECT_EQ(material("d 1\nTr 1").flags, 0u);
}

TEST_F(Obj, WhatIsNotReadGetsAWord) {
  const Scene s = read("mtllib m.mtl\n" + kSquare + "usemtl shiny\nf 1 2 3\nl 1 2\ncstype bezier\n",
                       "newmtl shiny\nKs 0.5 0.5 0.5\nrefl b.png\nillum 2\n");
  EXPECT_THAT(s.warnings, Contains(AllOf(HasSubstr("shiny"), HasSubstr("Ks"))));
  EXPECT_THAT(s.warnings, Contains(HasSubstr("refl")));
  EXPECT_THAT(s.warnings, Contains(HasSubstr("lines")));
  EXPECT_THAT(s.warnings, Contains(HasSubstr("cstype")));
}

TEST_F(Obj, SeveralLibrariesAndNamesWithSpaces) {
  folder_.write("a.mtl", "newmtl red\nKd 1 0 0\n");
  folder_.write("b c.mtl", "newmtl dark blue\nKd 0 0 1\n");
  const Scene s = read("mtllib a.mtl\nmtllib b c.mtl\nmtllib a.mtl\n" + kSquare +
                       "usemtl dark blue\nf 1 2 3\nusemtl red\nf 1 2 3\n");
  EXPECT_THAT(s.material_names, ElementsAre("dark blue", "red"));
  EXPECT_THAT(s.materials[0].base_color, ElementsAre(0, 0, 1));
  EXPECT_THAT(s.triangle_material, ElementsAre(0, 1));
  folder_.write("d.mtl", "newmtl green\nKd 0 1 0\n");
  EXPECT_THAT(read("mtllib a.mtl d.mtl\n" + kSquare + "usemtl green\nf 1 2 3\n").materials[0].base_color,
              ElementsAre(0, 1, 0));
}

TEST_F(Obj, MaterialsWithoutALibraryAreGrey) {
  const Scene s = read(kSquare + "usemtl gold\nf 1 2 3\n");
  EXPECT_THAT(s.materials.at(0).base_color, Each(0.8f));
  EXPECT_THAT(s.warnings, Contains(HasSubstr("without mtllib")));
}

TEST_F(Obj, TexturesCountFromTheTop) {
  folder_.write_image("sub/t u.png", 1, 2, 3, {1, 0, 0, 0, 0, 1});
  folder_.write("sub/m.mtl", "newmtl t\nKd 1 1 1\nmap_Kd -s 1 1 1 -clamp on t u.png\n");
  const Scene s = read("mtllib sub\\m.mtl\n" + kSquare + "vt 0 0\nvt 1 0\nvt 1 1\nusemtl t\nf 1/1 2/2 3/3\n");
  ASSERT_EQ(s.textures.size(), 1u);
  EXPECT_EQ(s.textures[0].wrap_u, GLEANER_WRAP_CLAMP);
  EXPECT_EQ(s.textures[0].flags, GLEANER_TEXTURE_SRGB);
  EXPECT_THAT(s.texels, ElementsAre(0xff0000ffu, 0xffff0000u));
  EXPECT_THAT(s.uvs, ElementsAre(0, 1, 1, 1, 1, 0));
}

TEST_F(Obj, BadOnesAreRefusedByLine) {
  struct Case {
    std::string text, mtl;
    std::vector<std::string> words;
  };
  const Case cases[] = {
      {"v 0 0\n", "", {"line 1: v", "a finite number", "nothing"}},
      {"v 0 0 x\n", "", {"line 1: v", "\"x\""}},
      {"v 0 0 nan\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "", {"line 4: f", "finite coordinates"}},
      {"v 0 0 1e999\n", "", {"line 1: v", "\"1e999\""}},
      {"v 0 0 2e19\n", "", {"line 1: v", "\"2e19\""}},
      {"v 0 0 -4e9\nv 0 0 0\nv 0 1 4e9\nf 1 2 3\n", "", {"v 1", "the scene's centre"}},
      {"v 0 0 1.5.2\n", "", {"line 1: v", "\"1.5.2\""}},
      {kSquare + "\nf 1 2 5\n", "", {"line 6: f", "the 4 vertices", "\"5\""}},
      {kSquare + "f 1 2 0\n", "", {"line 5: f", "\"0\""}},
      {kSquare + "f 1 2 -5\n", "", {"line 5: f", "\"-5\""}},
      {kSquare + "f 1 2 99999999999999999999\n", "", {"line 5: f", "\"99999999999999999999\""}},
      {kSquare + "f 1 2 3.5\n", "", {"line 5: f", "\"3.5\""}},
      {kSquare + "vt 0 0\nf 1/2 2 3\n", "", {"line 6: f", "the 1 texture vertices", "\"2\""}},
      {kSquare + "vn 0 0 1\nf 1//2 2 3\n", "", {"line 6: f", "the 1 normals", "\"2\""}},
      {kSquare + "f 1/// 2 3\n", "", {"line 5: f"}},
      {kSquare + "f /1 2 3\n", "", {"line 5: f", "an index of vertices"}},
      {"vn 0 0\n", "", {"line 1: vn"}},
      {"vt\n", "", {"line 1: vt"}},
      {"mtllib ../m.mtl\n", "", {"line 1: mtllib", "inside the scene's folder"}},
      {"mtllib /etc/hostname\n", "", {"line 1: mtllib", "inside the scene's folder"}},
      {"mtllib\n", "", {"line 1: mtllib", "a file's name"}},
      {"mtllib m.mtl\n" + kSquare + "usemtl m\nf 1 2 3\n", "newmtl m\nmap_Kd ../t.png\n", {"line 2: map_Kd", "inside"}},
      {"mtllib m.mtl\n" + kSquare + "usemtl m\nf 1 2 3\n",
       "newmtl m\nmap_Kd ..\\..\\t.png\n",
       {"line 2: map_Kd", "inside"}},
      {"mtllib m.mtl\n" + kSquare + "usemtl m\nf 1 2 3\n",
       "newmtl m\nmap_Kd /etc/hostname\n",
       {"line 2: map_Kd", "inside"}},
  };
  for (const Case& c : cases) {
    const std::string said = refused(c.text, c.mtl);
    for (const std::string& word : c.words) EXPECT_THAT(said, HasSubstr(word)) << c.text << c.mtl;
    EXPECT_THAT(said, HasSubstr("expected"));
  }
}

TEST_F(Obj, MissingTexturesAreLeftOut) {
  folder_.write("m.mtl",
                "newmtl a\nKd .5 .25 1\nmap_Kd none.png\nmap_Bump no/bump.png\nnewmtl b\nKd 0 0 0\nmap_Kd "
                "C:\\art\\wood.png\nnewmtl c\nmap_Kd /art/that/is/elsewhere.png\nKe 1 2 3\nmap_Ke none.png\n"
                "newmtl d\nKd 1 1 1\nmap_d none.png\n");
  const std::string text =
      "mtllib m.mtl\n" + kSquare + "usemtl a\nf 1 2 3\nusemtl b\nf 1 2 3\nusemtl c\nf 1 2 3\nusemtl d\nf 1 2 3\n";
  const Scene s = import_text(folder_, "scene.obj", text);
  EXPECT_TRUE(s.textures.empty());
  EXPECT_THAT(s.warnings, Contains(AllOf(HasSubstr("line 3: map_Kd"), HasSubstr("there is no such file"))));
  EXPECT_FLOAT_EQ(s.materials.at(0).base_color[1], 0.25f);
  EXPECT_FLOAT_EQ(s.materials.at(1).base_color[1], 0.8f);  // not the black that the map's colours would have covered
  EXPECT_FLOAT_EQ(s.materials.at(2).emission[2], 3);
  EXPECT_EQ(s.materials.at(3).flags & GLEANER_MATERIAL_ALPHA_BLEND, 0u);
  ImportOptions strict;
  strict.strict = true;
  EXPECT_THROW(import_scene(folder_.path("scene.obj"), strict), Error);
}

TEST_F(Obj, BadLibrariesAreRefusedByFileAndLine) {
  struct Case {
    std::string mtl, word;
  };
  const Case cases[] = {
      {"Kd 1 1 1\n", "line 1: kd: expected newmtl before it"},
      {"newmtl m\nKd 1 1\n", "line 2: kd"},
      {"newmtl m\nKd -1 0 0\n", "line 2: kd: expected a number of at least 0, found \"-1\""},
      {"newmtl m\nKd spectral file.rfl\n", "line 2: kd"},
      {"newmtl m\n\nKe -1 0 0\n", "line 3: ke: expected a number of at least 0"},
      {"newmtl m\nKe nan 0 0\n", "line 2: ke"},
      {"newmtl m\nillum 12\n", "line 2: illum"},
      {"newmtl m\nd 2\n", "line 2: d"},
  };
  const std::string scene = folder_.write("scene.obj", "mtllib m.mtl\n");
  for (const Case& c : cases) {
    folder_.write("m.mtl", c.mtl);
    try {
      import_scene(scene);
      ADD_FAILURE() << c.mtl;
    } catch (const Error& error) {
      EXPECT_EQ(error.kind(), ErrorKind::bad_input);
      EXPECT_THAT(error.what(), AllOf(HasSubstr("m.mtl: "), HasSubstr(c.word)));
    }
  }
}

// --- polygons --------------------------------------------------------------------------------------------------------

using Points = std::vector<std::array<double, 3>>;

// Area by the triangles; for a planar polygon that does not cross itself it must be the shoelace formula's, with no
// triangle turned over.
void expect_covers(const Points& polygon, double area) {
  bool is_simple = false;
  const auto triangles = triangulated(polygon, is_simple);
  EXPECT_TRUE(is_simple);
  ASSERT_EQ(triangles.size(), polygon.size() - 2);
  double sum = 0;
  for (const auto& t : triangles) {
    const auto &a = polygon[t[0]], &b = polygon[t[1]], &c = polygon[t[2]];
    const double twice = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
    EXPECT_GE(twice, 0);
    sum += twice / 2;
  }
  EXPECT_NEAR(sum, area, 1e-12);
}

TEST(Polygon, ConvexOnesAreFans) {
  bool is_simple = false;
  const auto triangles = triangulated({{0, 0, 0}, {1, 0, 0}, {2, 1, 0}, {1, 2, 0}, {0, 1, 0}}, is_simple);
  for (const auto& t : triangles) EXPECT_EQ(t[0], 0u);
}

TEST(Polygon, ConcaveOnesAreCovered) {
  expect_covers({{0, 0, 0}, {2, 0, 0}, {2, 2, 0}, {1, 0.5, 0}}, 1.5);  // an arrowhead
  expect_covers({{1, 0.5, 0}, {0, 0, 0}, {2, 0, 0}, {2, 2, 0}}, 1.5);  // from its dent
  expect_covers({{0, 0, 0}, {3, 0, 0}, {3, 3, 0}, {2, 3, 0}, {2, 1, 0}, {1, 1, 0}, {1, 3, 0}, {0, 3, 0}}, 7);  // a U
  Points star;
  double area = 0;
  for (int i = 0; i < 40; ++i) {
    const double r = i % 2 ? 0.3 : 1, angle = 2 * M_PI * i / 40;
    star.push_back({r * std::cos(angle), r * std::sin(angle), 0});
  }
  for (int i = 0; i < 40; ++i) area += (star[i][0] * star[(i + 1) % 40][1] - star[i][1] * star[(i + 1) % 40][0]) / 2;
  expect_covers(star, area);
}

TEST(Polygon, AnyPlaneAndDirectionWillDo) {
  // The arrowhead, clockwise seen from +z and standing upright: its triangles must be wound as it is.
  const Points flat = {{0, 0, 0}, {2, 0, 0}, {2, 2, 0}, {1, 0.5, 0}};
  for (int axis = 0; axis < 3; ++axis) {
    for (const bool reversed : {false, true}) {
      Points polygon;
      for (const auto& p : flat) {
        std::array<double, 3> q{};
        q[(axis + 1) % 3] = p[0];
        q[(axis + 2) % 3] = p[1];
        polygon.push_back(q);
      }
      if (reversed) std::reverse(polygon.begin(), polygon.end());
      double sum = 0;
      bool is_simple = false;
      for (const auto& t : triangulated(polygon, is_simple)) {
        const auto &a = polygon[t[0]], &b = polygon[t[1]], &c = polygon[t[2]];
        const int u = (axis + 1) % 3, v = (axis + 2) % 3;
        const double twice = (b[u] - a[u]) * (c[v] - a[v]) - (b[v] - a[v]) * (c[u] - a[u]);
        EXPECT_GT(reversed ? -twice : twice, 0);
        sum += twice / 2;
      }
      EXPECT_NEAR(sum, reversed ? -1.5 : 1.5, 1e-12);
    }
  }
}

TEST(Polygon, CrossingAndFlatOnesEnd) {
  bool is_simple = true;
  EXPECT_EQ(triangulated({{0, 0, 0}, {2, 2, 0}, {2, 0, 0}, {0, 1, 0}}, is_simple).size(), 2u);
  EXPECT_FALSE(is_simple);
  EXPECT_EQ(triangulated(Points(7, {1, 2, 3}), is_simple).size(), 5u);
  EXPECT_EQ(triangulated({{0, 0, 0}, {1, 0, 0}, {2, 0, 0}, {1, 0, 0}, {3, 0, 0}}, is_simple).size(), 3u);
  EXPECT_EQ(triangulated(Points(100000, {1, 2, 3}), is_simple).size(), 99998u);
}

double shoelace(const Points& p) {
  double area = 0;
  for (std::size_t i = 0; i < p.size(); ++i) {
    const auto &a = p[i], &b = p[(i + 1) % p.size()];
    area += (a[0] * b[1] - a[1] * b[0]) / 2;
  }
  return area;
}

// Outlines on which simple algorithms take time with the square of the corners, and such as touch themselves.
Points outline(const std::string& shape, int corners) {
  Points p;
  std::mt19937 random(7);
  std::uniform_real_distribution<double> radius(0.3, 1);
  const double turn = 2 * M_PI;
  if (shape == "star")
    for (int i = 0; i < corners; ++i) {
      const double r = radius(random), angle = turn * i / corners;
      p.push_back({r * std::cos(angle), r * std::sin(angle), 0});
    }
  if (shape == "comb" || shape == "comb on its side") {
    p = {{0, -1, 0}, {double(corners), -1, 0}};
    for (int i = corners - 2; i >= 0; --i) p.push_back({i + 0.5, i % 2 ? 0.001 * std::sin(i) : 10, 0});
    if (shape != "comb")
      for (auto& q : p) q = {-q[1], q[0], 0};
  }
  if (shape == "spiral")
    for (int side = 0; side < 2; ++side)
      for (int k = 0; k < corners / 2; ++k) {
        const double t = 0.01 * (side ? k : corners / 2 - 1 - k), r = (side ? 2.5 : 1) + t;
        p.push_back({r * std::cos(t), r * std::sin(t), 0});
      }
  if (shape == "ring")  // a bridge, walked twice, joins the hole to the outline
    for (int side = 0; side < 2; ++side)
      for (int k = 0; k <= corners / 2; ++k) {
        const double angle = (side ? -turn : turn) * (k % (corners / 2)) / (corners / 2), r = side ? 1 : 3;
        p.push_back({r * std::cos(angle), r * std::sin(angle), 0});
      }
  if (shape == "battlement") {  // many corners at one height
    for (int i = 0; i < corners / 4; ++i)
      for (const auto& [x, y] : {std::pair(0, 5), {1, 5}, {1, 0}, {2, 0}})
        p.push_back({double(-2 * i - x), double(y), 0});
    p.push_back({double(-corners), -1, 0});
    p.push_back({0, -1, 0});
  }
  return p;
}

TEST(Polygon, LargeOnesOfEveryShapeAreCoveredAtOnce) {
  for (const char* shape : {"star", "comb", "comb on its side", "spiral", "ring", "battlement"})
    for (const int corners : {40, 2400, 100000}) {
      const Points polygon = outline(shape, corners);
      bool is_simple = false;
      const auto start = std::chrono::steady_clock::now();
      const auto triangles = triangulated(polygon, is_simple);
      const double seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
      EXPECT_TRUE(is_simple) << shape << " " << corners;
      EXPECT_EQ(triangles.size(), polygon.size() - 2);
      double area = 0;
      for (const auto& t : triangles) area += shoelace({polygon[t[0]], polygon[t[1]], polygon[t[2]]});
      EXPECT_NEAR(area, shoelace(polygon), 1e-6 * std::abs(shoelace(polygon))) << shape << " " << corners;
      std::printf("%s of %zu corners: %.3f s\n", shape, polygon.size(), seconds);
    }
}

}  // namespace
}  // namespace gleaner::scene

// Meshes of scanners and CAD: PLY and STL; and what OBJ files of such programs carry.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstring>

#include "import_files.h"
#include "scene/import/import.h"
#include "scene/model/error.h"

namespace gleaner::scene {
namespace {

using testing::AllOf;
using testing::Contains;
using testing::Each;
using testing::ElementsAre;
using testing::HasSubstr;

using Shorts = std::vector<std::uint16_t>;

template <typename T>
std::string raw(std::initializer_list<T> values, bool swapped = false) {
  std::string bytes;
  for (const T value : values) {
    char one[sizeof(T)];
    std::memcpy(one, &value, sizeof value);
    if (swapped) std::reverse(one, one + sizeof one);
    bytes.append(one, sizeof one);
  }
  return bytes;
}

TEST(Ply, Ascii) {
  const Folder folder;
  const Scene s =
      import_text(folder, "a.ply",
                  "ply\r\nformat ascii 1.0\ncomment made by hand\nelement vertex 5\nproperty float x\n"
                  "property float y\nproperty float z\nproperty uchar red\nproperty uchar green\n"
                  "property uchar blue\nelement face 2\nproperty list uchar int vertex_indices\nend_header\n"
                  "0 0 0 255 0 0\n2 0 0 255 0 0\n2 2 0 255 0 0\n1 0.5 0 255 0 0\n9 9 9 0 0 0\n"
                  "4 0 1 2 3\n3 0 1 4\n");
  EXPECT_EQ(s.vertex_count(), 5u);
  EXPECT_EQ(s.triangle_count(), 3u);  // the arrowhead takes two
  EXPECT_EQ(Shorts(s.colors.begin(), s.colors.begin() + 4), (Shorts{65535, 0, 0, 65535}));
  EXPECT_THAT(s.materials[0].base_color, Each(1.0f));
  EXPECT_THAT(s.triangle_material, Each(0u));
}

TEST(Ply, BinaryOfBothKinds) {
  const Folder folder;
  for (const bool big : {false, true}) {
    std::string file = std::string("ply\nformat binary_") + (big ? "big" : "little") +
                       "_endian 1.0\nelement vertex 3\nproperty double x\nproperty double y\nproperty double z\n"
                       "property float nx\nproperty float ny\nproperty float nz\nproperty float confidence\n"
                       "element face 1\nproperty uchar flags\nproperty list uint8 uint32 vertex_index\nend_header\n";
    for (const auto& p : {std::array<double, 3>{0, 0, 0}, {1, 0, 0}, {0, 1, 0}})
      file += raw<double>({p[0], p[1], p[2]}, big) + raw<float>({0, 0, 2, 1}, big);
    file += "\7\3" + raw<std::uint32_t>({0, 1, 2}, big);
    const Scene s = import_text(folder, "b.ply", file);
    EXPECT_THAT(s.positions, ElementsAre(0, 0, 0, 1, 0, 0, 0, 1, 0));
    EXPECT_THAT(s.normals, ElementsAre(0, 0, 1, 0, 0, 1, 0, 0, 1));
    EXPECT_THAT(s.indices, ElementsAre(0, 1, 2));
    EXPECT_THAT(s.warnings, Contains(HasSubstr("properties beside")));
  }
}

TEST(Ply, StripsAndPoints) {
  const Folder folder;
  const std::string vertices =
      "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n";
  const std::string points = "0 0 0\n0 1 0\n1 0 0\n1 1 0\n";
  const Scene s = import_text(folder, "s.ply",
                              vertices + "element tristrips 1\nproperty list int int vertex_indices\nend_header\n" +
                                  points + "8 0 1 2 3 -1 3 2 1\n");
  EXPECT_THAT(s.indices, ElementsAre(0, 1, 2, 1, 3, 2, 3, 2, 1));
  const Scene cloud = import_text(folder, "p.ply", vertices + "end_header\n" + points);
  EXPECT_EQ(cloud.triangle_count(), 0u);
  EXPECT_THAT(cloud.warnings, Contains(HasSubstr("points without faces")));
}

TEST(Ply, BadOnesAreNamed) {
  const Folder folder;
  const std::string head =
      "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
      "element face 1\nproperty list uchar int vertex_indices\nend_header\n";
  const std::pair<std::string, std::string> cases[] = {
      {"plx\n", "the word ply"},
      {"ply\nend_header\n", "a format"},
      {"ply\nformat ascii 1.0\n", "end_header"},
      {"ply\nformat utf 1.0\nend_header\n", "binary_little_endian"},
      {"ply\nformat ascii 1.0\nelement vertex -1\nend_header\n", "a number of elements"},
      {"ply\nformat ascii 1.0\nelement vertex 4000000000\nproperty float x\nproperty float y\nproperty float "
       "z\nend_header\n",
       "as many as"},
      {"ply\nformat ascii 1.0\nelement vertex 1\nproperty colour x\nend_header\n", "type and name"},
      {"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nend_header\n1\n", "x, y and z"},
      {head + "0 0 0\n1 0 0\n0 1 0\n3 0 1 3\n", "a vertex below 3"},
      {head + "0 0 0\n1 0 0\n0 1 0\n3 0 1\n", "data"},
      {head + "0 0 0\n1 0 0\n0 1 0\n4000000 0 1 2\n", "a list within the file"},
      {head + "0 0 0\n1 x 0\n0 1 0\n3 0 1 2\n", "a number"},
      {head + "0 0 0\n1 nan 0\n0 1 0\n3 0 1 2\n", "finite coordinates"},
  };
  for (const auto& [text, word] : cases)
    EXPECT_THAT(refusal(folder.write("b.ply", text)), AllOf(HasSubstr("expected"), HasSubstr(word))) << text;
}

std::string binary_stl(std::uint32_t count, const std::string& head = "made by hand") {
  std::string file = head;
  file.resize(80);
  file += raw<std::uint32_t>({count});
  for (std::uint32_t t = 0; t < count; ++t)
    file += raw<float>({0, 0, 1, 0, 0, float(t), 1, 0, float(t), 0, 1, float(t)}) + std::string(2, '\0');
  return file;
}

TEST(Stl, BinaryWhateverItsHeadSays) {
  const Folder folder;
  for (const char* head : {"made by hand", "solid in name only"}) {
    const Scene s = import_text(folder, "b.stl", binary_stl(2, head));
    EXPECT_THAT(s.positions, ElementsAre(0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1, 1, 0, 1, 0, 1, 1)) << head;
    EXPECT_EQ(s.meshes.size(), 1u);
  }
  EXPECT_THAT(import_text(folder, "m.stl", binary_stl(1) + "more").warnings, Contains(HasSubstr("4 bytes after")));
  EXPECT_THAT(refusal(folder.write("c.stl", binary_stl(3).substr(0, 200))), HasSubstr("150 bytes of 3 triangles"));
}

TEST(Stl, Ascii) {
  const Folder folder;
  const std::string facet =
      " facet normal 0 0 1\n  outer loop\n   vertex 0 0 0\n   vertex 1 0 0\n   vertex 0 1 0\n  endloop\n endfacet\n";
  const Scene s = import_text(
      folder, "a.stl", "solid left part\n" + facet + facet + "endsolid left part\nsolid\n" + facet + "endsolid\n");
  ASSERT_EQ(s.meshes.size(), 2u);
  EXPECT_EQ(s.meshes[0].name, "left part");
  EXPECT_EQ(s.meshes[0].triangle_count, 2u);
  EXPECT_EQ(s.triangle_count(), 3u);
  EXPECT_THAT(refusal(folder.write("d.stl", "solid x\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nendloop\n")),
              HasSubstr("3 vertices"));
  EXPECT_THAT(refusal(folder.write("e.stl", "solid x\nfacet normal 0 0 1\nouter loop\nvertex 0 zero 0\n")),
              HasSubstr("a finite number"));
  EXPECT_THAT(refusal(folder.write("f.stl", "solid x\nwhatever comes next\n")), HasSubstr("the words of an STL file"));
}

TEST(Stl, WhatProgramsWrite) {
  const Folder folder;
  const auto triangles = [&](const std::string& bytes) { return import_text(folder, "p.stl", bytes).triangle_count(); };
  const std::string facet =
      "facet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\n";
  const std::string text = "solid part\n" + facet + "endsolid part\n";
  for (const char* end : {"\r", "\r\n", " "}) {
    std::string other;
    for (const char c : text) c == '\n' ? other += end : other += c;
    EXPECT_EQ(triangles(other), 1u) << int(end[0]);
  }
  std::string upper = text;
  for (char& c : upper) c = static_cast<char>(std::toupper(c));
  EXPECT_EQ(triangles(upper), 1u);
  EXPECT_EQ(triangles("\xef\xbb\xbf\n  " + text), 1u);
  EXPECT_THAT(import_text(folder, "c.stl", "solid part\n" + facet).warnings, Contains(HasSubstr("no endsolid")));
  std::string apart = text;
  for (const char* word : {"loop\nendf", "facet\nends", "solid part\n"}) apart.insert(apart.rfind(word), 1, ' ');
  const Scene of_words = import_text(folder, "w.stl", apart);
  EXPECT_EQ(of_words.triangle_count(), 1u);
  EXPECT_THAT(of_words.warnings, testing::Not(Contains(HasSubstr("no endsolid"))));
  // Binary, whatever the head says and however the length is wrong.
  EXPECT_EQ(triangles(binary_stl(2, "solid " + std::string(74, ' ')) + "\n"), 2u);
  EXPECT_THAT(refusal(folder.write("d.stl", binary_stl(2, "solid part").substr(0, 150))), HasSubstr("bytes of 2"));
  std::string uncounted = binary_stl(2);
  uncounted[80] = 0;
  EXPECT_EQ(triangles(uncounted), 2u);
  std::string colored = binary_stl(1);
  colored.back() = '\x84';
  EXPECT_THAT(import_text(folder, "e.stl", colored).warnings, Contains(HasSubstr("attributes")));
}

TEST(Ply, WhatScannersWrite) {
  const Folder folder;
  const std::string head =
      "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
      "property float red\nproperty float green\nproperty float blue\nelement face 1\n"
      "property list uchar int vertex_indices\nend_header\n";
  const std::string body = "0 0 0 255 128 0\n1 0 0 255 128 0\n0 1 0 255 128 0\nnan nan nan 0 0 0\n";
  Scene s = import_text(folder, "a.ply", "\xef\xbb\xbf" + head + body + "3 0 1 2\n");
  EXPECT_EQ(s.triangle_count(), 1u);  // the point without a place is no corner
  EXPECT_THAT(s.warnings, Contains(HasSubstr("without a place")));
  for (const float c : s.positions) EXPECT_TRUE(c >= 0 && c <= 1);
  EXPECT_NEAR(s.colors[1], 65535 * 0.2159, 20);  // colours up to 255, as floats
  EXPECT_THAT(refusal(folder.write("b.ply", head + body + "3 0 1 3\n")), HasSubstr("finite coordinates"));
  // Lines that end with CR alone, before data that begins with the byte of an LF.
  std::string binary =
      "ply\rformat binary_little_endian 1.0\relement vertex 3\rproperty uchar x\rproperty uchar y\r"
      "property uchar z\relement face 1\rproperty list uchar uchar vertex_indices\rend_header\r";
  binary += std::string("\n\0\0\1\0\0\0\1\0\3\0\1\2", 13);
  s = import_text(folder, "c.ply", binary);
  EXPECT_THAT(s.positions, ElementsAre(10, 0, 0, 1, 0, 0, 0, 1, 0));
  EXPECT_THAT(s.indices, ElementsAre(0, 1, 2));
  // Blender 2.47 wrote its comment without that word.
  std::string by_blender = head + body + "3 0 1 2\n";
  by_blender.insert(by_blender.find("element"), "Created by Blender3D 247 - www.blender.org, source file: \n");
  s = import_text(folder, "d.ply", by_blender);
  EXPECT_EQ(s.triangle_count(), 1u);
  EXPECT_THAT(s.warnings, Contains(AllOf(HasSubstr("Created by Blender3D"), HasSubstr("passed over"))));
}

// --- OBJ of many programs --------------------------------------------------------------------------------------------

class PeoplesObj : public testing::Test {
 protected:
  Scene read(const std::string& text, const std::string& mtl = "") {
    if (!mtl.empty()) folder_.write("m.mtl", mtl);
    return import_text(folder_, "scene.obj", text);
  }
  const std::string square_ = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n";
  Folder folder_;
};

TEST_F(PeoplesObj, MarksAndLineEnds) {
  for (const char* end : {"\n", "\r\n", "\r"}) {
    std::string text = "\xef\xbb\xbfv 2 0 0\nv 1 0 0\nv 1 1 0\nf 1 2 3\n# art \\\nv 9 9 9", other;
    for (const char c : text) c == '\n' ? other += end : other += c;
    const Scene s = read(other);
    EXPECT_THAT(s.positions, ElementsAre(2, 0, 0, 1, 0, 0, 1, 1, 0));
  }
  EXPECT_EQ(read("\xef\xbb\xbfmtllib m.mtl\n" + square_ + "usemtl a\nf 1 2 3\n", "\xef\xbb\xbfnewmtl a\nKe 1 2 3\n")
                .materials[0]
                .emission[1],
            2);
}

TEST_F(PeoplesObj, ContinuedLines) {
  const std::string library = "newmtl a\nKe 1 0 0\n";
  Scene s = read("mtllib \\\nm.mtl\n" + square_ + "usemtl a\nf 1 2 \\ \n 3 4\n", library);
  EXPECT_EQ(s.triangle_count(), 2u);
  EXPECT_EQ(s.materials[0].emission[0], 1);
  // A backslash that ends a name continues nothing where a statement follows.
  s = read("mtllib m.mtl\ng C:\\parts\\\nusemtl a\n" + square_ + "f 1 2 3\n", library);
  EXPECT_EQ(s.meshes[0].name, "C:\\parts\\");
  EXPECT_EQ(s.materials[0].emission[0], 1);
}

TEST_F(PeoplesObj, LibrariesAndNamesOfAllKinds) {
  folder_.write("a b.mtl", "newmtl red # the first\nKe 1 0 0\n");
  folder_.write("c.mtl", "newmtl gr\xfcn\nKe 0 1 0\n");
  const std::string faces = square_ + "usemtl red\nf 1 2 3\nusemtl gr\xc3\xbcn\nf 1 3 4\n";
  Scene s = read("mtllib a b.mtl c.mtl\n" + faces);
  EXPECT_EQ(s.materials.at(0).emission[0], 1);  // the comment stands in the library alone
  EXPECT_EQ(s.materials.at(1).emission[1], 1);  // UTF-8 here, Latin-1 there
  EXPECT_EQ(read("mtllib \"a b.mtl\"\n" + faces).materials.at(0).emission[0], 1);
  for (const char* path : {"C:\\me\\c.mtl", "/home/me/c.mtl"}) {
    s = read(std::string("mtllib ") + path + "\n" + faces);
    EXPECT_EQ(s.materials.at(1).emission[1], 1) << path;
    EXPECT_THAT(s.warnings, Contains(HasSubstr("an absolute path")));
  }
  folder_.write("empty.mtl", "");
  EXPECT_THAT(read("mtllib empty.mtl\n" + faces).warnings, Contains(HasSubstr("an empty file")));
}

TEST_F(PeoplesObj, WhatIsNoNumber) {
  const Scene s = read(square_ + "vn nan -nan(ind) 1.#QNAN\nvt 1.#IND inf\nf 1/1/1 2/1/1 3/1/1\n");
  EXPECT_EQ(s.triangle_count(), 1u);
  EXPECT_THAT(s.normals, Each(0.0f));
  EXPECT_THAT(s.warnings, Contains(HasSubstr("line 5: vn: not a finite number")));
  EXPECT_THAT(s.warnings, Contains(HasSubstr("line 6: vt: not a finite number")));
  EXPECT_EQ(read("mtllib m.mtl\n" + square_ + "usemtl a\nf 1 2 3\n", "newmtl a\nd 1.0000001\n").materials[0].alpha, 1);
  // Vertices that are not there, and maps without a name.
  const Scene holes = read("v nan nan nan\nv 1.#QNAN 0 0\n" + square_ + "f 3 4 5\n");
  EXPECT_EQ(holes.triangle_count(), 1u);
  EXPECT_THAT(holes.warnings, Contains(HasSubstr("line 1: v: without a place")));
  EXPECT_THAT(refusal(folder_.write("h.obj", "v nan 0 0\n" + square_ + "f 1 2 3\n")), HasSubstr("finite coordinates"));
  EXPECT_THAT(read("mtllib m.mtl\n" + square_ + "usemtl a\nf 1 2 3\n", "newmtl a\nmap_Kd\n").warnings,
              Contains(HasSubstr("line 2: map_Kd: no file's name")));
  folder_.write("lib/readme", "");
  EXPECT_THAT(read("mtllib lib\n" + square_ + "f 1 2 3\n").warnings, Contains(HasSubstr("mtllib lib: a folder")));
  // A colour of a little more than 1 does not make counts of 255 of all.
  EXPECT_GT(read("v 0 0 0 1.01 0.5 0\nv 1 0 0 1 1 1\nv 1 1 0 1 1 1\nf 1 2 3\n").colors[1], 10000);
}

TEST_F(PeoplesObj, PolygonsWithSpikesAndKnots) {
  const auto area = [](const Scene& s) {
    double sum = 0;
    for (std::size_t t = 0; t < s.triangle_count(); ++t) {
      const float* p[3];
      for (std::size_t k = 0; k < 3; ++k) p[k] = &s.positions[3 * std::size_t(s.indices[3 * t + k])];
      sum += std::abs((p[1][0] - p[0][0]) * (p[2][1] - p[0][1]) - (p[1][1] - p[0][1]) * (p[2][0] - p[0][0])) / 2;
    }
    return sum;
  };
  const Scene s = read("v 0 0 0\nv 4 0 0\nv 6 0 0\nv 4 0 0\nv 4 2 0\nv 0 2 0\nf 1 2 3 4 5 6\n");
  EXPECT_NEAR(area(s), 8, 1e-6);  // the spike to x = 6 encloses nothing
  EXPECT_THAT(s.warnings, testing::Not(Contains(HasSubstr("crosses"))));
  EXPECT_THAT(read("v 0 0 0\nv 2 2 0\nv 2 0 0\nv 0 2 0\nf 1 2 3 4\n").warnings, Contains(HasSubstr("crosses itself")));
}

TEST_F(PeoplesObj, TextureOptionsBehindTheName) {
  folder_.write_image("my wood.png", 1, 1, 3, {1, 1, 1});
  const Scene s = read("mtllib m.mtl\n" + square_ + "vt 0 0\nusemtl m\nf 1/1 2/1 3/1\n",
                       "newmtl m\nmap_Kd my wood.png -s 2 3 1 -o 0.25 0.5\n");
  ASSERT_EQ(s.textures.size(), 1u);
  EXPECT_THAT(s.textures[0].transform, ElementsAre(2, 0, 0.25f, 0, 3, -2.5f));
}

TEST_F(PeoplesObj, NumberSignsAreParts) {
  const Scene s = read("mtllib m.mtl # the library\n" + square_ +
                           "o part #1\nusemtl Material #25\nf 1 2 3 # front\nusemtl Material #26\nf 1 3 4#back\n"
                           "usemtl plain # a comment\nf 1 2 4\n",
                       "newmtl Material #25\nKe 1 0 0\nnewmtl Material #26\nKe 0 0 1\nnewmtl plain\nKe 0 1 0\n");
  EXPECT_EQ(s.meshes[0].name, "part #1");
  EXPECT_EQ(s.materials.size(), 3u);
  EXPECT_EQ(s.materials[0].emission[0], 1);
  EXPECT_EQ(s.materials[1].emission[2], 1);
  EXPECT_EQ(s.materials[2].emission[1], 1);
}

TEST_F(PeoplesObj, ColouredVertices) {
  const Scene s = read("v 0 0 0 1 0.5 0\nv 1 0 0 1 1 1\nv 1 1 0\nv 0 1 0 1.0\nf 1 2 3\n");
  ASSERT_EQ(s.colors.size(), 12u);
  EXPECT_EQ(s.colors[0], 65535);
  EXPECT_NEAR(s.colors[1], 65535 * 0.21404, 2);  // sRGB
  EXPECT_EQ(s.colors[8], 65535);                 // no colour: white
  EXPECT_THAT(s.materials[0].base_color, Each(1.0f));
  EXPECT_NEAR(read("v 0 0 0 255 128 0\nv 1 0 0 0 0 0\nv 1 1 0 0 0 0\nf 1 2 3\n").colors[1], 65535 * 0.2159, 20);
}

TEST_F(PeoplesObj, WhatIsNotThereIsGrey) {
  Scene s = read("mtllib gone.mtl\n" + square_ + "usemtl a\nf 1 2 3\n");
  EXPECT_THAT(s.materials[0].base_color, Each(0.8f));
  EXPECT_THAT(s.warnings, Contains(AllOf(HasSubstr("line 1: mtllib gone.mtl"), HasSubstr("no such file"))));
  s = read("mtllib m.mtl\n" + square_ + "usemtl blue\nf 1 2 3\nf 1 2\n", "newmtl red\nKd 1 0 0\n");
  EXPECT_THAT(s.materials[0].base_color, Each(0.8f));
  EXPECT_THAT(s.warnings, Contains(AllOf(HasSubstr("line 6: usemtl"), HasSubstr("\"blue\""))));
  EXPECT_THAT(s.warnings, Contains(HasSubstr("fewer than 3 corners")));
  s = read(square_ + "f 1/1/1 2/2/2 3/3/3\n");
  EXPECT_THAT(s.indices, ElementsAre(0, 1, 2));
  EXPECT_THAT(s.warnings, Contains(HasSubstr("line 5: f: names texture vertices, of which the file has none")));
}

TEST_F(PeoplesObj, WhollyTransparentMaterialsAreSaid) {
  const auto warnings = [&](const std::string& properties) {
    return read("mtllib m.mtl\n" + square_ + "usemtl m\nf 1 2 3\n", "newmtl m\n" + properties + "\n").warnings;
  };
  EXPECT_THAT(warnings("Tr 1"), Contains(AllOf(HasSubstr("material m"), HasSubstr("wholly transparent (Tr 1"))));
  EXPECT_THAT(warnings("d 0"), Contains(HasSubstr("wholly transparent (d 0)")));
  EXPECT_THAT(warnings("d 1\nTr 1"), Contains(HasSubstr("d and Tr disagree: d is taken")));
  EXPECT_THAT(warnings("d 0.25\nTr 0.75"), testing::Not(Contains(HasSubstr("transparent"))));
}

TEST_F(PeoplesObj, PhysicalMaterials) {
  folder_.write_image("rough.png", 2, 1, 1, {0, 1});
  folder_.write_image("metal.png", 1, 1, 1, {0.2f});
  folder_.write_image("glow.png", 1, 1, 3, {1, 0, 0});
  const Scene s =
      read("mtllib m.mtl\n" + square_ + "vt 0 0\nusemtl m\nf 1/1 2/1 3/1\n",
           "newmtl m\nKd 1 1 1\nPr 0.5\nPm 1\nNi 1.4\nmap_Pr rough.png\nmap_Pm metal.png\nmap_Ke glow.png\n");
  const Material& m = s.materials[0];
  EXPECT_FLOAT_EQ(m.roughness, 0.5f);
  EXPECT_FLOAT_EQ(m.metallic, 1);
  EXPECT_FLOAT_EQ(m.specular, 1);
  EXPECT_FLOAT_EQ(m.ior, 1.4f);
  EXPECT_THAT(m.emission, Each(1.0f));  // a map without Ke
  const Texture& t = s.textures[m.metallic_roughness_texture];
  ASSERT_EQ(t.width, 2u);
  EXPECT_EQ(s.texels[t.first_texel], 0xff3300ffu);  // roughness 0 in green, metallic 51 in blue
  EXPECT_EQ(s.texels[t.first_texel + 1], 0xff33ffffu);
  EXPECT_FALSE(t.flags & GLEANER_TEXTURE_SRGB);
}

TEST_F(PeoplesObj, TextureOptions) {
  folder_.write_image("my wood.png", 1, 1, 3, {1, 1, 1});
  folder_.write_image("height.png", 4, 1, 1, {0, 0.2f, 0.4f, 0.2f});
  folder_.write_image("hole.png", 2, 1, 1, {1, 0});
  const Scene s =
      read("mtllib m.mtl\n" + square_ + "vt 0 0\nusemtl m\nf 1/1 2/1 3/1\n",
           "newmtl m\nmap_Kd -o 0.25 0.5 -s 2 3 1 my wood.png\nmap_Bump -bm 50 height.png\nmap_d hole.png\n");
  const Material& m = s.materials[0];
  const Texture& t = s.textures[m.base_color_texture];
  // (u, v) -> (2 u + 0.25, 3 v + 0.5) from the bottom: from the top, 1 - v goes to 1 - (3 v + 0.5).
  EXPECT_THAT(t.transform, ElementsAre(2, 0, 0.25f, 0, 3, -2.5f));
  EXPECT_EQ(s.texels[t.first_texel] >> 24, 255u);  // map_d's red is the opacity
  EXPECT_EQ(s.texels[t.first_texel + 1] >> 24, 0u);
  EXPECT_TRUE(m.flags & GLEANER_MATERIAL_ALPHA_BLEND);
  const Texture& bump = s.textures[m.normal_texture];
  const auto x_of = [&](std::uint32_t i) { return int(s.texels[bump.first_texel + i] & 255) - 128; };
  EXPECT_LT(x_of(1), -20);  // it rises to the right, so that its normal leans to the left
  EXPECT_GT(x_of(3), 20);
  EXPECT_NEAR(x_of(2), 0, 1);
}

TEST_F(PeoplesObj, PathsOfOtherMachines) {
  folder_.write_image("wood.png", 1, 1, 3, {1, 1, 1});
  const std::string obj = "mtllib m.mtl\n" + square_ + "usemtl m\nf 1 2 3\n";
  const Scene s = read(obj, "newmtl m\nmap_Kd C:\\Users\\me\\wood.png\n");
  EXPECT_EQ(s.textures.size(), 1u);
  EXPECT_THAT(s.warnings, Contains(HasSubstr("an absolute path")));
  EXPECT_EQ(read(obj, "newmtl m\nmap_Kd Wood.PNG\n").textures.size(), 1u);
}

}  // namespace
}  // namespace gleaner::scene

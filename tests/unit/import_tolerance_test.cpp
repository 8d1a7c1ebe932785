// What people's exporters get wrong without harm: it costs a warning, and with `strict` it is an error.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <functional>

#include "import_files.h"
#include "scene/import/import.h"
#include "scene/model/error.h"

namespace gleaner::scene {
namespace {

using nlohmann::json;
using testing::AllOf;
using testing::Contains;
using testing::Each;
using testing::ElementsAre;
using testing::FloatNear;
using testing::HasSubstr;
using testing::Not;
using testing::Pointwise;

using Floats = std::vector<float>;

struct Case {
  const char* what;
  std::function<void(GltfFile&)> change;
  std::string warning;  // what one warning says; empty: none is made
  std::size_t triangles = 1;
};

TEST(Tolerance, OfGltf) {
  const Case cases[] = {
      {"whole numbers with a point",
       [](GltfFile& f) {
         f.json["nodes"][0]["mesh"] = 0.0;
         f.json["accessors"][0]["count"] = 3.0;
         f.json["accessors"][0]["componentType"] = 5126.0;
         f.json["bufferViews"][0]["byteLength"] = 36.0;
         f.json["scene"] = 0.0;
       },
       ""},
      {"a version that is a number", [](GltfFile& f) { f.json["asset"]["version"] = 2.0; }, ""},
      {"a later version that 2.0 suffices for",
       [](GltfFile& f) {
         f.json["asset"] = {{"version", "2.7"}, {"minVersion", "2.0"}};
       },
       ""},
      {"a part without positions",
       [](GltfFile& f) {
         json part = f.primitive();
         part["attributes"].erase("POSITION");
         f.json["meshes"][0]["primitives"].push_back(part);
       },
       "meshes[0].primitives[1]: a primitive without POSITION"},
      {"seven corners",
       [](GltfFile& f) {
         f.primitive()["indices"] = f.add<std::uint16_t>({0, 1, 2, 0, 1, 2, 0}, 5123, "SCALAR");
       },
       "7 corners", 2},
      {"two corners",
       [](GltfFile& f) {
         f.primitive()["indices"] = f.add<std::uint16_t>({0, 1}, 5123, "SCALAR");
       },
       "no triangles", 0},
      {"a last row that was rounded",
       [](GltfFile& f) { f.json["nodes"][0]["matrix"] = {1, 0, 0, 0, 0, 1, 0, 1e-9, 0, 0, 1, 0, 0, 0, 0, 0.9999999}; },
       "nodes[0].matrix: the last row"},
      {"a mesh scaled to nothing",
       [](GltfFile& f) {
         f.json["nodes"][0]["scale"] = {0, 0, 0};
       },
       ""},
      {"a camera scaled to nothing",
       [](GltfFile& f) {
         f.json["cameras"] = {{{"type", "perspective"}, {"perspective", {{"yfov", 1}}}}};
         f.json["nodes"].push_back({{"camera", 0}, {"scale", {1, 1, 0}}});
         f.json["scenes"][0]["nodes"] = {0, 1};
       },
       "nodes[1]: a camera under a node scaled to 0"},
      {"foreign extras",
       [](GltfFile& f) {
         f.json["cameras"] = {{{"type", "perspective"},
                               {"perspective", {{"yfov", 1}}},
                               {"extras", {{"width", "wide"}, {"height", -3}}}}};
         f.json["nodes"][0]["camera"] = 0;
         f.json["extras"] = {{"extensions", {{"deep", {{"deeper", json::array({json::array({json::array()})})}}}}}};
         f.json["materials"][0]["extras"] = "mine";
       },
       ""},
      {"an extension that is used but not declared",
       [](GltfFile& f) { f.json["materials"][0]["extensions"]["KHR_materials_dispersion"]["dispersion"] = 1; },
       "KHR_materials_dispersion is not read"},
      {"members that are null",
       [](GltfFile& f) {
         f.json["nodes"][0]["skin"] = nullptr;
         f.json["nodes"][0]["camera"] = nullptr;
         f.json["materials"][0]["name"] = nullptr;
       },
       "materials[0].name: null is taken as absent"},
      {"extensions that are an empty array", [](GltfFile& f) { f.json["nodes"][0]["extensions"] = json::array(); },
       "nodes[0].extensions: an empty array is taken as absent"},
      {"factors rounded beyond their range",
       [](GltfFile& f) {
         f.json["materials"][0]["pbrMetallicRoughness"] = {{"roughnessFactor", 1.0000001},
                                                           {"baseColorFactor", {0.5, 0.5, 0.5, -1e-9}}};
       },
       "materials[0].pbrMetallicRoughness.roughnessFactor: a little more than 1"},
      {"a camera without an aspect ratio",
       [](GltfFile& f) {
         f.json["cameras"] = {{{"type", "perspective"}, {"perspective", {{"yfov", 1}, {"aspectRatio", 0}}}}};
       },
       "cameras[0].perspective.aspectRatio: 0 is taken"},
      {"a light without a range",
       [](GltfFile& f) {
         f.json["extensions"]["KHR_lights_punctual"]["lights"] = {{{"type", "point"}, {"range", 0}}};
       },
       "lights[0].range: 0 is taken"},
      {"a node listed twice",
       [](GltfFile& f) {
         f.json["scenes"][0]["nodes"] = {0, 0};
       },
       "scenes[0].nodes: a node that is listed twice"},
      {"names in Latin-1", [](GltfFile& f) { f.json["nodes"][0]["name"] = "M@hle"; }, "JSON: not UTF-8"},
  };
  const Folder folder;
  for (const Case& c : cases) {
    GltfFile file = triangle_file();
    c.change(file);
    std::string bytes = file.glb();
    if (const std::size_t at = bytes.find("M@hle"); at != std::string::npos) bytes[at + 1] = '\xfc';
    const std::string path = folder.write("scene.glb", bytes);
    ImportOptions options;
    options.needs_camera = false;
    const Scene s = import_scene(path, options);
    EXPECT_EQ(s.triangle_count(), c.triangles) << c.what;
    options.strict = true;
    if (c.warning.empty()) {
      EXPECT_THAT(s.warnings, testing::IsEmpty()) << c.what;
      EXPECT_NO_THROW(import_scene(path, options)) << c.what;
    } else {
      EXPECT_THAT(s.warnings, Contains(HasSubstr(c.warning))) << c.what;
      EXPECT_THROW(import_scene(path, options), Error) << c.what;
    }
  }
}

TEST(Tolerance, BytesAfterTheEndOfAGlb) {
  const Folder folder;
  const std::string good = triangle_file().glb();
  for (const std::string& more : {std::string("\n"), std::string(1000, '\0'), good}) {
    const Scene s = import_text(folder, "more.glb", good + more);
    EXPECT_EQ(s.triangle_count(), 1u);
    EXPECT_THAT(s.warnings, Contains(HasSubstr(std::to_string(more.size()) + " bytes after its end")));
  }
}

TEST(Tolerance, TextThatIsCalledBinary) {
  const Folder folder;
  EXPECT_THAT(import_text(folder, "text.glb", triangle_file().gltf()).warnings,
              Contains(HasSubstr("the file is JSON")));
  EXPECT_THAT(refusal(folder.write("bad.glb", "PK\3\4")), HasSubstr("the magic"));
}

TEST(Tolerance, UrisThatNobodyEncoded) {
  const Folder folder;
  GltfFile file = triangle_file();
  folder.write("100%.bin", file.binary);
  file.json["buffers"] = {{{"byteLength", file.binary.size()}, {"uri", "100%.bin"}}};
  EXPECT_EQ(import_text(folder, "s.gltf", file.json.dump()).triangle_count(), 1u);
  std::string text = triangle_file().gltf();
  const std::size_t digits = text.find(";base64,");
  ASSERT_NE(digits, text.npos);
  text.replace(digits, 8, ";BASE64,");
  text.insert(digits + 20, "\\r\\n");
  EXPECT_EQ(import_text(folder, "t.gltf", text).triangle_count(), 1u);
}

TEST(Tolerance, TextsInOtherEncodings) {
  const Folder folder;
  const std::string text = triangle_file().gltf();
  EXPECT_EQ(import_text(folder, "mark.gltf", "\xef\xbb\xbf" + text).triangle_count(), 1u);
  std::string wide = "\xff\xfe";
  for (const char c : text) wide.append({c, '\0'});
  EXPECT_THAT(refusal(folder.write("wide.gltf", wide)), HasSubstr("UTF-16"));
  EXPECT_THAT(refusal(folder.write("wide.obj", wide)), HasSubstr("UTF-16"));
}

TEST(Tolerance, FilesUnderAnotherSpelling) {
  const Folder folder;
  GltfFile file = triangle_file();
  folder.write("Parts/Data.BIN", file.binary);
  file.json["buffers"] = {{{"byteLength", file.binary.size()}, {"uri", "parts\\data.bin"}}};
  const Scene s = import_text(folder, "s.gltf", file.json.dump());
  EXPECT_THAT(s.warnings, Contains(AllOf(HasSubstr("buffers[0].uri"), HasSubstr("another spelling"))));
  file.json["buffers"][0]["uri"] = "Parts/..\\..\\data.bin";
  EXPECT_THAT(refusal(folder.write("t.gltf", file.json.dump())), HasSubstr("inside the scene's folder"));
}

// --- light units -----------------------------------------------------------------------------------------------------

class Units : public testing::Test {
 protected:
  // A point light of `candela`, as `generator` would write it, taken in `units`.
  Scene read(const std::string& generator, double candela, double lux, LightUnits units = LightUnits::automatic) {
    GltfFile f = triangle_file();
    f.json["asset"]["generator"] = generator;
    f.json["extensions"]["KHR_lights_punctual"]["lights"] = {{{"type", "point"}, {"intensity", candela}},
                                                             {{"type", "directional"}, {"intensity", lux}}};
    for (int i = 0; i < 2; ++i) {
      json node;
      node["extensions"]["KHR_lights_punctual"]["light"] = i;
      f.json["nodes"].push_back(node);
      f.json["scenes"][0]["nodes"].push_back(i + 1);
    }
    ImportOptions options;
    options.light_units = units;
    return import_scene(folder_.write("l.glb", f.glb()), options);
  }
  Folder folder_;
};

TEST_F(Units, BlendersAreDividedBy683) {
  const char* blender = "Khronos glTF Blender I/O v4.2.57";
  // 100 W, and a sun of 3 W/m^2.
  const Scene s = read(blender, 100 * 683 / (4 * M_PI), 3 * 683);
  EXPECT_NEAR(s.lights[0].intensity[0], 100 / (4 * M_PI), 1e-4);
  EXPECT_NEAR(s.lights[1].intensity[1], 3, 1e-5);
  EXPECT_THAT(s.warnings, Contains(AllOf(HasSubstr("683"), HasSubstr("--light-units radiometric"))));
  EXPECT_THAT(s.light_units, HasSubstr("photometric"));
  const Scene as_it_stands = read(blender, 100, 3, LightUnits::radiometric);
  EXPECT_FLOAT_EQ(as_it_stands.lights[0].intensity[0], 100);
  EXPECT_THAT(as_it_stands.warnings, Not(Contains(HasSubstr("683"))));
  // Its option without units: nothing in it is as bright as a tenth of a watt in candela.
  const Scene unitless = read(blender, 4, 3);
  EXPECT_FLOAT_EQ(unitless.lights[0].intensity[0], 4);
  EXPECT_THAT(unitless.warnings, Contains(HasSubstr("too dim")));
}

TEST_F(Units, OthersAreTakenAsTheyStand) {
  EXPECT_FLOAT_EQ(read("Gleaner", 5000, 1).lights[0].intensity[0], 5000);
  EXPECT_FLOAT_EQ(read("Gleaner", 683, 1366, LightUnits::photometric).lights[0].intensity[0], 1);
  EXPECT_FLOAT_EQ(read("Gleaner", 683, 1366, LightUnits::photometric).lights[1].intensity[0], 2);
  EXPECT_THROW(parse_light_units("lumen"), Error);
}

// --- far from the origin ---------------------------------------------------------------------------------------------

class Far : public testing::Test {
 protected:
  // Two nodes, a camera and a lamp, moved together by `by`.
  GltfFile moved(const std::vector<double>& by) {
    GltfFile f = triangle_file();
    f.json["cameras"] = {{{"type", "perspective"}, {"perspective", {{"yfov", 1}}}}};
    f.json["extensions"]["KHR_lights_punctual"]["lights"] = {{{"type", "point"}}};
    json lamp = {{"translation", {0.3, 0.4, 2.1}}};
    lamp["extensions"]["KHR_lights_punctual"]["light"] = 0;
    f.json["nodes"] = {{{"mesh", 0}, {"translation", {0.1, 0.2, 0.3}}},
                       {{"mesh", 0}, {"rotation", {0, 0, kHalf, kHalf}}},
                       {{"camera", 0}, {"translation", {0.5, 0.25, 3.7}}},
                       lamp,
                       {{"children", {0, 1, 2, 3}}, {"translation", by}}};
    f.json["scenes"][0]["nodes"] = {4};
    return f;
  }
  Folder folder_;
};

TEST_F(Far, TheWholeSceneIsMovedToItsCentre) {
  const Scene near = import_text(folder_, "near.glb", moved({0, 0, 0}).glb());
  EXPECT_EQ(near.origin, (std::array<double, 3>{}));
  const Scene far = import_text(folder_, "far.glb", moved({478500.25, 12.5, -5427300.75}).glb());
  EXPECT_NE(far.origin, (std::array<double, 3>{}));
  const std::array<double, 3> by = {478500.25, 12.5, -5427300.75};
  const auto expect_same = [&](const float* a, const float* b) {
    for (std::size_t c = 0; c < 3; ++c) EXPECT_NEAR(a[c] + by[c], b[c] + far.origin[c], 1e-6);
  };
  ASSERT_EQ(near.vertex_count(), far.vertex_count());
  for (std::size_t v = 0; v < near.vertex_count(); ++v) expect_same(&near.positions[3 * v], &far.positions[3 * v]);
  expect_same(near.cameras[0].camera.origin, far.cameras[0].camera.origin);
  expect_same(near.lights[0].position, far.lights[0].position);
  EXPECT_THAT(far.warnings, testing::IsEmpty());
}

TEST_F(Far, WhatTheFileItselfRoundedIsSaid) {
  GltfFile f = triangle_file();
  f.primitive()["attributes"]["POSITION"] = f.add<float>({5427300, 0, 0, 5427301, 0, 0, 5427300, 1, 0}, 5126, "VEC3");
  EXPECT_THAT(import_text(folder_, "r.glb", f.glb()).warnings,
              Contains(AllOf(HasSubstr("meshes[0].primitives[0]"), HasSubstr("precision"), HasSubstr("0.5 m"))));
  // In OBJ the digits say it.
  const std::string rough = "v 5.4273e+06 0 0\nv 5.4274e+06 0 0\nv 5.4273e+06 1 0\nf 1 2 3\n";
  EXPECT_THAT(import_text(folder_, "r.obj", rough).warnings, Contains(HasSubstr("are written to")));
  const std::string fine = "v 5427300.125 0 0\nv 5427301.25 0 0\nv 5427300.5 1.000 0\nf 1 2 3\n";
  const Scene s = import_text(folder_, "f.obj", fine);
  EXPECT_THAT(s.warnings, Not(Contains(HasSubstr("written to"))));
  EXPECT_FLOAT_EQ(s.positions[3] - s.positions[0], 1.125f);
}

TEST_F(Far, APartFarFromTheRestIsSaid) {
  GltfFile f = triangle_file();
  f.json["nodes"] = {{{"mesh", 0}}, {{"mesh", 0}, {"translation", {50000, 0, 0}}, {"scale", {0.1, 0.1, 0.1}}}};
  f.json["scenes"][0]["nodes"] = {0, 1};
  const Scene s = import_text(folder_, "p.glb", f.glb());
  EXPECT_THAT(s.warnings, Contains(HasSubstr("parts of the scene lie far from the origin")));
}

}  // namespace
}  // namespace gleaner::scene

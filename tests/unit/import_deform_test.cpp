// What glTF's core says of vertices beyond their positions: skins and morph targets at rest, colours, instances.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>

#include "import_files.h"
#include "scene/import/import.h"
#include "scene/model/error.h"

namespace gleaner::scene {
namespace {

using nlohmann::json;
using testing::AllOf;
using testing::Contains;
using testing::ElementsAre;
using testing::FloatNear;
using testing::HasSubstr;
using testing::Pointwise;

using Floats = std::vector<float>;
using Shorts = std::vector<std::uint16_t>;

class Deform : public testing::Test {
 protected:
  Scene read(const GltfFile& file) { return import_text(folder_, "scene.glb", file.glb()); }
  std::string refused(const GltfFile& file) { return refusal(folder_.write("scene.glb", file.glb())); }

  // The triangle under a skin of two joints, nodes 1 and 2; its own node, 0, stands elsewhere.
  GltfFile skinned(const Floats& weights) {
    GltfFile f = triangle_file();
    f.primitive()["attributes"]["NORMAL"] = f.add<float>({0, 0, 1, 0, 0, 1, 0, 0, 1}, 5126, "VEC3");
    f.primitive()["attributes"]["JOINTS_0"] = f.add<std::uint8_t>({0, 1, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0}, 5121, "VEC4");
    f.primitive()["attributes"]["WEIGHTS_0"] = f.add(weights, 5126, "VEC4");
    // Both bind matrices move by (-1, 0, 0).
    Floats bind;
    for (int j = 0; j < 2; ++j)
      for (const float x : {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, -1, 0, 0, 1}) bind.push_back(x);
    f.json["skins"] = {{{"joints", {1, 2}}, {"inverseBindMatrices", f.add(bind, 5126, "MAT4")}}};
    f.json["nodes"] = {{{"mesh", 0}, {"skin", 0}, {"translation", {100, 100, 100}}},
                       {{"translation", {1, 0, 5}}, {"children", {2}}},
                       {{"rotation", {0, 0, kHalf, kHalf}}}};  // a quarter turn about z
    f.json["scenes"][0]["nodes"] = {0, 1};
    return f;
  }

  Folder folder_;
};

TEST_F(Deform, SkinsStandAsTheirJointsDo) {
  // The first vertex follows joint 0, the second joint 1, the third both.
  const Scene s = read(skinned({1, 0, 0, 0, 0, 1, 0, 0, 0.5f, 0.5f, 0, 0}));
  // Joint 0: the bind matrix undone, and up by 5. Joint 1: (x, y) -> (1 - y, x - 1), and up by 5.
  EXPECT_THAT(s.positions, Pointwise(FloatNear(1e-6f), Floats{0, 0, 5, 1, 0, 5, 0, 0, 5}));
  EXPECT_THAT(s.normals, Pointwise(FloatNear(1e-6f), Floats{0, 0, 1, 0, 0, 1, 0, 0, 1}));
  EXPECT_THAT(s.warnings, testing::Not(Contains(HasSubstr("skin"))));
}

TEST_F(Deform, SkinsWithoutBindMatricesOrWithOddWeights) {
  GltfFile file = skinned({1, 0, 0, 0, 0, 2, 0, 0, 0, 0, 0, 0});
  file.json["skins"][0].erase("inverseBindMatrices");
  const Scene s = read(file);
  // Weights need not add up to 1; where there are none, the first joint is followed.
  EXPECT_THAT(s.positions, Pointwise(FloatNear(1e-6f), Floats{1, 0, 5, 1, 1, 5, 1, 1, 5}));
  EXPECT_THAT(s.warnings, Contains(HasSubstr("skin weights")));
}

TEST_F(Deform, BadSkinsAreNamed) {
  const Floats weights = {1, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0};
  GltfFile file = skinned(weights);
  file.json["skins"][0]["joints"] = {1, 7};
  EXPECT_THAT(refused(file), AllOf(HasSubstr("skins[0].joints[1]"), HasSubstr("7")));
  file = skinned({0, 1, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0});
  file.primitive()["attributes"]["JOINTS_0"] =
      file.add<std::uint8_t>({0, 9, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0}, 5121, "VEC4");
  EXPECT_THAT(refused(file), AllOf(HasSubstr("JOINTS_0"), HasSubstr("joints below 2"), HasSubstr("9 at vertex 0")));
  file = skinned(weights);
  file.primitive()["attributes"].erase("WEIGHTS_0");
  EXPECT_THAT(refused(file), HasSubstr("WEIGHTS_0 beside JOINTS_0"));
  file = skinned(weights);
  file.json["skins"][0]["joints"] = {1, 2, 1};
  EXPECT_THAT(refused(file), AllOf(HasSubstr("inverseBindMatrices"), HasSubstr("3 joints")));
  file = skinned(weights);
  file.json["skins"][0]["joints"] = json::array();
  file.json["skins"][0].erase("inverseBindMatrices");
  EXPECT_THAT(refused(file), AllOf(HasSubstr("skins[0].joints"), HasSubstr("at least one joint")));
}

TEST_F(Deform, MorphTargetsCountByTheirDefaultWeights) {
  GltfFile file = triangle_file();
  const std::size_t up = file.add<float>({0, 0, 1, 0, 0, 2, 0, 0, 3}, 5126, "VEC3");
  // A sparse target without a base: one vertex moves.
  const float moved[] = {10, 0, 0};
  const std::size_t index = file.add_view(std::string("\1", 1));
  const std::size_t values = file.add_view({reinterpret_cast<const char*>(moved), sizeof moved});
  file.json["accessors"].push_back({{"componentType", 5126},
                                    {"count", 3},
                                    {"type", "VEC3"},
                                    {"sparse",
                                     {{"count", 1},
                                      {"indices", {{"bufferView", index}, {"componentType", 5121}}},
                                      {"values", {{"bufferView", values}}}}}});
  file.primitive()["targets"] = {{{"POSITION", up}}, {{"POSITION", file.json["accessors"].size() - 1}}};
  EXPECT_THAT(read(file).positions, ElementsAre(0, 0, 0, 1, 0, 0, 0, 1, 0));  // no weights: 0
  file.json["meshes"][0]["weights"] = {2, 0.5};
  EXPECT_THAT(read(file).positions, ElementsAre(0, 0, 2, 6, 0, 4, 0, 1, 6));
  file.json["nodes"][0]["weights"] = {0, 1};  // the node's own go before
  EXPECT_THAT(read(file).positions, ElementsAre(0, 0, 0, 11, 0, 0, 0, 1, 0));
  file.primitive()["targets"][1]["POSITION"] = file.add<float>({1, 2, 3}, 5126, "VEC3");
  EXPECT_THAT(refused(file), AllOf(HasSubstr("targets[1].POSITION"), HasSubstr("as many elements as POSITION: 3")));
}

TEST_F(Deform, VertexColoursAreLinearFactors) {
  GltfFile file = triangle_file();
  file.primitive()["attributes"]["COLOR_0"] = file.add<float>({1, 0.5f, 0, 0, 0, 0, 1, 1, 1}, 5126, "VEC3");
  EXPECT_EQ(read(file).colors, (Shorts{65535, 32768, 0, 65535, 0, 0, 0, 65535, 65535, 65535, 65535, 65535}));
  file.primitive()["attributes"]["COLOR_0"] =
      file.add<std::uint8_t>({255, 0, 51, 102, 0, 0, 0, 0, 255, 255, 255, 255}, 5121, "VEC4");
  file.json["accessors"].back()["normalized"] = true;
  const Scene bytes = read(file);
  EXPECT_EQ(bytes.colors, (Shorts{65535, 0, 13107, 26214, 0, 0, 0, 0, 65535, 65535, 65535, 65535}));
  EXPECT_TRUE(needs_of(bytes).vertex_colors);
  EXPECT_FALSE(needs_of(bytes).alpha);  // the material is opaque
  file.json["materials"][0]["alphaMode"] = "BLEND";
  EXPECT_TRUE(needs_of(read(file)).alpha);
  // Beyond 0 to 1: a surface must not return more than it gets.
  file.primitive()["attributes"]["COLOR_0"] = file.add<float>({2, -1, 0, 1, 1, 1, 1, 1, 1}, 5126, "VEC3");
  EXPECT_EQ(read(file).colors[0], 65535);
  EXPECT_THAT(read(file).warnings, Contains(HasSubstr("vertex colours outside 0 to 1")));
  // White ones cost nothing.
  file.primitive()["attributes"]["COLOR_0"] = file.add(Floats(9, 1.0f), 5126, "VEC3");
  EXPECT_TRUE(read(file).colors.empty());
}

TEST_F(Deform, PrimitivesWithAndWithoutColoursMix) {
  GltfFile file = triangle_file();
  json plain = file.primitive();
  file.primitive()["attributes"]["COLOR_0"] = file.add(Floats(9, 0.0f), 5126, "VEC3");
  file.json["meshes"][0]["primitives"] = {plain, file.primitive(), plain};
  const Scene s = read(file);
  ASSERT_EQ(s.colors.size(), 36u);
  EXPECT_EQ(s.colors[0], 65535);
  EXPECT_EQ(s.colors[12], 0);
  EXPECT_EQ(s.colors[15], 65535);  // alpha
  EXPECT_EQ(s.colors[24], 65535);
}

TEST_F(Deform, InstancesStandWhereTheirAttributesSay) {
  GltfFile file = triangle_file();
  file.json["extensionsRequired"] = file.json["extensionsUsed"] = {"EXT_mesh_gpu_instancing"};
  json& attributes = file.json["nodes"][0]["extensions"]["EXT_mesh_gpu_instancing"]["attributes"];
  attributes["TRANSLATION"] = file.add<float>({1, 0, 0, 0, 2, 0}, 5126, "VEC3");
  attributes["SCALE"] = file.add<float>({1, 1, 1, 2, 2, 2}, 5126, "VEC3");
  // Rotations may be normalized bytes.
  attributes["ROTATION"] = file.add<std::int8_t>({0, 0, 0, 127, 0, 0, 90, 90}, 5120, "VEC4");
  file.json["accessors"].back()["normalized"] = true;
  file.json["nodes"][0]["translation"] = {0, 0, 7};
  const Scene s = read(file);
  EXPECT_THAT(s.positions,
              Pointwise(FloatNear(1e-5f), Floats{1, 0, 7, 2, 0, 7, 1, 1, 7, /**/ 0, 2, 7, 0, 4, 7, -2, 2, 7}));
  EXPECT_EQ(s.meshes.size(), 1u);
  attributes["SCALE"] = file.add<float>({1, 1, 1}, 5126, "VEC3");
  EXPECT_THAT(refused(file), HasSubstr("as many elements in each: 2"));
}

// A billion instances in a hundred bytes.
TEST_F(Deform, InstanceBombsAreRefused) {
  GltfFile file = triangle_file();
  json& attributes = file.json["nodes"][0]["extensions"]["EXT_mesh_gpu_instancing"]["attributes"];
  file.json["accessors"].push_back({{"componentType", 5126}, {"count", 1000000000}, {"type", "VEC3"}});
  attributes["TRANSLATION"] = file.json["accessors"].size() - 1;
  EXPECT_THAT(refused(file), AllOf(HasSubstr("TRANSLATION"), HasSubstr("at most 4194304 instances")));
  file.json["accessors"].back()["count"] = 4000000;
  EXPECT_THAT(refused(file), HasSubstr("without a bufferView"));
}

TEST_F(Deform, VariantsAreChosenByName) {
  GltfFile file = triangle_file();
  file.json["materials"].push_back({{"name", "red"}});
  file.json["extensions"]["KHR_materials_variants"]["variants"] = {{{"name", "plain"}}, {{"name", "festive"}}};
  file.primitive()["extensions"]["KHR_materials_variants"]["mappings"] = {{{"material", 1}, {"variants", {1}}}};
  const std::string path = folder_.write("v.glb", file.glb());
  const auto material = [&](const std::string& variant) {
    ImportOptions options;
    options.variant = variant;
    return import_scene(path, options).triangle_material.at(0);
  };
  EXPECT_EQ(material(""), 0u);
  EXPECT_EQ(material("plain"), 0u);  // not mapped: the primitive's own
  EXPECT_EQ(material("festive"), 1u);
  EXPECT_THAT(import_scene(path).variants, ElementsAre("plain", "festive"));
  try {
    material("sad");
    ADD_FAILURE();
  } catch (const Error& error) {
    EXPECT_THAT(error.what(), AllOf(HasSubstr("\"sad\""), HasSubstr("plain, festive")));
  }
}

}  // namespace
}  // namespace gleaner::scene

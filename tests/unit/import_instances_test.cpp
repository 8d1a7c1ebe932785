// Which meshes the glTF importer stores once, as instances, and which it copies; and that both are the same scene.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>

#include "import_files.h"
#include "scene/import/import.h"
#include "scene/library/bake.h"
#include "scene/model/needs.h"

namespace gleaner::scene {
namespace {

using nlohmann::json;

// A strip of so many triangles, with normals, under as many nodes as there are places.
GltfFile strip_file(std::size_t triangles, std::size_t places) {
  GltfFile file = triangle_file();
  std::vector<float> positions, normals;
  std::vector<std::uint32_t> indices;
  for (std::size_t v = 0; v < triangles + 2; ++v) {
    const float x = 0.01f * static_cast<float>(v / 2), z = v % 2 ? 0.1f : 0.0f;
    positions.insert(positions.end(), {x, 0.02f * std::sin(x), z});
    normals.insert(normals.end(), {0.6f, 0.8f, 0});
  }
  for (std::uint32_t t = 0; t < triangles; ++t)
    indices.insert(indices.end(), {t, t % 2 ? t + 2 : t + 1, t % 2 ? t + 1 : t + 2});
  file.primitive()["attributes"] = {{"POSITION", file.add(positions, 5126, "VEC3")},
                                    {"NORMAL", file.add(normals, 5126, "VEC3")}};
  file.primitive()["indices"] = file.add(indices, 5125, "SCALAR");
  file.json["nodes"] = json::array();
  file.json["scenes"][0]["nodes"] = json::array();
  for (std::size_t i = 0; i < places; ++i) {
    const double at = static_cast<double>(i);
    // Every third one mirrors, each is turned and stretched its own way.
    file.json["nodes"].push_back({{"mesh", 0},
                                  {"translation", {3 * std::sin(at), 0.1 * at, 3 * std::cos(at)}},
                                  {"rotation", {0, std::sin(at / 2), 0, std::cos(at / 2)}},
                                  {"scale", {1 + 0.1 * std::sin(at), i % 3 == 2 ? -1 : 1, 2}}});
    file.json["scenes"][0]["nodes"].push_back(i);
  }
  return file;
}

class ImportInstances : public testing::Test {
 protected:
  Scene read(const GltfFile& file, bool instances = true) {
    ImportOptions options;
    options.instances = instances;
    return import_scene(folder_.write("scene.glb", file.glb()), options);
  }

  Folder folder_;
};

TEST_F(ImportInstances, AreMadeWhereTheySpareEnough) {
  struct Case {
    std::size_t triangles, places;
    bool instanced;
  };
  // At least 256 triangles, and at least 50,000 more were they copied.
  const Case cases[] = {{256, 197, true},   {256, 196, false}, {255, 400, false},  {25'000, 3, true},
                        {24'999, 3, false}, {50'000, 2, true}, {49'999, 2, false}, {100'000, 1, false}};
  for (const Case& c : cases) {
    const Scene scene = read(strip_file(c.triangles, c.places));
    const std::string what = std::to_string(c.triangles) + " triangles in " + std::to_string(c.places) + " places";
    EXPECT_EQ(scene.instances.size(), c.instanced ? c.places : 0) << what;
    EXPECT_EQ(scene.triangle_count(), c.triangles * (c.instanced ? 1 : c.places)) << what;
    EXPECT_EQ(scene.effective_triangle_count(), c.triangles * c.places) << what;
    EXPECT_EQ(needs_of(scene).instances, c.instanced) << what;
  }
}

// What a scene of copies holds, instances made into copies hold: the same triangles, in the same order.
TEST_F(ImportInstances, StandWhereCopiesWould) {
  const GltfFile file = strip_file(1000, 60);
  const Scene instanced = read(file), copies = read(file, false);
  ASSERT_EQ(instanced.instances.size(), 60u);
  ASSERT_TRUE(copies.instances.empty());
  const Scene same = baked(instanced);
  ASSERT_EQ(same.indices.size(), copies.indices.size());
  ASSERT_EQ(same.triangle_material, copies.triangle_material);
  double apart = 0, turned = 0;
  for (std::size_t i = 0; i < same.indices.size(); ++i)
    for (std::size_t k = 0; k < 3; ++k) {
      const std::size_t a = 3 * std::size_t{same.indices[i]} + k, b = 3 * std::size_t{copies.indices[i]} + k;
      apart = std::max(apart, std::abs(double{same.positions[a]} - copies.positions[b]));
      turned = std::max(turned, std::abs(double{same.normals[a]} - copies.normals[b]));
    }
  // Coordinates of up to 16 m, of which half an ulp is 5e-7; transforms are rounded to floats as well.
  EXPECT_LT(apart, 4e-6);
  EXPECT_LT(turned, 1e-6);
}

TEST_F(ImportInstances, OfOneNodeAreChosenAlike) {
  GltfFile file = strip_file(1000, 1);
  json& attributes = file.json["nodes"][0]["extensions"]["EXT_mesh_gpu_instancing"]["attributes"];
  const auto places = [&](std::size_t count) {
    std::vector<float> at;
    for (std::size_t i = 0; i < count; ++i) at.insert(at.end(), {static_cast<float>(i), 0, 0});
    attributes["TRANSLATION"] = file.add(at, 5126, "VEC3");
  };
  places(51);
  EXPECT_EQ(read(file).instances.size(), 51u);
  places(50);
  EXPECT_TRUE(read(file).instances.empty());
}

// Meshes that emit, and those that bound a solid that light passes, are copied; a thin pane is not.
TEST_F(ImportInstances, AreNotMadeOfLampsAndSolids) {
  GltfFile file = strip_file(1000, 60);
  json& material = file.json["materials"][0];
  material["emissiveFactor"] = {1, 1, 1};
  EXPECT_TRUE(read(file).instances.empty());
  material.erase("emissiveFactor");
  material["pbrMetallicRoughness"]["metallicFactor"] = material["pbrMetallicRoughness"]["roughnessFactor"] = 0;
  material["extensions"]["KHR_materials_transmission"]["transmissionFactor"] = 1;
  EXPECT_EQ(read(file).instances.size(), 60u);
  EXPECT_TRUE(needs_of(read(file)).panes);
  material["extensions"]["KHR_materials_volume"]["thicknessFactor"] = 1;
  EXPECT_TRUE(read(file).instances.empty());
}

// A transform that flattens, and a node with weights of morph targets of its own, have a copy each.
TEST_F(ImportInstances, LeaveOutPlacesThatCannotShareTheMesh) {
  GltfFile file = strip_file(1000, 60);
  file.json["nodes"][7]["scale"] = {1, 0, 1};
  const Scene flattened = read(file);
  EXPECT_EQ(flattened.instances.size(), 59u);
  EXPECT_EQ(flattened.triangle_count(), 2000u);
  file = strip_file(1000, 60);
  file.primitive()["targets"] = {{{"POSITION", file.primitive()["attributes"]["NORMAL"]}}};
  file.json["meshes"][0]["weights"] = {0};
  file.json["nodes"][7]["weights"] = {0.5};
  const Scene morphed = read(file);
  EXPECT_EQ(morphed.instances.size(), 59u);
  EXPECT_EQ(morphed.triangle_count(), 2000u);
}

}  // namespace
}  // namespace gleaner::scene

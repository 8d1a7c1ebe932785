// Which meshes the glTF importer stores once, as instances, and which it copies; and that both are the same scene.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <memory>

#include "import_files.h"
#include "scene/import/import.h"
#include "scene/library/bake.h"
#include "scene/model/blob.h"
#include "scene/model/error.h"
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

// EXT_mesh_gpu_instancing: attributes of the file's own count as well.
TEST_F(ImportInstances, AreAsManyAsAnyAttributeSays) {
  GltfFile file = strip_file(2, 1);
  json& attributes = file.json["nodes"][0]["extensions"]["EXT_mesh_gpu_instancing"]["attributes"];
  attributes = {{"_ID", file.add<float>({1, 2, 3}, 5126, "SCALAR")}};
  EXPECT_EQ(read(file).triangle_count(), 6u);
  attributes["TRANSLATION"] = file.add<float>({0, 0, 0, 1, 0, 0}, 5126, "VEC3");
  EXPECT_THROW(read(file), Error) << "two places, three numbers";
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

// Files of which nodes move.
class MovingInstances : public ImportInstances {
 protected:
  // Adds an animation of a value that the file has; one second a key.
  void animate(GltfFile& file, const json& target, const std::vector<float>& values, const std::string& type,
               const std::string& interpolation = "LINEAR") {
    const std::size_t width = type == "SCALAR" ? 1 : type == "VEC3" ? 3 : 4;
    std::vector<float> times;
    for (std::size_t k = 0; k < values.size() / width / (interpolation == "CUBICSPLINE" ? 3 : 1); ++k)
      times.push_back(static_cast<float>(k));
    file.json["animations"].push_back({{"channels", {{{"sampler", 0}, {"target", target}}}},
                                       {"samplers",
                                        {{{"input", file.add(times, 5126, "SCALAR")},
                                          {"output", file.add(values, 5126, type)},
                                          {"interpolation", interpolation}}}}});
  }
  static json node(std::size_t index, const std::string& path) { return {{"node", index}, {"path", path}}; }
  static json pointer(const std::string& to) {
    return {{"path", "pointer"}, {"extensions", {{"KHR_animation_pointer", {{"pointer", to}}}}}};
  }
  // A strip whose node travels.
  GltfFile travelling() {
    GltfFile file = strip_file(10, 1);
    animate(file, node(0, "translation"), {0, 0, 0, 1, 2, 3}, "VEC3");
    return file;
  }

  std::unique_ptr<MovingScene> open(const GltfFile& file, bool instances = true) {
    ImportOptions options;
    options.instances = instances;
    return std::make_unique<MovingScene>(folder_.write("scene.glb", file.glb()), options);
  }
  // Instances and meshes that the animations move, as "2 instances, 1 mesh" would be: {2, 1}.
  std::array<std::size_t, 2> moved(const GltfFile& file) {
    const auto scene = open(file);
    return {scene->base().rig.instances.size(), scene->base().rig.meshes.size()};
  }
  // How far the instances are from copies, posed vertex by vertex, at that time; NaN: no state of the base shows it.
  double apart(const GltfFile& file, double seconds) {
    double most = 0;
    std::vector<Scene> shown;
    for (const bool instances : {true, false}) {
      const auto scene = open(file, instances);
      if (instances && !scene->at(seconds)) return NAN;
      shown.push_back(baked(scene->scene_at(seconds)));
    }
    EXPECT_EQ(shown[0].indices.size(), shown[1].indices.size());
    for (std::size_t i = 0; i < shown[0].indices.size(); ++i)
      for (std::size_t k = 0; k < 3; ++k) {
        const std::size_t a = 3 * std::size_t{shown[0].indices[i]} + k, b = 3 * std::size_t{shown[1].indices[i]} + k;
        // A scene of its own may have an origin of its own.
        const double origins = shown[0].origin[k] - shown[1].origin[k];
        most = std::max({most, std::abs(shown[0].positions[a] - shown[1].positions[b] + origins),
                         std::abs(double{shown[0].normals[a]} - shown[1].normals[b])});
      }
    return most;
  }

  using Moved = std::array<std::size_t, 2>;
};

TEST_F(MovingInstances, AreWhatMovesAsAWhole) {
  EXPECT_EQ(moved(travelling()), (Moved{1, 0}));
  EXPECT_LT(apart(travelling(), 0.7), 2e-6);
  // Below a node that moves; one that repeats its mesh.
  GltfFile file = travelling();
  file.json["nodes"].push_back(file.json["nodes"][0]);
  file.json["nodes"][0].erase("mesh");
  file.json["nodes"][0]["children"] = {1};
  EXPECT_EQ(moved(file), (Moved{1, 0}));
  json& attributes = file.json["nodes"][1]["extensions"]["EXT_mesh_gpu_instancing"]["attributes"];
  attributes["TRANSLATION"] = file.add(std::vector<float>{0, 0, 0, 1, 0, 0, 0, 5, 0}, 5126, "VEC3");
  EXPECT_EQ(moved(file), (Moved{3, 0}));
  EXPECT_LT(apart(file, 0.7), 5e-6);
  // A shape that morphs by the mesh's own weights, which stand.
  file = travelling();
  file.primitive()["targets"] = {{{"POSITION", file.primitive()["attributes"]["NORMAL"]}}};
  file.json["meshes"][0]["weights"] = {0.5};
  EXPECT_EQ(moved(file), (Moved{1, 0}));
}

// What moves shares its mesh with what moves; what stands is copied unless that pays.
TEST_F(MovingInstances, ShareMeshes) {
  GltfFile file = strip_file(10, 4);
  for (const std::size_t i : {1u, 3u}) animate(file, node(i, "rotation"), {0, 0, 0, 1, 0, 0.6f, 0, 0.8f}, "VEC4");
  const auto scene = open(file);
  EXPECT_EQ(scene->base().rig.instances.size(), 2u);
  EXPECT_EQ(scene->base().instances.size(), 2u);
  EXPECT_EQ(scene->base().triangle_count(), 30u) << "two copies, and one mesh for both instances";
  GltfFile large = strip_file(1000, 60);
  animate(large, node(7, "translation"), {0, 0, 0, 1, 0, 0}, "VEC3");
  const auto shared = open(large);
  EXPECT_EQ(shared->base().instances.size(), 60u);
  ASSERT_EQ(shared->base().rig.instances.size(), 1u);
  EXPECT_EQ(shared->base().rig.instances[0].instance, 7u);
  EXPECT_EQ(shared->base().triangle_count(), 1000u);
}

TEST_F(MovingInstances, AreNothingThatShinesOrChangesItsShape) {
  GltfFile file = travelling();
  file.json["materials"][0]["emissiveFactor"] = {1, 1, 1};
  EXPECT_EQ(moved(file), (Moved{0, 1})) << "a lamp";
  file = travelling();
  animate(file, pointer("/materials/0/emissiveFactor"), {0, 0, 0, 1, 1, 1}, "VEC3");
  EXPECT_EQ(moved(file), (Moved{0, 1})) << "a lamp later on";
  file = travelling();
  json& material = file.json["materials"][0];
  material["pbrMetallicRoughness"]["metallicFactor"] = 0;
  material["extensions"]["KHR_materials_transmission"]["transmissionFactor"] = 0;
  material["extensions"]["KHR_materials_volume"]["thicknessFactor"] = 1;
  animate(file, pointer("/materials/0/extensions/KHR_materials_transmission/transmissionFactor"), {0, 1}, "SCALAR");
  EXPECT_EQ(moved(file), (Moved{0, 1})) << "glass later on";
  file = travelling();
  file.primitive()["targets"] = {{{"POSITION", file.primitive()["attributes"]["NORMAL"]}}};
  animate(file, node(0, "weights"), {0, 1}, "SCALAR");
  EXPECT_EQ(moved(file), (Moved{0, 1})) << "a shape that morphs";
  file = travelling();
  animate(file, pointer("/materials/0/pbrMetallicRoughness/baseColorFactor"), {1, 0, 0, 1, 0, 1, 0, 1}, "VEC4");
  EXPECT_EQ(moved(file), (Moved{1, 0})) << "a colour that changes is none of it";
}

// A scale that passes zero makes something flat: no instance, but vertices, in all frames.
TEST_F(MovingInstances, DoNotShrinkToNothing) {
  const std::vector<float> through = {1, 1, 1, -1, 1, 1};
  struct Case {
    const char* what;
    std::vector<float> values;
    std::string interpolation;
    bool instance;
  };
  const Case cases[] = {
      {"through zero", through, "LINEAR", false},
      {"over zero", through, "STEP", true},
      {"at zero", {1, 1, 1, 0, 0, 0}, "STEP", false},
      {"small", {1, 1, 1, 1e-3f, 1e-3f, 1e-3f}, "LINEAR", true},
      {"a spline that swings to zero", {0, 0, 0, 1, 1, 1, -8, 0, 0, 8, 0, 0, 1, 1, 1, 0, 0, 0}, "CUBICSPLINE", false},
      {"a spline that does not", {0, 0, 0, 1, 1, 1, -2, 0, 0, 2, 0, 0, 1, 1, 1, 0, 0, 0}, "CUBICSPLINE", true}};
  for (const Case& c : cases) {
    GltfFile file = strip_file(10, 1);
    animate(file, node(0, "scale"), c.values, "VEC3", c.interpolation);
    EXPECT_EQ(moved(file), (c.instance ? Moved{1, 0} : Moved{0, 1})) << c.what;
    for (const double seconds : {0.0, 0.45, 1.0}) {
      const double found = apart(file, seconds);
      // Vertices that an odd number of mirrors would turn inside out have a scene of their own.
      EXPECT_TRUE(found < 2e-6 || (std::isnan(found) && !c.instance)) << c.what << ", " << seconds << " s: " << found;
    }
  }
  // The child of a node that vanishes does so as well.
  GltfFile file = travelling();
  file.json["nodes"].push_back({{"children", {0}}});
  file.json["scenes"][0]["nodes"] = {1};
  animate(file, node(1, "scale"), through, "VEC3");
  EXPECT_EQ(moved(file), (Moved{0, 1}));
}

// Where scales of several nodes make a transform that no instance may have, that time has a scene of its own.
TEST_F(MovingInstances, ThatBecomeTooFlatHaveAScene) {
  GltfFile file = strip_file(10, 1);
  animate(file, node(0, "scale"), {1, 1, 1, 1, 1e-5f, 1}, "VEC3");
  EXPECT_EQ(moved(file), (Moved{1, 0}));
  EXPECT_LT(apart(file, 0.5), 2e-6);
  const auto scene = open(file);
  EXPECT_FALSE(scene->at(1));
  const Scene own = scene->scene_at(1);
  EXPECT_TRUE(own.instances.empty());
  EXPECT_EQ(own.triangle_count(), 10u);
}

// A blob whose rig names instances or matrices that are not there, or an instance twice.
TEST_F(MovingInstances, ThatDoNotFitAreRefused) {
  GltfFile file = strip_file(10, 2);
  for (const std::size_t i : {0u, 1u}) animate(file, node(i, "translation"), {0, 0, 0, 1, 0, 0}, "VEC3");
  const Scene good = open(file)->base();
  const auto refused = [&](const std::vector<PosedInstance>& instances) -> std::string {
    Scene scene = good;
    scene.rig.instances = instances;
    try {
      parse_scene(serialize(scene), "blob");
    } catch (const Error& error) {
      EXPECT_EQ(error.kind(), ErrorKind::bad_input);
      return error.what();
    }
    return "";
  };
  EXPECT_EQ(refused(good.rig.instances), "");
  using testing::HasSubstr;
  EXPECT_THAT(refused({{0, 0}, {2, 1}}),
              HasSubstr("rig.instances[1].instance: expected an instance from 1 on, below 2"));
  EXPECT_THAT(refused({{0, 0}, {0, 1}}), HasSubstr("rig.instances[1].instance"));
  EXPECT_THAT(refused({{0, 0}, {1, 2}}), HasSubstr("rig.instances[1].matrix: expected a matrix below 2, found 2"));
}

}  // namespace
}  // namespace gleaner::scene

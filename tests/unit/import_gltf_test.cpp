#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

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
using testing::Not;
using testing::Pointwise;

using Floats = std::vector<float>;

class Gltf : public testing::Test {
 protected:
  Scene read(const GltfFile& file) { return import_text(folder_, "scene.glb", file.glb()); }
  // A triangle with texture coordinates, and a texture.
  GltfFile textured_file() {
    GltfFile file = triangle_file();
    file.primitive()["attributes"]["TEXCOORD_0"] = file.add<float>({0, 0, 1, 0, 0, 1}, 5126, "VEC2");
    folder_.write_image("t.png", 1, 1, 4, {1, 1, 1, 1});
    file.json["images"] = {{{"uri", "t.png"}}};
    file.json["textures"] = {{{"source", 0}}};
    return file;
  }
  // As far as a test sees: without the warning about the missing camera.
  std::vector<std::string> warnings(const Scene& scene) {
    std::vector<std::string> all;
    for (const std::string& w : scene.warnings)
      if (w.find("no camera") == std::string::npos) all.push_back(w);
    return all;
  }

  Folder folder_;
};

TEST_F(Gltf, ReadsATriangle) {
  const Scene s = read(triangle_file());
  EXPECT_EQ(s.name, "scene");
  EXPECT_THAT(s.positions, ElementsAre(0, 0, 0, 1, 0, 0, 0, 1, 0));
  EXPECT_THAT(s.normals, testing::Each(0.0f));
  EXPECT_THAT(s.indices, ElementsAre(0, 1, 2));
  EXPECT_THAT(s.triangle_material, ElementsAre(0));
  EXPECT_THAT(s.material_names, ElementsAre("grey"));
  EXPECT_TRUE(s.uvs.empty());
  ASSERT_EQ(s.meshes.size(), 1u);
  EXPECT_EQ(s.meshes[0].triangle_count, 1u);
  const Material& m = s.materials.at(0);
  EXPECT_FLOAT_EQ(m.base_color[0], 0.5f);
  EXPECT_FLOAT_EQ(m.metallic, 1);  // glTF's defaults
  EXPECT_FLOAT_EQ(m.roughness, 1);
  EXPECT_FLOAT_EQ(m.specular, 1);
  EXPECT_FLOAT_EQ(m.ior, 1.5f);
  EXPECT_EQ(warnings(s).size(), 0u);
}

TEST_F(Gltf, BuffersMayBeEmbeddedOrFilesOrTheChunk) {
  GltfFile file = triangle_file();
  const Floats expected = read(file).positions;
  EXPECT_EQ(import_text(folder_, "data.gltf", file.gltf()).positions, expected);
  folder_.write("my buffer+1%.bin", file.binary);
  file.json["buffers"] = {{{"byteLength", file.binary.size()}, {"uri", "my%20buffer+1%25.bin"}}};
  EXPECT_EQ(import_text(folder_, "file.gltf", file.json.dump()).positions, expected);
  // Several, each read from its own.
  file.json["buffers"].push_back(
      {{"byteLength", 6}, {"uri", "data:;base64," + base64(std::string("\0\0\2\0\1\0", 6))}});
  file.json["bufferViews"].push_back({{"buffer", 1}, {"byteLength", 6}});
  file.json["accessors"][1]["bufferView"] = 2;
  EXPECT_THAT(import_text(folder_, "two.gltf", file.json.dump()).indices, ElementsAre(0, 2, 1));
}

TEST_F(Gltf, IndicesOfEveryType) {
  for (int type : {5121, 5123, 5125, 0}) {
    GltfFile file = triangle_file();
    file.primitive()["attributes"]["POSITION"] =
        file.add<float>({0, 0, 0, 1, 0, 0, 0, 1, 0, 1, 1, 0, 2, 0, 0, 0, 2, 0}, 5126, "VEC3");
    std::vector<std::uint32_t> expected = {5, 1, 2, 0, 3, 4};
    if (type == 5121) file.primitive()["indices"] = file.add<std::uint8_t>({5, 1, 2, 0, 3, 4}, type, "SCALAR");
    if (type == 5123) file.primitive()["indices"] = file.add<std::uint16_t>({5, 1, 2, 0, 3, 4}, type, "SCALAR");
    if (type == 5125) file.primitive()["indices"] = file.add<std::uint32_t>({5, 1, 2, 0, 3, 4}, type, "SCALAR");
    if (type == 0) {
      file.primitive().erase("indices");
      expected = {0, 1, 2, 3, 4, 5};
    }
    EXPECT_EQ(read(file).indices, expected) << type;
  }
}

TEST_F(Gltf, StripsAndFansKeepTheirFront) {
  GltfFile file = triangle_file();
  file.primitive().erase("indices");
  file.primitive()["attributes"]["POSITION"] =
      file.add<float>({0, 0, 0, 0, 1, 0, 1, 0, 0, 1, 1, 0, 2, 0, 0}, 5126, "VEC3");
  file.primitive()["mode"] = 5;
  EXPECT_THAT(read(file).indices, ElementsAre(0, 1, 2, 1, 3, 2, 2, 3, 4));
  file.primitive()["mode"] = 6;
  EXPECT_THAT(read(file).indices, ElementsAre(1, 2, 0, 2, 3, 0, 3, 4, 0));
}

TEST_F(Gltf, PointsAndLinesAreLeftOutWithAWord) {
  GltfFile file = triangle_file();
  json points = file.primitive();
  points["mode"] = 0;
  file.json["meshes"][0]["primitives"].push_back(points);
  const Scene s = read(file);
  EXPECT_EQ(s.triangle_count(), 1u);
  EXPECT_THAT(warnings(s), ElementsAre(HasSubstr("meshes[0].primitives[1]: points and lines")));
}

TEST_F(Gltf, InterleavedAndNormalizedAttributes) {
  GltfFile file = triangle_file();
  folder_.write_image("t.png", 1, 1, 3, {1, 1, 1});
  file.json["images"] = {{{"uri", "t.png"}}};
  file.json["textures"] = {{{"source", 0}}};
  file.json["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"] = {{"index", 0}};
  // 16 bytes a vertex: position as 3 shorts, normal as 3 bytes, uv as 2 shorts.
  struct Vertex {
    std::int16_t p[3];
    std::int8_t n[3], pad;
    std::uint16_t uv[2], more;
  };
  static_assert(sizeof(Vertex) == 16);
  const Vertex v[3] = {{{-32767, 0, 0}, {0, 0, 127}, 0, {0, 65535}, 7},
                       {{32767, -32768, 0}, {0, 0, 127}, 0, {65535, 0}, 7},
                       {{0, 16384, 0}, {0, 127, 0}, 0, {13107, 0}, 7}};
  const std::size_t view = file.add_view({reinterpret_cast<const char*>(v), sizeof v});
  file.json["bufferViews"][view]["byteStride"] = 16;
  const auto accessor = [&](int offset, int type, const char* shape) {
    file.json["accessors"].push_back({{"bufferView", view},
                                      {"byteOffset", offset},
                                      {"componentType", type},
                                      {"normalized", true},
                                      {"count", 3},
                                      {"type", shape}});
    return file.json["accessors"].size() - 1;
  };
  file.primitive()["attributes"] = {{"POSITION", accessor(0, 5122, "VEC3")},
                                    {"NORMAL", accessor(6, 5120, "VEC3")},
                                    {"TEXCOORD_0", accessor(10, 5123, "VEC2")}};
  file.json["extensionsUsed"] = file.json["extensionsRequired"] = {"KHR_mesh_quantization"};
  const Scene s = read(file);
  EXPECT_THAT(s.positions, Pointwise(FloatNear(1e-6f), Floats{-1, 0, 0, 1, -1, 0, 0, 16384 / 32767.0f, 0}));
  EXPECT_THAT(s.normals, Pointwise(FloatNear(1e-6f), Floats{0, 0, 1, 0, 0, 1, 0, 1, 0}));
  EXPECT_THAT(s.uvs, Pointwise(FloatNear(1e-6f), Floats{0, 1, 1, 0, 0.2f, 0}));
}

// Memory of views goes as soon as it is read: not that of views whose bytes others still need.
TEST_F(Gltf, LargeViewsThatOverlapAreReadWhole) {
  constexpr std::size_t count = 99999;  // whole triangles
  GltfFile file = triangle_file();
  struct Vertex {
    float p[3], n[3];
  };
  std::vector<Vertex> vertices(count);
  std::vector<std::uint32_t> corners(count);
  for (std::size_t i = 0; i < count; ++i) vertices[i] = {{float(i), float(i % 7), 1}, {0, 0, 1}};
  for (std::size_t i = 0; i < corners.size(); ++i) corners[i] = std::uint32_t(i);
  const std::size_t view = file.add_view({reinterpret_cast<const char*>(vertices.data()), count * sizeof(Vertex)});
  file.json["bufferViews"][view]["byteStride"] = sizeof(Vertex);
  json shifted = file.json["bufferViews"][view];  // the same bytes from the first normal on
  shifted["byteOffset"] = shifted["byteOffset"].get<std::size_t>() + 12;
  shifted["byteLength"] = count * sizeof(Vertex) - 12;
  file.json["bufferViews"].push_back(shifted);
  for (const std::size_t v : {view, view + 1})
    file.json["accessors"].push_back({{"bufferView", v}, {"componentType", 5126}, {"count", count}, {"type", "VEC3"}});
  const std::size_t accessor = file.json["accessors"].size() - 2;
  file.primitive()["attributes"]["POSITION"] = accessor;
  file.primitive()["indices"] = file.add(corners, 5125, "SCALAR");
  // The view of the normals, whose bytes are the first one's too, is read when nobody needs that one any more.
  json second = file.primitive();
  second["attributes"]["POSITION"] = accessor + 1;
  file.json["meshes"][0]["primitives"].push_back(second);
  const Scene s = read(file);
  ASSERT_EQ(s.vertex_count(), 2 * count);
  for (std::size_t i = 0; i < count; ++i) {
    ASSERT_EQ(s.positions[3 * i], float(i));
    ASSERT_EQ(s.positions[3 * i + 2], 1);
    ASSERT_EQ(s.positions[3 * (count + i)], 0);
    ASSERT_EQ(s.positions[3 * (count + i) + 2], 1);
  }
  EXPECT_EQ(s.indices[corners.size() + 5], count + 5);
}

TEST_F(Gltf, SparseAccessors) {
  for (const bool has_base : {true, false}) {
    GltfFile file = triangle_file();
    const std::size_t indices = file.add_view(std::string("\0\2", 2));
    const float values[] = {9, 8, 7, 6, 5, 4};
    const std::size_t replaced = file.add_view({reinterpret_cast<const char*>(values), sizeof values});
    json& position = file.json["accessors"][0];
    position["sparse"] = {{"count", 2},
                          {"indices", {{"bufferView", indices}, {"componentType", 5121}}},
                          {"values", {{"bufferView", replaced}}}};
    if (!has_base) position.erase("bufferView");
    EXPECT_THAT(read(file).positions, ElementsAre(9, 8, 7, has_base ? 1 : 0, 0, 0, 6, 5, 4)) << has_base;
  }
}

TEST_F(Gltf, NodesTurnScaleAndMove) {
  GltfFile file = triangle_file();
  // A quarter turn about z, then twice as large; the parent moves by (10, 0, 0).
  file.json["nodes"] = {{{"children", {1}}, {"translation", {10, 0, 0}}},
                        {{"mesh", 0}, {"rotation", {0, 0, kHalf, kHalf}}, {"scale", {2, 3, 4}}}};
  const Floats expected = {10, 0, 0, 10, 2, 0, 7, 0, 0};
  EXPECT_THAT(read(file).positions, Pointwise(FloatNear(1e-6f), expected));
  file.json["nodes"][1] = {{"mesh", 0}, {"matrix", {0, 2, 0, 0, -3, 0, 0, 0, 0, 0, 4, 0, 0, 0, 0, 1}}};
  EXPECT_THAT(read(file).positions, Pointwise(FloatNear(1e-6f), expected));
}

TEST_F(Gltf, MirrorsKeepTheFrontInFront) {
  GltfFile file = triangle_file();
  file.primitive()["attributes"]["NORMAL"] = file.add<float>({0, 0, 1, 0, 0, 1, 0, 0, 1}, 5126, "VEC3");
  file.json["nodes"][0]["scale"] = {-1, 1, 1};  // still faces +z
  const Scene s = read(file);
  EXPECT_THAT(s.indices, ElementsAre(0, 2, 1));
  EXPECT_THAT(s.normals, ElementsAre(0, 0, 1, 0, 0, 1, 0, 0, 1));
  file.json["nodes"][0]["scale"] = {1, 1, -1};  // faces -z now, seen in a mirror
  const Scene t = read(file);
  EXPECT_THAT(t.indices, ElementsAre(0, 2, 1));
  EXPECT_THAT(t.normals, ElementsAre(0, 0, -1, 0, 0, -1, 0, 0, -1));
  file.json["nodes"][0]["scale"] = {-1, -1, 1};  // a half turn
  EXPECT_THAT(read(file).indices, ElementsAre(0, 1, 2));
}

TEST_F(Gltf, NormalsTurnWithTheInverseTranspose) {
  GltfFile file = triangle_file();
  const float n = static_cast<float>(kHalf);
  file.primitive()["attributes"]["NORMAL"] = file.add<float>({n, n, 0, 0, 0, 5, 0, 0, 0}, 5126, "VEC3");
  file.json["nodes"][0]["scale"] = {1, 2, 1};
  const Scene s = read(file);
  const float length = std::sqrt(1.25f);
  EXPECT_THAT(s.normals, Pointwise(FloatNear(1e-6f), Floats{1 / length, 0.5f / length, 0, 0, 0, 1, 0, 0, 0}));
  EXPECT_THAT(warnings(s), ElementsAre(HasSubstr("attributes.NORMAL: normals of length 0")));
  // Flattened onto a plane: what is left of the normal is the plane's.
  file.json["nodes"][0]["scale"] = {1, 0, 1};
  EXPECT_THAT(read(file).normals, Pointwise(FloatNear(1e-6f), Floats{0, 1, 0, 0, 0, 0, 0, 0, 0}));
}

TEST_F(Gltf, VerticesThatNoTriangleUsesAreDropped) {
  GltfFile file = triangle_file();
  Floats many(3 * 1000);
  for (std::size_t i = 0; i < many.size(); ++i) many[i] = static_cast<float>(i);
  file.primitive()["attributes"]["POSITION"] = file.add(many, 5126, "VEC3");
  file.primitive()["indices"] = file.add<std::uint16_t>({7, 900, 3}, 5123, "SCALAR");
  const Scene s = read(file);
  ASSERT_EQ(s.vertex_count(), 3u);
  Floats corners;
  for (const std::uint32_t i : s.indices) corners.push_back(s.positions[3 * i]);
  EXPECT_THAT(corners, ElementsAre(21, 2700, 9));
}

TEST_F(Gltf, MeshesAreNamedAndMayStandInSeveralPlaces) {
  GltfFile file = triangle_file();
  file.json["meshes"][0]["name"] = "leaf";
  file.json["nodes"] = {{{"mesh", 0}}, {{"mesh", 0}, {"name", "other"}, {"translation", {0, 0, 5}}}, {{"mesh", 0}}};
  file.json["scenes"][0]["nodes"] = {1, 0};  // node 2 is in no scene
  const Scene s = read(file);
  ASSERT_EQ(s.meshes.size(), 2u);
  EXPECT_EQ(s.meshes[0].name, "other");
  EXPECT_EQ(s.meshes[1].name, "leaf");
  EXPECT_EQ(s.meshes[1].first_triangle, 1u);
  EXPECT_FLOAT_EQ(s.positions[2], 5);
  // Without scenes every root counts.
  file.json.erase("scenes");
  file.json.erase("scene");
  EXPECT_EQ(read(file).triangle_count(), 3u);
}

TEST_F(Gltf, DeepHierarchiesAreNoTrouble) {
  GltfFile file = triangle_file();
  json nodes = json::array();
  for (int i = 0; i < 20000; ++i) nodes.push_back({{"children", {i + 1}}, {"translation", {0, 0, 1}}});
  nodes.push_back({{"mesh", 0}});
  file.json["nodes"] = nodes;
  const Scene s = read(file);
  EXPECT_EQ(s.positions[2] + s.origin[2], 20000);
}

TEST_F(Gltf, Cameras) {
  GltfFile file = triangle_file();
  file.json["cameras"] = {
      {{"type", "perspective"},
       {"name", "lens"},
       {"perspective", {{"yfov", 1.0}, {"znear", 0.1}, {"aspectRatio", 2.0}}},
       {"extras", {{"width", 10}, {"height", 5}}}},
      {{"type", "orthographic"}, {"orthographic", {{"xmag", 3}, {"ymag", 2}, {"znear", 0}, {"zfar", 1}}}},
      {{"type", "perspective"}, {"perspective", {{"yfov", 0.5}, {"znear", 0.1}}}}};
  file.json["nodes"] = {{{"mesh", 0}},
                        {{"camera", 0}, {"name", "seat"}, {"translation", {1, 2, 3}}, {"scale", {2, 2, 2}}},
                        {{"camera", 0}, {"extras", {{"width", 200}, {"height", 100}}}},
                        // Turned about y by a quarter: looks to -x.
                        {{"camera", 1}, {"rotation", {0, kHalf, 0, kHalf}}},
                        {{"camera", 2}, {"name", "seat"}}};
  file.json["scenes"][0]["nodes"] = {0, 1, 2, 3, 4};
  const Scene s = read(file);
  ASSERT_EQ(s.cameras.size(), 4u);
  EXPECT_EQ(s.cameras[0].name, "seat");
  EXPECT_EQ(s.cameras[1].name, "lens");
  EXPECT_EQ(s.cameras[2].name, "camera 2");
  EXPECT_EQ(s.cameras[3].name, "seat 2");
  EXPECT_EQ(s.cameras[0].width, 10u);
  EXPECT_EQ(s.cameras[1].width, 200u);  // the node's word is the last
  EXPECT_EQ(s.cameras[1].height, 100u);
  const Camera& c = s.cameras[0].camera;
  EXPECT_THAT(c.origin, ElementsAre(1, 2, 3));
  EXPECT_THAT(c.forward, ElementsAre(0, 0, -1));
  EXPECT_THAT(c.up, ElementsAre(0, 1, 0));
  EXPECT_THAT(c.right, ElementsAre(1, 0, 0));
  EXPECT_FLOAT_EQ(c.half_height, static_cast<float>(std::tan(0.5)));
  EXPECT_FLOAT_EQ(c.half_width, static_cast<float>(2 * std::tan(0.5)));
  const Camera& o = s.cameras[2].camera;
  EXPECT_EQ(o.type, GLEANER_CAMERA_ORTHOGRAPHIC);
  EXPECT_FLOAT_EQ(o.half_width, 3);
  EXPECT_FLOAT_EQ(o.half_height, 2);
  EXPECT_THAT(o.forward, Pointwise(FloatNear(1e-6f), Floats{-1, 0, 0}));
  EXPECT_THAT(o.right, Pointwise(FloatNear(1e-6f), Floats{0, 0, -1}));
  EXPECT_EQ(s.cameras[3].aspect, 0);
  EXPECT_THAT(s.warnings, Not(Contains(HasSubstr("no camera"))));
}

TEST_F(Gltf, AFileWithoutCameraGetsOneThatFramesIt) {
  const Scene s = read(triangle_file());
  ASSERT_EQ(s.cameras.size(), 1u);
  EXPECT_THAT(s.warnings, Contains(HasSubstr("no camera")));
  EXPECT_GT(s.cameras[0].camera.origin[2], 1);
}

TEST_F(Gltf, Lights) {
  GltfFile file = triangle_file();
  file.json["extensionsUsed"] = {"KHR_lights_punctual"};
  file.json["extensions"]["KHR_lights_punctual"]["lights"] = {
      {{"type", "point"}, {"color", {1, 0.5, 0}}, {"intensity", 8}, {"range", 20}},
      {{"type", "spot"}, {"spot", {{"innerConeAngle", 0.25}, {"outerConeAngle", 0.5}}}},
      {{"type", "spot"}, {"spot", json::object()}},
      {{"type", "directional"}, {"intensity", 3}}};
  const auto node = [](int light, json more) {
    more["extensions"]["KHR_lights_punctual"]["light"] = light;
    return more;
  };
  file.json["nodes"].push_back(node(0, {{"translation", {1, 2, 3}}}));
  file.json["nodes"].push_back(node(1, {{"rotation", {-kHalf, 0, 0, kHalf}}}));  // -z turned to -y
  file.json["nodes"].push_back(node(2, json::object()));
  file.json["nodes"].push_back(node(3, {{"scale", {3, 3, 3}}}));
  file.json["scenes"][0]["nodes"] = {0, 1, 2, 3, 4};
  const Scene s = read(file);
  ASSERT_EQ(s.lights.size(), 4u);
  EXPECT_EQ(s.lights[0].type, GLEANER_LIGHT_POINT);
  EXPECT_THAT(s.lights[0].position, ElementsAre(1, 2, 3));
  EXPECT_THAT(s.lights[0].intensity, ElementsAre(8, 4, 0));
  EXPECT_FLOAT_EQ(s.lights[0].range, 20);
  EXPECT_EQ(s.lights[1].type, GLEANER_LIGHT_SPOT);
  EXPECT_THAT(s.lights[1].direction, Pointwise(FloatNear(1e-6f), Floats{0, -1, 0}));
  EXPECT_FLOAT_EQ(s.lights[1].cos_inner, std::cos(0.25f));
  EXPECT_FLOAT_EQ(s.lights[1].cos_outer, std::cos(0.5f));
  EXPECT_FLOAT_EQ(s.lights[2].cos_inner, 1);
  EXPECT_FLOAT_EQ(s.lights[2].cos_outer, std::cos(std::numbers::pi_v<float> / 4));
  EXPECT_EQ(s.lights[3].type, GLEANER_LIGHT_DIRECTIONAL);
  EXPECT_THAT(s.lights[3].direction, ElementsAre(0, 0, -1));
  EXPECT_THAT(s.lights[3].intensity, ElementsAre(3, 3, 3));
}

TEST_F(Gltf, Materials) {
  GltfFile file = triangle_file();
  file.json["extensionsUsed"] = {
      "KHR_materials_emissive_strength", "KHR_materials_transmission", "KHR_materials_volume", "KHR_materials_ior",
      "KHR_materials_specular",          "KHR_materials_unlit"};
  const auto glass = [](json volume) {
    json m = {{"pbrMetallicRoughness", {{"metallicFactor", 0}, {"roughnessFactor", 0}}}};
    m["extensions"]["KHR_materials_transmission"]["transmissionFactor"] = 1;
    m["extensions"]["KHR_materials_ior"]["ior"] = 1.33;
    if (!volume.is_null()) m["extensions"]["KHR_materials_volume"] = volume;
    return m;
  };
  json lamp = {{"emissiveFactor", {1, 0.5, 0}}};
  lamp["extensions"]["KHR_materials_emissive_strength"]["emissiveStrength"] = 10;
  json lambert = {{"pbrMetallicRoughness", {{"metallicFactor", 0}}}};
  lambert["extensions"]["KHR_materials_specular"] = {{"specularFactor", 0}, {"specularColorFactor", {2, 1, 0.5}}};
  json unlit = {{"emissiveFactor", {1, 1, 1}}};
  unlit["extensions"]["KHR_materials_unlit"] = json::object();
  file.json["materials"] = {lamp,
                            lambert,
                            unlit,
                            glass(nullptr),
                            glass({{"thicknessFactor", 1.0}}),
                            glass(json::object()),
                            glass({{"thicknessFactor", 0}}),
                            glass({{"attenuationDistance", 2}, {"attenuationColor", {0.5, 1, 0}}}),
                            {{"alphaMode", "MASK"}, {"alphaCutoff", 0.25}},
                            {{"alphaMode", "BLEND"}, {"pbrMetallicRoughness", {{"baseColorFactor", {1, 1, 1, 0.25}}}}}};
  const Scene s = read(file);
  EXPECT_THAT(s.materials[0].emission, ElementsAre(10, 5, 0));
  EXPECT_FLOAT_EQ(s.materials[1].specular, 0);
  EXPECT_THAT(s.materials[1].specular_color, ElementsAre(2, 1, 0.5f));
  EXPECT_EQ(s.materials[1].albedo_table, GLEANER_NONE);
  EXPECT_EQ(s.materials[2].flags, GLEANER_MATERIAL_UNLIT);
  EXPECT_THAT(s.materials[2].emission, ElementsAre(0, 0, 0));
  EXPECT_FLOAT_EQ(s.materials[3].transmission, 1);
  EXPECT_FLOAT_EQ(s.materials[3].ior, 1.33f);
  EXPECT_EQ(s.materials[3].flags, 0u);  // a thin sheet
  EXPECT_EQ(s.materials[4].flags, GLEANER_MATERIAL_SOLID);
  EXPECT_EQ(s.materials[5].flags, GLEANER_MATERIAL_SOLID);  // the extension's presence says so
  EXPECT_EQ(s.materials[6].flags, 0u);                      // unless it says thin-walled itself
  EXPECT_EQ(s.materials[7].flags, GLEANER_MATERIAL_SOLID | GLEANER_MATERIAL_ATTENUATES);
  EXPECT_FLOAT_EQ(s.materials[7].attenuation[0], std::log(2.0f) / 2);
  EXPECT_FLOAT_EQ(s.materials[7].attenuation[1], 0);
  EXPECT_FLOAT_EQ(s.materials[7].attenuation[2], 1e12f);  // nothing comes through
  EXPECT_EQ(s.materials[8].flags, GLEANER_MATERIAL_ALPHA_MASK);
  EXPECT_FLOAT_EQ(s.materials[8].alpha_cutoff, 0.25f);
  EXPECT_EQ(s.materials[9].flags, GLEANER_MATERIAL_ALPHA_BLEND);
  EXPECT_FLOAT_EQ(s.materials[9].alpha, 0.25f);
}

TEST_F(Gltf, CoatSheenGrainAndFilm) {
  GltfFile file = textured_file();
  const json texture = {{"index", 0}};
  json coated, woven, brushed, oily, off;
  coated["extensions"]["KHR_materials_clearcoat"] = {{"clearcoatFactor", 0.5},
                                                     {"clearcoatRoughnessFactor", 0.25},
                                                     {"clearcoatTexture", texture},
                                                     {"clearcoatRoughnessTexture", texture},
                                                     {"clearcoatNormalTexture", {{"index", 0}, {"scale", 2}}}};
  woven["extensions"]["KHR_materials_sheen"] = {{"sheenColorFactor", {0.25, 0.5, 1}},
                                                {"sheenRoughnessFactor", 0.75},
                                                {"sheenColorTexture", texture},
                                                {"sheenRoughnessTexture", texture}};
  brushed["extensions"]["KHR_materials_anisotropy"] = {
      {"anisotropyStrength", 0.5}, {"anisotropyRotation", 1.5}, {"anisotropyTexture", texture}};
  oily["extensions"]["KHR_materials_iridescence"] = {
      {"iridescenceFactor", 0.5},           {"iridescenceIor", 1.75},        {"iridescenceThicknessMinimum", 50},
      {"iridescenceThicknessMaximum", 600}, {"iridescenceTexture", texture}, {"iridescenceThicknessTexture", texture}};
  off["extensions"]["KHR_materials_clearcoat"]["clearcoatTexture"] = texture;
  off["extensions"]["KHR_materials_sheen"]["sheenColorTexture"] = texture;
  off["extensions"]["KHR_materials_iridescence"] = json::object();
  file.json["materials"] = {coated, woven, brushed, oily, off};
  file.json["extensionsUsed"] = {"KHR_materials_clearcoat", "KHR_materials_sheen", "KHR_materials_anisotropy",
                                 "KHR_materials_iridescence"};
  const Scene s = read(file);
  EXPECT_THAT(warnings(s), testing::IsEmpty());
  const Material &c = s.materials[0], &w = s.materials[1], &b = s.materials[2], &o = s.materials[3];
  EXPECT_FLOAT_EQ(c.clearcoat, 0.5f);
  EXPECT_FLOAT_EQ(c.clearcoat_roughness, 0.25f);
  EXPECT_FLOAT_EQ(c.clearcoat_normal_scale, 2);
  EXPECT_NE(c.clearcoat_texture, GLEANER_NONE);
  EXPECT_NE(c.clearcoat_roughness_texture, GLEANER_NONE);
  EXPECT_NE(c.clearcoat_normal_texture, GLEANER_NONE);
  EXPECT_NE(c.clearcoat_table, GLEANER_NONE);
  EXPECT_THAT(w.sheen_color, ElementsAre(0.25f, 0.5f, 1));
  EXPECT_FLOAT_EQ(w.sheen_roughness, 0.75f);
  EXPECT_EQ(s.textures.at(w.sheen_color_texture).flags, GLEANER_TEXTURE_SRGB);
  EXPECT_EQ(s.textures.at(w.sheen_roughness_texture).flags, 0u);
  EXPECT_NE(w.sheen_table, GLEANER_NONE);
  EXPECT_FLOAT_EQ(b.anisotropy, 0.5f);
  EXPECT_FLOAT_EQ(b.anisotropy_rotation, 1.5f);
  EXPECT_NE(b.anisotropy_texture, GLEANER_NONE);
  EXPECT_FLOAT_EQ(o.iridescence, 0.5f);
  EXPECT_FLOAT_EQ(o.iridescence_ior, 1.75f);
  EXPECT_FLOAT_EQ(o.iridescence_minimum, 50);
  EXPECT_FLOAT_EQ(o.iridescence_maximum, 600);
  EXPECT_NE(o.iridescence_texture, GLEANER_NONE);
  EXPECT_NE(o.iridescence_thickness_texture, GLEANER_NONE);
  // What is switched off reads no texture.
  EXPECT_EQ(s.materials[4].clearcoat_texture, GLEANER_NONE);
  EXPECT_EQ(s.materials[4].sheen_color_texture, GLEANER_NONE);
  EXPECT_FLOAT_EQ(s.materials[4].iridescence, 0);
  // Beyond their ranges they are refused by name.
  for (const auto& [extension, key, value] : {std::tuple{"KHR_materials_clearcoat", "clearcoatFactor", 1.5},
                                              {"KHR_materials_sheen", "sheenRoughnessFactor", -0.5},
                                              {"KHR_materials_anisotropy", "anisotropyStrength", 2.0},
                                              {"KHR_materials_iridescence", "iridescenceIor", 0.5}}) {
    GltfFile bad = triangle_file();
    bad.json["materials"][0]["extensions"][extension][key] = value;
    EXPECT_THAT(refusal(folder_.write("bad.gltf", bad.gltf())), HasSubstr(key));
  }
}

// The direction of a grain is that of the texture coordinates, textures or not.
TEST_F(Gltf, AGrainKeepsTextureCoordinates) {
  GltfFile file = triangle_file();
  file.primitive()["attributes"]["TEXCOORD_0"] = file.add<float>({0, 0, 1, 0, 0, 1}, 5126, "VEC2");
  EXPECT_TRUE(read(file).uvs.empty());
  file.json["materials"][0]["extensions"]["KHR_materials_anisotropy"]["anisotropyStrength"] = 0.5;
  EXPECT_THAT(read(file).uvs, ElementsAre(0, 0, 1, 0, 0, 1));
  file.primitive()["attributes"].erase("TEXCOORD_0");
  EXPECT_THAT(warnings(read(file)), Contains(HasSubstr("TEXCOORD_0")));
}

TEST_F(Gltf, PrimitivesWithoutMaterialGetTheDefault) {
  GltfFile file = triangle_file();
  file.json["meshes"][0]["primitives"].push_back(file.primitive());
  file.primitive().erase("material");
  const Scene s = read(file);
  EXPECT_THAT(s.triangle_material, ElementsAre(1, 0));
  EXPECT_FLOAT_EQ(s.materials.at(1).base_color[0], 1);
  EXPECT_FLOAT_EQ(s.materials.at(1).metallic, 1);
}

TEST_F(Gltf, LightShinesThrough) {
  GltfFile file = textured_file();
  const json texture = {{"index", 0}};
  json leaf, off;
  leaf["extensions"]["KHR_materials_diffuse_transmission"] = {{"diffuseTransmissionFactor", 0.25},
                                                              {"diffuseTransmissionColorFactor", {0.5, 1, 0.25}},
                                                              {"diffuseTransmissionTexture", texture},
                                                              {"diffuseTransmissionColorTexture", texture}};
  leaf["extensions"]["KHR_materials_volume"]["thicknessFactor"] = 0.1;
  leaf["pbrMetallicRoughness"]["metallicFactor"] = 0;  // through the default, metal, nothing shines
  off["extensions"]["KHR_materials_diffuse_transmission"]["diffuseTransmissionTexture"] = texture;
  file.json["materials"] = {leaf, off};
  file.json["extensionsUsed"] = {"KHR_materials_diffuse_transmission", "KHR_materials_volume"};
  const Scene s = read(file);
  EXPECT_THAT(warnings(s), ElementsAre(HasSubstr("thin sheet")));
  const Material& m = s.materials[0];
  EXPECT_FLOAT_EQ(m.diffuse_transmission, 0.25f);
  EXPECT_THAT(m.diffuse_transmission_color, ElementsAre(0.5f, 1, 0.25f));
  EXPECT_EQ(s.textures.at(m.diffuse_transmission_texture).flags, 0u);
  EXPECT_EQ(s.textures.at(m.diffuse_transmission_color_texture).flags, GLEANER_TEXTURE_SRGB);
  EXPECT_EQ(s.materials[1].diffuse_transmission_texture, GLEANER_NONE);
  EXPECT_TRUE(needs_of(s).diffuse_transmission && needs_of(s).transmissive);
  file.json["materials"][0]["extensions"]["KHR_materials_diffuse_transmission"]["diffuseTransmissionFactor"] = 1.5;
  EXPECT_THAT(refusal(folder_.write("bad.gltf", file.gltf())), HasSubstr("diffuseTransmissionFactor"));
}

TEST_F(Gltf, UnknownExtensionsThatAreOnlyUsedGetAWord) {
  GltfFile file = triangle_file();
  file.json["extensionsUsed"] = {"KHR_materials_dispersion", "KHR_materials_ior"};
  EXPECT_THAT(warnings(read(file)), ElementsAre(HasSubstr("KHR_materials_dispersion")));
}

TEST_F(Gltf, BuffersWithoutDataAreInNobodysWay) {
  GltfFile file = triangle_file();
  const Scene s = [&] {
    GltfFile with = file;
    json document = json::parse(with.gltf());
    document["buffers"].push_back({{"byteLength", 8}});
    return import_text(folder_, "holder.gltf", document.dump());
  }();
  EXPECT_EQ(s.triangle_count(), 1u);
  EXPECT_THAT(s.warnings, Contains(AllOf(HasSubstr("buffers[1]"), HasSubstr("neither a uri nor data"))));
  // What reads from one is refused by name.
  json document = json::parse(file.gltf());
  document["buffers"][0].erase("uri");
  EXPECT_THAT(refusal(folder_.write("bad.gltf", document.dump())), HasSubstr("buffers[0]"));
}

TEST_F(Gltf, ASceneWithoutTrianglesIsRead) {
  GltfFile file;
  file.json["nodes"] = {json::object()};
  file.json.erase("meshes");
  file.json["buffers"] = json::array();
  const Scene s = import_text(folder_, "empty.gltf", file.gltf());
  EXPECT_EQ(s.triangle_count(), 0u);
  EXPECT_THAT(s.warnings, Contains(HasSubstr("no triangles")));
}

}  // namespace
}  // namespace gleaner::scene

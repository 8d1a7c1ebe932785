// Files that must be refused, with words that name the file, the element and what was expected there.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstring>
#include <functional>
#include <limits>

#include "import_files.h"
#include "scene/import/import.h"
#include "scene/model/error.h"

namespace gleaner::scene {
namespace {

using nlohmann::json;
using testing::AllOf;
using testing::HasSubstr;

TEST(BadGltf, IsRefusedByNameAndElement) {
  struct Case {
    std::function<void(GltfFile&)> break_it;
    std::vector<std::string> words;
  };
  const auto extension = [](json& element, const char* name) -> json& { return element["extensions"][name]; };
  const Case cases[] = {
      // The shell.
      {[](GltfFile& f) { f.json.erase("asset"); }, {"asset", "found none"}},
      {[](GltfFile& f) { f.json["asset"]["version"] = "1.0"; }, {"asset.version", "2.x", "\"1.0\""}},
      {[](GltfFile& f) { f.json["asset"]["version"] = json::array(); }, {"asset.version", "a string", "an array"}},
      {[](GltfFile& f) { f.json["asset"]["minVersion"] = "2.1"; }, {"asset.minVersion", "at most 2.0", "\"2.1\""}},
      {[](GltfFile& f) { f.json["extensionsRequired"] = {"KHR_texture_basisu"}; },
       {"extensionsRequired[0]", "KHR_texture_basisu"}},
      // What is required and unknown is the reason, not what it brings along.
      {[](GltfFile& f) {
         f.json["extensionsRequired"] = {"KHR_mesh_quantization", "EXT_tape"};
         f.json["buffers"] = {{{"byteLength", 4}, {"uri", "missing.bin"}}};
       },
       {"extensionsRequired[1]", "EXT_tape"}},
      {[](GltfFile& f) { f.json["scene"] = 1; }, {"scene", "an index below 1", "1"}},
      {[](GltfFile& f) { f.json["scenes"][0]["nodes"] = {7}; }, {"scenes[0].nodes[0]", "an index below 1", "7"}},
      {[](GltfFile& f) { f.json["nodes"] = "none"; }, {"nodes", "an array", "\"none\""}},
      {[](GltfFile& f) { f.json["nodes"][0] = 3; }, {"nodes[0]", "an object", "3"}},
      // Nodes.
      {[](GltfFile& f) { f.json["nodes"][0]["children"] = {0}; }, {"nodes[0]", "one parent"}},
      {[](GltfFile& f) {
         f.json["nodes"] = {{{"children", {1, 2}}}, {{"children", {2}}}, {{"mesh", 0}}};
       },
       {"nodes[2]", "one parent"}},
      {[](GltfFile& f) { f.json["nodes"][0]["children"] = {-1}; }, {"nodes[0].children[0]", "an index below 1", "-1"}},
      {[](GltfFile& f) { f.json["nodes"][0]["mesh"] = 1; }, {"nodes[0].mesh", "an index below 1", "1"}},
      {[](GltfFile& f) { f.json["nodes"][0]["mesh"] = 0.5; }, {"nodes[0].mesh", "an index below 1", "0.5"}},
      {[](GltfFile& f) {
         f.json["nodes"][0]["matrix"] = {1, 2, 3};
       },
       {"nodes[0].matrix", "16 numbers", "an array of 3"}},
      {[](GltfFile& f) { f.json["nodes"][0]["matrix"] = json(std::vector<int>(16, 1)); },
       {"nodes[0].matrix", "affine"}},
      {[](GltfFile& f) {
         f.json["nodes"][0]["rotation"] = {0, 0, 0, 0};
       },
       {"nodes[0].rotation", "quaternion"}},
      {[](GltfFile& f) {
         f.json["nodes"][0]["scale"] = {1, "2", 3};
       },
       {"nodes[0].scale[1]", "a number", "\"2\""}},
      {[](GltfFile& f) {
         f.json["nodes"].push_back({{"mesh", 0}, {"translation", {4e9, 0, 0}}});
         f.json["scenes"][0]["nodes"] = {0, 1};
       },
       {"attributes.POSITION", "1e9 m"}},
      {[](GltfFile& f) {
         f.json["nodes"] = json::array();
         for (int i = 0; i < 20; ++i) f.json["nodes"].push_back({{"children", {i + 1}}, {"scale", {1e30, 1, 1}}});
         f.json["nodes"].push_back({{"mesh", 0}});
       },
       {"nodes[10]", "a finite transform"}},
      // Buffers and views.
      {[](GltfFile& f) {
         f.json["buffers"] = {{{"byteLength", f.binary.size() + 100}}};
       },
       {"buffers[0].byteLength", "at most"}},
      {[](GltfFile& f) {
         f.json["buffers"] = {{{"byteLength", 0}}};
       },
       {"buffers[0].byteLength", "from 1"}},
      {[](GltfFile& f) {
         f.json["buffers"] = {{{"byteLength", -5}}};
       },
       {"buffers[0].byteLength", "-5"}},
      {[](GltfFile& f) {
         f.json["buffers"] = {{{"byteLength", 4}, {"uri", "missing.bin"}}};
       },
       {"buffers[0].uri", "missing.bin", "found none"}},
      {[](GltfFile& f) {
         f.json["buffers"] = {{{"byteLength", 4}, {"uri", "../scene.bin"}}};
       },
       {"buffers[0].uri", "inside the scene's folder"}},
      {[](GltfFile& f) {
         f.json["buffers"] = {{{"byteLength", 4}, {"uri", "/etc/passwd"}}};
       },
       {"buffers[0].uri", "inside the scene's folder"}},
      {[](GltfFile& f) {
         f.json["buffers"] = {{{"byteLength", 4}, {"uri", "%2e%2e/x"}}};
       },
       {"buffers[0].uri", "inside the scene's folder"}},
      {[](GltfFile& f) {
         f.json["buffers"] = {{{"byteLength", 4}, {"uri", "a%2"}}};
       },
       {"buffers[0].uri", "a%2"}},
      {[](GltfFile& f) {
         f.json["buffers"] = {{{"byteLength", 4}, {"uri", "a%00b"}}};
       },
       {"buffers[0].uri", "zero"}},
      {[](GltfFile& f) {
         f.json["buffers"] = {{{"byteLength", 4}, {"uri", "."}}};
       },
       {"buffers[0].uri"}},
      {[](GltfFile& f) {
         f.json["buffers"] = {{{"byteLength", 4}, {"uri", "data:;base64,AAA"}}};
       },
       {"buffers[0].byteLength", "at most 2"}},
      {[](GltfFile& f) {
         f.json["buffers"] = {{{"byteLength", 4}, {"uri", "data:;base64,AA*A"}}};
       },
       {"buffers[0].uri", "base64"}},
      {[](GltfFile& f) {
         f.json["buffers"] = {{{"byteLength", 4}, {"uri", "data:;base64,AAAAA"}}};
       },
       {"buffers[0].uri", "base64"}},
      {[](GltfFile& f) {
         f.json["buffers"] = {{{"byteLength", 4}, {"uri", "data:text/plain,abcd"}}};
       },
       {"buffers[0].uri", "base64"}},
      {[](GltfFile& f) { f.json["bufferViews"][0]["buffer"] = 3; }, {"bufferViews[0].buffer", "an index below 1", "3"}},
      {[](GltfFile& f) { f.json["bufferViews"][0]["byteOffset"] = 1000; }, {"bufferViews[0]", "bytes within"}},
      {[](GltfFile& f) { f.json["bufferViews"][0]["byteLength"] = 4000000000u; }, {"bufferViews[0]", "bytes within"}},
      {[](GltfFile& f) { f.json["bufferViews"][0]["byteLength"] = 1e300; }, {"bufferViews[0].byteLength", "1e+300"}},
      {[](GltfFile& f) { f.json["bufferViews"][0]["byteStride"] = 8; }, {"bufferViews[0].byteStride", "at least 12"}},
      {[](GltfFile& f) { f.json["bufferViews"][0]["byteStride"] = 100; }, {"accessors[0]", "within the 36 bytes"}},
      // Accessors.
      {[](GltfFile& f) { f.json["accessors"][0]["count"] = 4; }, {"accessors[0]", "within the 36 bytes"}},
      {[](GltfFile& f) { f.json["accessors"][0]["count"] = 2147483648u; }, {"accessors[0]", "within the 36 bytes"}},
      {[](GltfFile& f) { f.json["accessors"][0]["count"] = 0; }, {"accessors[0].count", "from 1", "0"}},
      {[](GltfFile& f) { f.json["accessors"][0]["count"] = -3; }, {"accessors[0].count", "-3"}},
      {[](GltfFile& f) { f.json["accessors"][0]["count"] = 18446744073709551615u; }, {"accessors[0].count"}},
      {[](GltfFile& f) { f.json["accessors"][0]["byteOffset"] = 4; }, {"accessors[0]", "within the 36 bytes"}},
      {[](GltfFile& f) { f.json["accessors"][0]["byteOffset"] = 4294967295u; }, {"accessors[0]", "within the 36"}},
      {[](GltfFile& f) { f.json["accessors"][0]["componentType"] = 5124; },
       {"accessors[0].componentType", "5126", "5124"}},
      {[](GltfFile& f) { f.json["accessors"][0]["type"] = "VEC2"; }, {"accessors[0].type", "\"VEC3\"", "\"VEC2\""}},
      {[](GltfFile& f) { f.json["accessors"][0]["normalized"] = true; }, {"accessors[0].normalized", "false"}},
      {[](GltfFile& f) { f.json["accessors"][0]["normalized"] = 1; }, {"accessors[0].normalized", "true or false"}},
      {[](GltfFile& f) { f.json["accessors"][0].erase("bufferView"), f.json["accessors"][0]["count"] = 1u << 30; },
       {"accessors[0].count", "without a bufferView"}},
      {[](GltfFile& f) { f.json["accessors"][1]["componentType"] = 5122; },
       {"accessors[1].componentType", "unsigned", "5122"}},
      {[](GltfFile& f) {
         f.json["accessors"][0]["sparse"] = {
             {"count", 4}, {"indices", {{"bufferView", 1}, {"componentType", 5123}}}, {"values", {{"bufferView", 0}}}};
       },
       {"accessors[0].sparse.count", "from 1 to 3", "4"}},
      {[](GltfFile& f) {
         const std::size_t view = f.add_view(std::string("\3", 1));
         f.json["accessors"][0]["sparse"] = {{"count", 1},
                                             {"indices", {{"bufferView", view}, {"componentType", 5121}}},
                                             {"values", {{"bufferView", 0}}}};
       },
       {"accessors[0].sparse.indices", "below 3", "3"}},
      // Primitives.
      {[](GltfFile& f) { f.primitive()["attributes"]["POSITION"] = 40; },
       {"meshes[0].primitives[0].attributes.POSITION", "an index below 2", "40"}},
      {[](GltfFile& f) { f.primitive()["mode"] = 7; }, {"primitives[0].mode", "from 0 to 6", "7"}},
      {[](GltfFile& f) { f.primitive()["material"] = 1; }, {"primitives[0].material", "an index below 1", "1"}},
      {[](GltfFile& f) {
         f.primitive()["indices"] = f.add<std::uint16_t>({0, 1, 3}, 5123, "SCALAR");
       },
       {"primitives[0].indices", "vertices below 3", "3 at index 2"}},
      {[](GltfFile& f) {
         f.primitive()["attributes"]["POSITION"] =
             f.add<float>({0, 0, 0, 1, std::numeric_limits<float>::quiet_NaN(), 0, 0, 1, 0}, 5126, "VEC3");
       },
       {"attributes.POSITION", "finite", "nan", "vertex 1"}},
      {[](GltfFile& f) {
         f.primitive()["attributes"]["NORMAL"] =
             f.add<float>({0, 0, 0, 1, 0, 0, std::numeric_limits<float>::infinity(), 1, 0}, 5126, "VEC3");
       },
       {"attributes.NORMAL", "finite", "inf", "vertex 2"}},
      {[](GltfFile& f) {
         f.primitive()["attributes"]["NORMAL"] = f.add<float>({0, 0, 1}, 5126, "VEC3");
       },
       {"attributes.NORMAL", "as many elements as POSITION: 3", "1"}},
      {[](GltfFile& f) {
         // A hundred thousand nodes of one lamp, which is not instanced, with 65,536 triangles: 6.5e9 triangles from 3
         // MB.
         f.json["materials"][0]["emissiveFactor"] = {1, 1, 1};
         f.primitive()["indices"] = f.add(std::vector<std::uint16_t>(3 << 16), 5123, "SCALAR");
         json nodes = json::array(), roots = json::array();
         for (int i = 0; i < 100000; ++i) nodes.push_back({{"mesh", 0}}), roots.push_back(i);
         f.json["nodes"] = nodes;
         f.json["scenes"][0]["nodes"] = roots;
       },
       {"meshes[0].primitives[0]", "triangles in all"}},
      // Materials.
      {[](GltfFile& f) {
         f.json["materials"][0]["pbrMetallicRoughness"]["baseColorFactor"] = {0.5, -1, 0, 1};
       },
       {"materials[0].pbrMetallicRoughness.baseColorFactor[1]", "from 0 to 1", "-1"}},
      {[](GltfFile& f) {
         f.json["materials"][0]["pbrMetallicRoughness"]["baseColorFactor"] = {1.5, 1, 0, 1};
       },
       {"materials[0].pbrMetallicRoughness.baseColorFactor[0]", "from 0 to 1", "1.5"}},
      {[](GltfFile& f) {
         f.json["materials"][0]["pbrMetallicRoughness"]["baseColorFactor"] = {1, 1, 1};
       },
       {"baseColorFactor", "4 numbers"}},
      {[](GltfFile& f) { f.json["materials"][0]["pbrMetallicRoughness"]["roughnessFactor"] = "rough"; },
       {"roughnessFactor", "a number", "\"rough\""}},
      {[](GltfFile& f) { f.json["materials"][0]["pbrMetallicRoughness"]["metallicFactor"] = 2; },
       {"metallicFactor", "from 0 to 1", "2"}},
      {[](GltfFile& f) {
         f.json["materials"][0]["emissiveFactor"] = {-1, 0, 0};
       },
       {"emissiveFactor[0]", "-1"}},
      {[](GltfFile& f) { f.json["materials"][0]["alphaMode"] = "GLOW"; }, {"alphaMode", "MASK", "\"GLOW\""}},
      {[&](GltfFile& f) { extension(f.json["materials"][0], "KHR_materials_ior")["ior"] = 0.9; },
       {"materials[0].extensions.KHR_materials_ior.ior", "at least 1", "0.9"}},
      {[&](GltfFile& f) {
         extension(f.json["materials"][0], "KHR_materials_ior")["ior"] = 0;
         extension(f.json["materials"][0], "KHR_materials_transmission")["transmissionFactor"] = 1;
       },
       {"materials[0]", "an ior of at least 1"}},
      {[&](GltfFile& f) {
         extension(f.json["materials"][0], "KHR_materials_transmission")["transmissionFactor"] = 1;
         extension(f.json["materials"][0], "KHR_materials_volume")["attenuationDistance"] = 0;
       },
       {"KHR_materials_volume.attenuationDistance", "more than 0", "0"}},
      {[&](GltfFile& f) {
         f.json["materials"][0]["emissiveFactor"] = {1, 1, 1};
         extension(f.json["materials"][0], "KHR_materials_emissive_strength")["emissiveStrength"] = -1;
       },
       {"KHR_materials_emissive_strength.emissiveStrength", "at least 0", "-1"}},
      {[](GltfFile& f) {
         f.json["materials"][0]["normalTexture"] = {{"index", 0}};
       },
       {"materials[0].normalTexture.index", "nothing to name"}},
      {[](GltfFile& f) { f.json["materials"][0]["extensions"] = 5; }, {"materials[0].extensions", "an object"}},
      // Cameras and lights.
      {[](GltfFile& f) {
         f.json["cameras"] = {{{"type", "perspective"}, {"perspective", {{"yfov", 4}}}}};
         f.json["nodes"][0]["camera"] = 0;
       },
       {"cameras[0].perspective.yfov", "between 0 and pi", "4"}},
      {[](GltfFile& f) {
         f.json["cameras"] = {{{"type", "fisheye"}}};
         f.json["nodes"][0]["camera"] = 0;
       },
       {"cameras[0].type", "\"fisheye\""}},
      {[](GltfFile& f) {
         f.json["cameras"] = {{{"type", "orthographic"}, {"orthographic", {{"xmag", 1}, {"ymag", 0}}}}};
         f.json["nodes"][0]["camera"] = 0;
       },
       {"cameras[0].orthographic.ymag", "more than 0", "0"}},
      {[&](GltfFile& f) { extension(f.json["nodes"][0], "KHR_lights_punctual")["light"] = 0; },
       {"nodes[0].extensions.KHR_lights_punctual.light", "at the top of the file"}},
      {[&](GltfFile& f) {
         extension(f.json, "KHR_lights_punctual")["lights"] = {{{"type", "point"}, {"intensity", -2}}};
         extension(f.json["nodes"][0], "KHR_lights_punctual")["light"] = 0;
       },
       {"extensions.KHR_lights_punctual.lights[0].intensity", "at least 0", "-2"}},
      {[&](GltfFile& f) {
         extension(f.json, "KHR_lights_punctual")["lights"] = {
             {{"type", "spot"}, {"spot", {{"innerConeAngle", 1}, {"outerConeAngle", 0.5}}}}};
         extension(f.json["nodes"][0], "KHR_lights_punctual")["light"] = 0;
       },
       {"lights[0].spot.innerConeAngle", "at most the outerConeAngle"}},
  };
  const Folder folder;
  for (const Case& c : cases) {
    GltfFile file = triangle_file();
    c.break_it(file);
    const std::string said = refusal(folder.write("scene.glb", file.glb()));
    for (const std::string& word : c.words) EXPECT_THAT(said, HasSubstr(word));
    EXPECT_THAT(said, HasSubstr("expected"));
  }
}

TEST(BadGltf, TextThatIsNotJson) {
  const Folder folder;
  EXPECT_THAT(refusal(folder.write("a.gltf", "{\"asset\": ")), HasSubstr("JSON"));
  EXPECT_THAT(refusal(folder.write("b.gltf", "solid cube")), HasSubstr("JSON"));
  EXPECT_THAT(refusal(folder.write("c.gltf", "[1, 2]")), HasSubstr("an object"));
  EXPECT_THAT(refusal(folder.write("d.gltf", "{\"asset\": {\"version\": \"2.0\"}, \"x\": 1e999}")), HasSubstr("JSON"));
  EXPECT_THAT(refusal(folder.write("e.gltf", "\xff\xfe{}")), HasSubstr("JSON"));
}

TEST(BadGltf, NestingBombs) {
  const Folder folder;
  for (const char open : {'[', '{'}) {
    std::string bomb;
    for (int i = 0; i < 2000000; ++i) {
      bomb += open;
      if (open == '{') bomb += "\"a\":";
    }
    EXPECT_THAT(refusal(folder.write("bomb.gltf", bomb)), HasSubstr("nested at most")) << open;
  }
  // Brackets in strings are not nesting.
  GltfFile file = triangle_file();
  file.json["asset"]["generator"] = std::string(1000, '[') + "\\\"" + std::string(1000, '{');
  EXPECT_NO_THROW(import_text(folder, "strings.glb", file.glb()));
}

TEST(BadGlb, NoBeginningOfItIsTaken) {
  const Folder folder;
  const std::string whole = triangle_file().glb();
  for (std::size_t length = 0; length < whole.size(); ++length)
    EXPECT_NE(refusal(folder.write("cut.glb", whole.substr(0, length))), "") << length;
}

TEST(BadGlb, HeadersThatLie) {
  const Folder folder;
  const std::string whole = triangle_file().glb();
  const auto with = [&](std::size_t offset, std::uint32_t value) {
    std::string bytes = whole;
    std::memcpy(bytes.data() + offset, &value, sizeof value);
    return refusal(folder.write("lies.glb", bytes));
  };
  EXPECT_THAT(with(0, 0x12345678), AllOf(HasSubstr("header"), HasSubstr("magic")));
  EXPECT_THAT(with(4, 1), AllOf(HasSubstr("header.version"), HasSubstr("expected 2, found 1")));
  EXPECT_THAT(with(8, 0xffffffff), HasSubstr("header.length"));
  EXPECT_THAT(with(12, 0xfffffff0), HasSubstr("chunk 0"));
  EXPECT_THAT(with(12, 0), HasSubstr("chunk 0"));
  EXPECT_THAT(with(16, 0x004e4942), AllOf(HasSubstr("chunk 0"), HasSubstr("JSON")));
}

TEST(BadFile, IsNamed) {
  const Folder folder;
  EXPECT_THAT(refusal(folder.path("none.glb")), AllOf(HasSubstr("a readable file"), HasSubstr("none")));
  EXPECT_THAT(refusal(folder.path("none.obj")), AllOf(HasSubstr("a readable file"), HasSubstr("none")));
  EXPECT_THAT(refusal(folder.write("empty.gltf", "")), HasSubstr("0 bytes"));
  EXPECT_THAT(refusal(folder.write("scene.fbx", "x")), HasSubstr(".gltf, .glb, .obj, .ply or .stl"));
  EXPECT_THAT(refusal(folder.write("scene", "x")), HasSubstr(".gltf, .glb, .obj, .ply or .stl"));
  std::filesystem::create_directory(folder.path("folder.glb"));
  EXPECT_THAT(refusal(folder.path("folder.glb")), HasSubstr("a folder"));
  std::filesystem::create_symlink("/dev/zero", folder.path("endless.glb"));
  EXPECT_THAT(refusal(folder.path("endless.glb")), HasSubstr("not a regular file"));
}

TEST(BadFile, HugeOnesAreRefusedUnread) {
  const Folder folder;
  const std::string path = folder.write("huge.glb", "glTF");
  std::filesystem::resize_file(path, 5000000000u);  // sparse
  EXPECT_THAT(refusal(path), AllOf(HasSubstr("at most"), HasSubstr("5000000000")));
}

}  // namespace
}  // namespace gleaner::scene

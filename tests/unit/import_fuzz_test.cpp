// Thousands of damaged files, the same ones every time: each is refused with Error::bad_input or yields a scene that
// holds every promise. Nothing else may be thrown, and nothing may crash; a build with the address and undefined
// behaviour sanitizers sees more. GLEANER_FUZZ_EXECUTIONS is the number of files of each kind (bench/fuzz sets it).

#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <cstdlib>
#include <fstream>
#include <random>

#include "import_files.h"
#include "scene/import/import.h"
#include "scene/model/error.h"

namespace gleaner::scene {
namespace {

using nlohmann::json;

// A file with a little of everything.
GltfFile rich_file(const Folder& folder) {
  GltfFile f = triangle_file();
  f.primitive()["attributes"]["NORMAL"] = f.add<float>({0, 0, 1, 0, 0, 1, 0, 0, 1}, 5126, "VEC3");
  f.primitive()["attributes"]["TEXCOORD_0"] = f.add<float>({0, 0, 1, 0, 0, 1}, 5126, "VEC2");
  const std::size_t places = f.add_view(std::string("\2", 1)), values = f.add_view(std::string(12, 0));
  f.json["accessors"][0]["sparse"] = {{"count", 1},
                                      {"indices", {{"bufferView", places}, {"componentType", 5121}}},
                                      {"values", {{"bufferView", values}}}};
  std::ifstream image(folder.write_image("t.png", 4, 4, 4, std::vector<float>(64, 0.5f)), std::ios::binary);
  const std::string png{std::istreambuf_iterator<char>(image), {}};
  f.json["images"] = {{{"mimeType", "image/png"}, {"bufferView", f.add_view(png)}}, {{"uri", "t.png"}}};
  f.json["samplers"] = {{{"wrapS", 33071}, {"wrapT", 10497}, {"magFilter", 9728}}};
  f.json["textures"] = {{{"source", 0}, {"sampler", 0}}, {{"source", 1}}};
  json& m = f.json["materials"][0];
  m["pbrMetallicRoughness"]["baseColorTexture"] = {{"index", 0}, {"texCoord", 0}};
  m["pbrMetallicRoughness"]["metallicFactor"] = 1;
  m["pbrMetallicRoughness"]["roughnessFactor"] = 0.2;
  m["emissiveTexture"] = {{"index", 1}};
  m["emissiveFactor"] = {1, 0.5, 0.25};
  m["extensions"]["KHR_materials_ior"]["ior"] = 1.5;
  m["extensions"]["KHR_materials_transmission"]["transmissionFactor"] = 0.5;
  m["extensions"]["KHR_materials_volume"] = {{"attenuationDistance", 2}, {"attenuationColor", {1, 0.5, 0.1}}};
  m["extensions"]["KHR_materials_emissive_strength"]["emissiveStrength"] = 3;
  m["extensions"]["KHR_materials_specular"]["specularFactor"] = 0.5;
  m["extensions"]["KHR_materials_clearcoat"] = {
      {"clearcoatFactor", 0.5}, {"clearcoatRoughnessFactor", 0.2}, {"clearcoatTexture", {{"index", 1}}}};
  m["extensions"]["KHR_materials_sheen"] = {{"sheenColorFactor", {0.5, 0.2, 1}}, {"sheenRoughnessFactor", 0.4}};
  m["extensions"]["KHR_materials_anisotropy"] = {{"anisotropyStrength", 0.5}, {"anisotropyRotation", 1}};
  m["extensions"]["KHR_materials_iridescence"] = {{"iridescenceFactor", 0.5}, {"iridescenceThicknessMaximum", 300}};
  json strip = f.primitive();
  strip["mode"] = 5;
  f.json["meshes"][0]["primitives"].push_back(strip);
  f.json["cameras"] = {{{"type", "perspective"}, {"perspective", {{"yfov", 0.7}, {"aspectRatio", 1.5}}}},
                       {{"type", "orthographic"}, {"orthographic", {{"xmag", 1}, {"ymag", 1}}}}};
  f.json["extensions"]["KHR_lights_punctual"]["lights"] = {
      {{"type", "spot"}, {"intensity", 5}, {"range", 7}, {"spot", {{"innerConeAngle", 0.1}, {"outerConeAngle", 0.2}}}}};
  json lamp = {{"camera", 1}, {"matrix", {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 1, 2, 3, 1}}};
  lamp["extensions"]["KHR_lights_punctual"]["light"] = 0;
  f.json["nodes"] = {{{"mesh", 0}, {"children", {1, 2}}, {"rotation", {0, 0, 0, 1}}, {"scale", {1, 2, 3}}},
                     {{"mesh", 0}, {"camera", 0}, {"translation", {1, 2, 3}}},
                     lamp};
  f.json["extensionsUsed"] = {"KHR_lights_punctual"};
  // Vertices that move and shine.
  f.primitive()["attributes"]["COLOR_0"] = f.add<float>({1, 0.5f, 0, 0, 0, 0, 1, 1, 1}, 5126, "VEC3");
  f.primitive()["attributes"]["TEXCOORD_1"] = f.add<float>({0, 1, 1, 1, 0, 0}, 5126, "VEC2");
  m["normalTexture"] = {{"index", 1}, {"texCoord", 1}};
  m["normalTexture"]["extensions"]["KHR_texture_transform"] = {{"scale", {2, 2}}};
  f.primitive()["targets"] = {{{"POSITION", f.primitive()["attributes"]["NORMAL"]}}};
  f.json["meshes"][0]["weights"] = {0.5};
  json skinned = f.primitive();
  skinned["attributes"]["JOINTS_0"] = f.add<std::uint8_t>({0, 1, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0}, 5121, "VEC4");
  skinned["attributes"]["WEIGHTS_0"] = f.add<float>({1, 0, 0, 0, 0, 1, 0, 0, .5f, .5f, 0, 0}, 5126, "VEC4");
  f.json["meshes"].push_back({{"primitives", {skinned}}});
  f.json["skins"] = {{{"joints", {1, 2}}}};
  f.json["nodes"].push_back({{"mesh", 1}, {"skin", 0}});
  json many = {{"mesh", 0}};
  many["extensions"]["EXT_mesh_gpu_instancing"]["attributes"]["TRANSLATION"] =
      f.add<float>({1, 0, 0, 0, 2, 0}, 5126, "VEC3");
  f.json["nodes"].push_back(many);
  f.json["scenes"][0]["nodes"] = {0, 3, 4};
  f.json["extensions"]["KHR_materials_variants"]["variants"] = {{{"name", "a"}}};
  return f;
}

int executions(int usual) {
  const char* wanted = std::getenv("GLEANER_FUZZ_EXECUTIONS");
  return wanted ? std::atoi(wanted) : usual;
}

std::string contents(const std::string& path) {
  std::ifstream stream(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(stream), {}};
}

class Outcomes {
 public:
  ~Outcomes() { std::printf("%d executions: %d taken, %d refused\n", taken + refused, taken, refused); }

  void import_sky(const std::string& path, const std::string& what) {
    try {
      const Environment sky = import_environment(path);
      for (const float value : sky.radiance) ASSERT_TRUE(value >= 0 && std::isfinite(value)) << what;
      ++taken;
    } catch (const Error& error) {
      ASSERT_EQ(error.kind(), ErrorKind::bad_input) << what << ": " << error.what();
      ++refused;
    } catch (const std::exception& error) {
      FAIL() << what << ": " << error.what();
    }
  }

  void import(const std::string& path, const std::string& what) {
    try {
      const Scene scene = import_scene(path);
      ASSERT_NO_THROW(validate(scene, path)) << what;
      ++taken;
    } catch (const Error& error) {
      ASSERT_EQ(error.kind(), ErrorKind::bad_input) << what << ": " << error.what();
      ++refused;
    } catch (const std::exception& error) {
      FAIL() << what << ": " << error.what();
    }
  }
  int taken = 0, refused = 0;
};

std::string damaged(std::string bytes, std::mt19937& random) {
  const auto at = [&] { return random() % bytes.size(); };
  for (unsigned i = 0, n = 1 + random() % 4; i < n && !bytes.empty(); ++i) {
    switch (random() % 6) {
      case 0:
        bytes[at()] ^= static_cast<char>(1u << random() % 8);
        break;
      case 1:
        bytes[at()] = static_cast<char>(random());
        break;
      case 2:
        bytes[at()] = "0123456789-+.eE/\\\"{}[]:, \n#"[random() % 28];
        break;
      case 3: {
        const std::size_t from = at();
        bytes.erase(from, 1 + random() % 8);
        break;
      }
      case 4: {
        const std::size_t from = at();
        bytes.insert(at(), bytes.substr(from, 1 + random() % 16));
        break;
      }
      default:
        bytes.resize(at());
    }
  }
  return bytes;
}

// Replaces one value, anywhere in the document.
void damage(json& document, std::mt19937& random) {
  json* value = &document;
  // Not the document itself: it gets its buffers later.
  while (value->is_structured() && !value->empty() && (value == &document || random() % 8 != 0)) {
    auto child = value->begin();
    std::advance(child, random() % value->size());
    value = &*child;
  }
  static const json oddities = json::parse(R"([-1, 0, 1, 2, 3, 7, 255, 65536, 2147483647, 2147483648, 4294967295,
    4294967296, 9007199254740993, 18446744073709551615, -9223372036854775808, 0.5, -0.0, 1e-300, 1e39, 1e300, 2e9,
    true, null, "", "x", "../x", "data:;base64,", "KHR_x", [], [0], [1, 2, 3], [[]], {}, {"a": 1},
    5120, 5121, 5122, 5123, 5124, 5125, 5126, "SCALAR", "VEC2", "VEC4", "MAT4"])");
  switch (random() % 8) {
    case 0:
      if (value->is_array() && !value->empty()) {
        value->push_back(value->back());
        return;
      }
      break;
    case 1:
      if (value->is_structured() && !value->empty()) {
        auto child = value->begin();
        std::advance(child, random() % value->size());
        value->erase(child);
        return;
      }
      break;
    default:
      break;
  }
  *value = oddities[random() % oddities.size()];
}

TEST(Fuzz, DamagedBytesOfAGlb) {
  const Folder folder;
  const std::string good = rich_file(folder).glb();
  ASSERT_NO_THROW(import_text(folder, "good.glb", good));
  std::mt19937 random(11);
  Outcomes outcomes;
  for (int i = 0; i < executions(2000); ++i)
    outcomes.import(folder.write("f.glb", damaged(good, random)), "mutation " + std::to_string(i));
  EXPECT_GT(outcomes.taken, 20);
  EXPECT_GT(outcomes.refused, 20);
}

TEST(Fuzz, DamagedValuesOfAGlb) {
  const Folder folder;
  const GltfFile good = rich_file(folder);
  std::mt19937 random(12);
  Outcomes outcomes;
  for (int i = 0; i < executions(3000); ++i) {
    GltfFile file = good;
    for (unsigned n = 1 + random() % 3; n > 0; --n) damage(file.json, random);
    if (random() % 4 == 0 && !file.binary.empty())
      file.binary[random() % file.binary.size()] ^= static_cast<char>(random());
    outcomes.import(folder.write("f.glb", file.glb()), "mutation " + std::to_string(i) + ": " + file.json.dump());
  }
  EXPECT_GT(outcomes.taken, 100);
  EXPECT_GT(outcomes.refused, 100);
}

TEST(Fuzz, DamagedObjAndMtl) {
  const Folder folder;
  folder.write_image("t.png", 2, 2, 3, std::vector<float>(12, 0.5f));
  const std::string obj =
      "mtllib m.mtl\no one\nv 0 0 0\nv 1 0 0\nv 1 1 0.5\nv 0 1 0\nv .2 .3 0 1\nvt 0 0\nvt 1 .5\nvn 0 0 1\nvn 0 1 0\n"
      "usemtl a\nf 1/1/1 2/2/2 3/1/1 4/2/2\nf 1//1 2//2 3//1\ng two\nusemtl b\nf -1 -2 -3 -4 -5\ns off\nusemtl c\n"
      "f 1/1 2/2 \\\n3/1\nl 1 2 3\n";
  const std::string mtl =
      "newmtl a\nKd .5 .5 .5\nKe 1 2 3\nmap_Kd -clamp on t.png\nd .5\nnewmtl b\nillum 7\nNi 1.5\nTf .1 .2 .3\n"
      "newmtl c\nillum 5\nKs .9 .9 .9\nNs 100\n";
  folder.write("m.mtl", mtl);
  ASSERT_NO_THROW(import_text(folder, "good.obj", obj));
  std::mt19937 random(13);
  Outcomes outcomes;
  for (int i = 0; i < executions(3000); ++i) {
    folder.write("m.mtl", i % 2 ? mtl : damaged(mtl, random));
    outcomes.import(folder.write("f.obj", i % 2 ? damaged(obj, random) : obj), "mutation " + std::to_string(i));
  }
  EXPECT_GT(outcomes.taken, 100);
  EXPECT_GT(outcomes.refused, 100);
}

TEST(Fuzz, DamagedPlyAndStl) {
  const Folder folder;
  const std::string head =
      "element vertex 4\nproperty float x\nproperty float y\nproperty float z\nproperty uchar red\nproperty uchar "
      "green\nproperty uchar blue\nelement face 2\nproperty list uchar int vertex_indices\nend_header\n";
  std::string binary = "ply\nformat binary_little_endian 1.0\n" + head;
  for (const auto& p : {std::array<float, 3>{0, 0, 0}, {1, 0, 0}, {1, 1, 0}, {0, 1, 0}})
    binary.append(reinterpret_cast<const char*>(p.data()), 12).append("\1\2\3");
  binary.append("\4\0\0\0\0\1\0\0\0\2\0\0\0\3\0\0\0\3\0\0\0\0\1\0\0\0\2\0\0\0", 30);
  const std::string text =
      "ply\nformat ascii 1.0\n" + head + "0 0 0 1 2 3\n1 0 0 1 2 3\n1 1 0 1 2 3\n0 1 0 1 2 3\n4 0 1 2 3\n3 0 1 2\n";
  std::string stl(80, ' ');
  stl.append("\2\0\0\0", 4).append(100, '\1');
  const std::string solid =
      "solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 "
      "0\nendloop\nendfacet\nendsolid\n";
  const std::pair<const char*, std::string> good[] = {
      {"f.ply", binary}, {"f.ply", text}, {"f.stl", stl}, {"f.stl", solid}};
  for (const auto& [name, bytes] : good) ASSERT_NO_THROW(import_text(folder, name, bytes));
  std::mt19937 random(14);
  Outcomes outcomes;
  for (int i = 0; i < executions(3000); ++i) {
    const auto& [name, bytes] = good[i % 4];
    outcomes.import(folder.write(name, damaged(bytes, random)), "mutation " + std::to_string(i));
  }
  EXPECT_GT(outcomes.taken, 100);
  EXPECT_GT(outcomes.refused, 100);
}

TEST(Fuzz, DamagedImages) {
  const Folder folder;
  std::vector<float> noise(3 * 8 * 8);
  std::mt19937 random(15);
  for (float& value : noise) value = static_cast<float>(random() % 256) / 255;
  GltfFile file = triangle_file();
  file.json["textures"] = {{{"source", 0}}};
  file.json["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"] = {{"index", 0}};
  Outcomes outcomes;
  const char* names[] = {"t.png", "t.jpg", "t.webp"};
  std::string good[3];
  for (int k = 0; k < 3; ++k) good[k] = contents(folder.write_image(names[k], 8, 8, 3, noise));
  for (int i = 0; i < executions(1500); ++i) {
    file.json["images"] = {{{"uri", names[i % 3]}}};
    folder.write(names[i % 3], damaged(good[i % 3], random));
    outcomes.import(folder.write("f.glb", file.glb()), "mutation " + std::to_string(i));
  }
  EXPECT_GT(outcomes.taken, 20);
  EXPECT_GT(outcomes.refused, 20);
}

TEST(Fuzz, DamagedEnvironments) {
  const Folder folder;
  std::vector<float> noise(3 * 8 * 4);
  std::mt19937 random(16);
  for (float& value : noise) value = static_cast<float>(random() % 256) / 16;
  const char* names[] = {"e.exr", "e.hdr"};
  std::string good[2];
  for (int k = 0; k < 2; ++k) good[k] = contents(folder.write_image(names[k], 8, 4, 3, noise));
  Outcomes outcomes;
  for (int i = 0; i < executions(1500); ++i)
    outcomes.import_sky(folder.write(names[i % 2], damaged(good[i % 2], random)), "mutation " + std::to_string(i));
  EXPECT_GT(outcomes.taken, 20);
  EXPECT_GT(outcomes.refused, 20);
}

}  // namespace
}  // namespace gleaner::scene

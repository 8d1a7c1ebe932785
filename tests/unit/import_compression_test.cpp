// Compressed geometry, encoded here by the libraries that people's tools use.

#include <draco/compression/encode.h>
#include <draco/mesh/triangle_soup_mesh_builder.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <meshoptimizer.h>

#include <fstream>
#include <random>

#include "import_files.h"
#include "scene/import/import.h"
#include "scene/model/error.h"

namespace gleaner::scene {
namespace {

using nlohmann::json;
using testing::AllOf;
using testing::ElementsAre;
using testing::FloatNear;
using testing::HasSubstr;
using testing::Pointwise;

using Floats = std::vector<float>;

class Compression : public testing::Test {
 protected:
  Scene read(const GltfFile& file) { return import_text(folder_, "scene.glb", file.glb()); }
  std::string refused(const GltfFile& file) { return refusal(folder_.write("scene.glb", file.glb())); }
  Folder folder_;
};

std::string_view bytes_of(const std::vector<unsigned char>& v) {
  return {reinterpret_cast<const char*>(v.data()), v.size()};
}

// The file's view `view`, replaced by what `encoded` decodes to.
void compress(GltfFile& file, std::size_t view, const std::vector<unsigned char>& encoded, const char* mode,
              std::size_t stride, std::size_t count, const char* filter = "NONE") {
  const std::size_t packed = file.add_view(bytes_of(encoded));
  json compression = file.json["bufferViews"][packed];
  compression["mode"] = mode;
  compression["byteStride"] = stride;
  compression["count"] = count;
  compression["filter"] = filter;
  file.json["bufferViews"].erase(packed);
  json& fallback = file.json["bufferViews"][view];
  fallback["buffer"] = 1;
  fallback["byteOffset"] = 0;
  fallback["extensions"]["EXT_meshopt_compression"] = compression;
}

// The triangle with its positions and indices compressed by meshoptimizer; buffer 1 stands for what is not there.
GltfFile packed_triangle() {
  GltfFile file = triangle_file();
  const float positions[] = {0, 0, 0, 1, 0, 0, 0, 1, 0};
  std::vector<unsigned char> encoded(meshopt_encodeVertexBufferBound(3, 12));
  encoded.resize(meshopt_encodeVertexBuffer(encoded.data(), encoded.size(), positions, 3, 12));
  const unsigned indices[] = {0, 1, 2};
  std::vector<unsigned char> corners(meshopt_encodeIndexBufferBound(3, 3));
  corners.resize(meshopt_encodeIndexBuffer(corners.data(), corners.size(), indices, 3));
  compress(file, 0, encoded, "ATTRIBUTES", 12, 3);
  compress(file, 1, corners, "TRIANGLES", 2, 3);
  file.json["buffers"] = {{{"byteLength", file.binary.size()}}, {{"byteLength", 48}}};
  file.json["buffers"][1]["extensions"]["EXT_meshopt_compression"]["fallback"] = true;
  file.json["extensionsRequired"] = file.json["extensionsUsed"] = {"EXT_meshopt_compression"};
  return file;
}

TEST_F(Compression, Meshoptimizer) {
  const Scene s = read(packed_triangle());
  EXPECT_THAT(s.positions, ElementsAre(0, 0, 0, 1, 0, 0, 0, 1, 0));
  EXPECT_EQ(s.triangle_count(), 1u);
}

TEST_F(Compression, MeshoptimizersFilters) {
  GltfFile file = packed_triangle();
  // Octahedral normals of four bytes, (0, 0, 1) each.
  const float normals[] = {0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1, 0};
  std::vector<signed char> filtered(12);
  meshopt_encodeFilterOct(filtered.data(), 3, 4, 8, normals);
  std::vector<unsigned char> encoded(meshopt_encodeVertexBufferBound(3, 4));
  encoded.resize(meshopt_encodeVertexBuffer(encoded.data(), encoded.size(), filtered.data(), 3, 4));
  file.json["bufferViews"].push_back({{"buffer", 1}, {"byteOffset", 0}, {"byteLength", 12}, {"byteStride", 4}});
  const std::size_t view = file.json["bufferViews"].size() - 1;
  compress(file, view, encoded, "ATTRIBUTES", 4, 3, "OCTAHEDRAL");
  file.json["buffers"][0]["byteLength"] = file.binary.size();
  file.json["accessors"].push_back(
      {{"bufferView", view}, {"componentType", 5120}, {"normalized", true}, {"count", 3}, {"type", "VEC3"}});
  file.primitive()["attributes"]["NORMAL"] = file.json["accessors"].size() - 1;
  EXPECT_THAT(read(file).normals, Pointwise(FloatNear(1e-3f), Floats{0, 0, 1, 0, 0, 1, 0, 0, 1}));
}

TEST_F(Compression, BadMeshoptimizerData) {
  const auto with = [&](const char* key, const json& value) {
    GltfFile file = packed_triangle();
    file.json["bufferViews"][0]["extensions"]["EXT_meshopt_compression"][key] = value;
    return refused(file);
  };
  EXPECT_THAT(with("mode", "POINTS"), HasSubstr("EXT_meshopt_compression.mode"));
  EXPECT_THAT(with("mode", "TRIANGLES"), HasSubstr("byteStride"));
  EXPECT_THAT(with("filter", "SMOOTH"), HasSubstr("filter"));
  EXPECT_THAT(with("filter", "QUATERNION"), HasSubstr("byteStride"));
  EXPECT_THAT(with("byteStride", 10), HasSubstr("a multiple of 4"));
  EXPECT_THAT(with("count", 4000000000u), HasSubstr("compressed bytes can hold"));
  EXPECT_THAT(with("count", 300), HasSubstr("data that meshoptimizer can decode"));
  EXPECT_THAT(with("byteLength", 5), HasSubstr("data that meshoptimizer can decode"));
  EXPECT_THAT(with("byteLength", 500000), HasSubstr("bytes within"));
  EXPECT_THAT(with("buffer", 9), HasSubstr("buffer"));
}

// A grid of 8 x 8 quads, as Draco would have it.
GltfFile draco_grid() {
  GltfFile file;
  draco::TriangleSoupMeshBuilder builder;
  constexpr int n = 8;
  builder.Start(2 * n * n);
  const int position = builder.AddAttribute(draco::GeometryAttribute::POSITION, 3, draco::DT_FLOAT32);
  const int color = builder.AddAttribute(draco::GeometryAttribute::COLOR, 3, draco::DT_FLOAT32);
  int face = 0;
  for (int y = 0; y < n; ++y)
    for (int x = 0; x < n; ++x)
      for (int half = 0; half < 2; ++half) {
        const int at[2][3][2] = {{{x, y}, {x + 1, y}, {x + 1, y + 1}}, {{x, y}, {x + 1, y + 1}, {x, y + 1}}};
        float p[3][3], c[3][3];
        for (int k = 0; k < 3; ++k) {
          p[k][0] = float(at[half][k][0]), p[k][1] = float(at[half][k][1]), p[k][2] = 0;
          c[k][0] = p[k][0] / n, c[k][1] = 0.5f, c[k][2] = 1;
        }
        builder.SetAttributeValuesForFace(position, draco::FaceIndex(face), p[0], p[1], p[2]);
        builder.SetAttributeValuesForFace(color, draco::FaceIndex(face++), c[0], c[1], c[2]);
      }
  const auto mesh = builder.Finalize();
  draco::EncoderBuffer buffer;
  draco::Encoder encoder;
  encoder.SetAttributeQuantization(draco::GeometryAttribute::POSITION, 14);
  if (!encoder.EncodeMeshToBuffer(*mesh, &buffer).ok()) throw std::runtime_error("draco");
  const std::size_t view = file.add_view({buffer.data(), buffer.size()});
  const std::size_t points = mesh->num_points();
  file.json["accessors"] = {{{"componentType", 5126}, {"count", points}, {"type", "VEC3"}},
                            {{"componentType", 5126}, {"count", points}, {"type", "VEC3"}},
                            {{"componentType", 5125}, {"count", 6 * n * n}, {"type", "SCALAR"}}};
  file.primitive()["attributes"] = {{"POSITION", 0}, {"COLOR_0", 1}};
  file.primitive()["indices"] = 2;
  json& extension = file.primitive()["extensions"]["KHR_draco_mesh_compression"];
  extension["bufferView"] = view;
  extension["attributes"] = {{"POSITION", mesh->GetNamedAttribute(draco::GeometryAttribute::POSITION)->unique_id()},
                             {"COLOR_0", mesh->GetNamedAttribute(draco::GeometryAttribute::COLOR)->unique_id()}};
  file.json["extensionsRequired"] = file.json["extensionsUsed"] = {"KHR_draco_mesh_compression"};
  return file;
}

TEST_F(Compression, Draco) {
  const Scene s = read(draco_grid());
  EXPECT_EQ(s.triangle_count(), 128u);
  double area = 0;
  for (std::size_t t = 0; t < s.triangle_count(); ++t) {
    const float* p[3];
    for (std::size_t k = 0; k < 3; ++k) p[k] = &s.positions[3 * s.indices[3 * t + k]];
    area += ((p[1][0] - p[0][0]) * (p[2][1] - p[0][1]) - (p[1][1] - p[0][1]) * (p[2][0] - p[0][0])) / 2;
  }
  EXPECT_NEAR(area, 64, 0.1);
  ASSERT_EQ(s.colors.size(), 4 * s.vertex_count());
  for (std::size_t v = 0; v < s.vertex_count(); ++v)
    EXPECT_NEAR(s.colors[4 * v] / 65535.0, s.positions[3 * v] / 8, 0.01);
}

TEST_F(Compression, BadDracoData) {
  GltfFile file = draco_grid();
  file.json["accessors"][2]["count"] = 30;
  EXPECT_THAT(refused(file), HasSubstr("as its accessors say"));
  file = draco_grid();
  file.primitive()["extensions"]["KHR_draco_mesh_compression"]["attributes"]["POSITION"] = 77;
  EXPECT_THAT(refused(file), HasSubstr("an attribute of the Draco mesh"));
  // Damage of every kind ends in a word or in a scene.
  const GltfFile good = draco_grid();
  std::mt19937 random(5);
  int refusals = 0;
  for (int i = 0; i < 500; ++i) {
    file = good;
    for (unsigned n = 1 + random() % 3; n > 0; --n)
      file.binary[random() % file.binary.size()] = static_cast<char>(random());
    refusals += !refused(file).empty();
  }
  EXPECT_GT(refusals, 10);
}

TEST_F(Compression, WebpTextures) {
  folder_.write_image("t.webp", 2, 2, 3, {1, 0, 0, 1, 0, 0, 1, 0, 0, 1, 0, 0});
  folder_.write_image("t.png", 1, 1, 3, {0, 0, 1});
  GltfFile file = triangle_file();
  file.json["images"] = {{{"uri", "t.png"}}, {{"uri", "t.webp"}, {"mimeType", "image/webp"}}};
  file.json["textures"] = {{{"source", 0}}};
  file.json["textures"][0]["extensions"]["EXT_texture_webp"]["source"] = 1;
  file.json["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"] = {{"index", 0}};
  file.primitive()["attributes"]["TEXCOORD_0"] = file.add<float>({0, 0, 1, 0, 0, 1}, 5126, "VEC2");
  const Scene s = read(file);
  EXPECT_EQ(s.textures.at(0).width, 2u);
  EXPECT_GT(s.texels[0] & 255, 200u);
  EXPECT_LT(s.texels[0] >> 16 & 255, 60u);
  // Embedded in the buffer, as exporters do it.
  std::ifstream stream(folder_.path("t.webp"), std::ios::binary);
  const std::string bytes{std::istreambuf_iterator<char>(stream), {}};
  file.json["images"][1] = {{"bufferView", file.add_view(bytes)}, {"mimeType", "image/webp"}};
  EXPECT_EQ(read(file).textures.at(0).width, 2u);
}

}  // namespace
}  // namespace gleaner::scene

// Textures, wherever they come from, and environments.

#include <OpenImageIO/imageio.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <fstream>
#include <functional>
#include <limits>
#include <numbers>
#include <random>

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

constexpr std::uint32_t rgba(std::uint32_t r, std::uint32_t g, std::uint32_t b, std::uint32_t a = 255) {
  return a << 24 | b << 16 | g << 8 | r;
}

std::string contents(const std::string& path) {
  std::ifstream stream(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(stream), {}};
}

std::vector<float> noise(std::size_t count) {
  std::mt19937 random(5);
  std::vector<float> values(count);
  for (float& v : values) v = static_cast<float>(random() % 256) / 255;
  return values;
}

class Textures : public testing::Test {
 protected:
  // triangle_file() with uvs, whose base colour is texture 0 of image 0.
  GltfFile textured(const json& image) {
    GltfFile file = triangle_file();
    file.primitive()["attributes"]["TEXCOORD_0"] = file.add<float>({0, 0, 1, 0, 0, 1}, 5126, "VEC2");
    file.json["images"] = {image};
    file.json["textures"] = {{{"source", 0}}};
    file.json["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"] = {{"index", 0}};
    return file;
  }
  Scene read(const GltfFile& file) { return import_text(folder_, "scene.glb", file.glb()); }
  std::string refused(const GltfFile& file) { return refusal(folder_.write("scene.glb", file.glb())); }

  Folder folder_;
};

TEST_F(Textures, RowsBeginAtTheTop) {
  folder_.write_image("t.png", 2, 2, 3, {1, 0, 0, 0, 1, 0, /**/ 0, 0, 1, 1, 1, 1});
  const Scene s = read(textured({{"uri", "t.png"}}));
  ASSERT_EQ(s.textures.size(), 1u);
  EXPECT_EQ(s.textures[0].width, 2u);
  EXPECT_EQ(s.textures[0].height, 2u);
  EXPECT_EQ(s.textures[0].flags, GLEANER_TEXTURE_SRGB);
  EXPECT_EQ(s.textures[0].wrap_u, GLEANER_WRAP_REPEAT);
  EXPECT_THAT(s.texels, ElementsAre(rgba(255, 0, 0), rgba(0, 255, 0), rgba(0, 0, 255), rgba(255, 255, 255)));
  EXPECT_THAT(s.uvs, ElementsAre(0, 0, 1, 0, 0, 1));
  EXPECT_EQ(s.materials[0].base_color_texture, 0u);
}

TEST_F(Textures, EveryNumberOfChannels) {
  folder_.write_image("t.png", 2, 1, 1, {0, 1});
  EXPECT_THAT(read(textured({{"uri", "t.png"}})).texels, ElementsAre(rgba(0, 0, 0), rgba(255, 255, 255)));
  folder_.write_image("t.png", 2, 1, 2, {1, 0, 0.2f, 0.4f});
  EXPECT_THAT(read(textured({{"uri", "t.png"}})).texels, ElementsAre(rgba(255, 255, 255, 0), rgba(51, 51, 51, 102)));
  // Colour is not multiplied by alpha, not even where alpha is 0.
  folder_.write_image("t.png", 2, 1, 4, {1, 0.2f, 0, 0, 1, 0.4f, 0, 0.6f});
  EXPECT_THAT(read(textured({{"uri", "t.png"}})).texels, ElementsAre(rgba(255, 51, 0, 0), rgba(255, 102, 0, 153)));
}

TEST_F(Textures, SixteenBitsAreReducedWithAWord) {
  folder_.write_image("t.png", 1, 1, 3, {1, 0.2f, 0}, true);
  const Scene s = read(textured({{"uri", "t.png"}}));
  EXPECT_THAT(s.texels, ElementsAre(rgba(255, 51, 0)));
  EXPECT_THAT(s.warnings, Contains(AllOf(HasSubstr("images[0].uri"), HasSubstr("8 bits"))));
}

TEST_F(Textures, Jpeg) {
  folder_.write_image("t.jpg", 16, 8, 3, std::vector<float>(3 * 16 * 8, 0.5f));
  const Scene s = read(textured({{"uri", "t.jpg"}}));
  EXPECT_EQ(s.textures[0].width, 16u);
  EXPECT_EQ(s.textures[0].height, 8u);
  for (const std::uint32_t texel : s.texels) {
    EXPECT_NEAR(double(texel & 255), 127.5, 2);
    EXPECT_EQ(texel >> 24, 255u);
  }
}

TEST_F(Textures, MayBeEmbedded) {
  for (const char* name : {"t.png", "t.jpg"}) {
    const std::string bytes = contents(folder_.write_image(name, 8, 8, 3, std::vector<float>(3 * 64, 1)));
    std::filesystem::remove(folder_.path(name));
    const Scene a = read(textured({{"uri", "data:image/png;base64," + base64(bytes)}}));
    ASSERT_EQ(a.texels.size(), 64u);
    EXPECT_EQ(a.texels[9], rgba(255, 255, 255));
    GltfFile file = textured({{"mimeType", "image/png"}});
    file.json["images"][0]["bufferView"] = file.add_view(bytes);
    EXPECT_EQ(read(file).texels, a.texels);
  }
}

TEST_F(Textures, TexelsAreSharedBySamplersAndMeanings) {
  folder_.write_image("a.png", 4, 4, 3, std::vector<float>(48, 1));
  folder_.write_image("b.png", 2, 2, 3, std::vector<float>(12, 1));
  GltfFile file = textured({{"uri", "a.png"}});
  file.json["images"].push_back({{"uri", "b.png"}});
  file.json["images"].push_back({{"uri", "./a.png"}});  // the same file
  file.json["samplers"] = {{{"wrapS", 33071}, {"wrapT", 33648}}, {{"wrapS", 10497}}};
  file.json["textures"] = {{{"source", 0}},
                           {{"source", 1}},
                           {{"source", 0}, {"sampler", 0}},
                           {{"source", 2}},
                           {{"source", 0}, {"sampler", 1}}};
  json& m = file.json["materials"][0];
  m["normalTexture"] = {{"index", 1}, {"scale", 0.5}};
  m["emissiveTexture"] = {{"index", 2}};
  m["pbrMetallicRoughness"]["metallicRoughnessTexture"] = {{"index", 0}};
  json other;
  other["pbrMetallicRoughness"]["baseColorTexture"] = {{"index", 3}};
  other["emissiveTexture"] = {{"index", 4}};
  file.json["materials"].push_back(other);
  const Scene s = read(file);
  EXPECT_EQ(s.texels.size(), 16u + 4u);
  const Material& first = s.materials[0];
  const auto texture = [&](gl_uint index) { return s.textures.at(index); };
  EXPECT_EQ(texture(first.base_color_texture).flags, GLEANER_TEXTURE_SRGB);
  EXPECT_EQ(texture(first.metallic_roughness_texture).flags, 0u);
  EXPECT_EQ(texture(first.metallic_roughness_texture).first_texel, texture(first.base_color_texture).first_texel);
  EXPECT_EQ(texture(first.emission_texture).wrap_u, GLEANER_WRAP_CLAMP);
  EXPECT_EQ(texture(first.emission_texture).wrap_v, GLEANER_WRAP_MIRROR);
  EXPECT_EQ(texture(first.normal_texture).width, 2u);
  EXPECT_FLOAT_EQ(first.normal_scale, 0.5f);
  EXPECT_EQ(s.materials[1].base_color_texture, first.base_color_texture);
  EXPECT_EQ(s.materials[1].emission_texture, first.base_color_texture);
  EXPECT_EQ(s.textures.size(), 4u);
}

TEST_F(Textures, TransformsAndSetsAreBakedIntoTheCoordinates) {
  folder_.write_image("t.png", 1, 1, 3, {1, 1, 1});
  GltfFile file = textured({{"uri", "t.png"}});
  file.primitive()["attributes"]["TEXCOORD_1"] = file.add<float>({1, 0, 0, 1, 2, 2}, 5126, "VEC2");
  json& info = file.json["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"];
  info["texCoord"] = 1;
  EXPECT_THAT(read(file).uvs, ElementsAre(1, 0, 0, 1, 2, 2));
  file.json["extensionsRequired"] = file.json["extensionsUsed"] = {"KHR_texture_transform"};
  info["extensions"]["KHR_texture_transform"] = {
      {"offset", {0.25, 0.5}}, {"rotation", std::numbers::pi / 2}, {"scale", {2, 3}}};
  // The extension's matrices: translation * rotation * scale, with (u, v) -> (v, -u) for a quarter turn.
  const Scene s = read(file);
  EXPECT_THAT(s.uvs, Pointwise(FloatNear(1e-5f), std::vector<float>{0.25f, -1.5f, 3.25f, 0.5f, 6.25f, -3.5f}));
  EXPECT_THAT(s.warnings, Not(Contains(HasSubstr("transform"))));
  // A second texture with other coordinates: the first's set is the first channel, each has its transform.
  file.json["materials"][0]["emissiveTexture"] = {{"index", 0}};
  const Scene both = read(file);
  EXPECT_THAT(both.uvs, Pointwise(FloatNear(1e-5f), std::vector<float>{0.25f, -1.5f, 3.25f, 0.5f, 6.25f, -3.5f}));
  EXPECT_THAT(both.second_uvs, ElementsAre(0, 0, 1, 0, 0, 1));
  EXPECT_EQ(both.textures[both.materials[0].base_color_texture].uv_set, 0u);
  EXPECT_EQ(both.textures[both.materials[0].emission_texture].uv_set, 1u);
  // Two of one set, laid on differently: the vertices have the set as it is.
  file.json["materials"][0]["emissiveTexture"] = {{"index", 0}, {"texCoord", 1}};
  const Scene apart = read(file);
  EXPECT_THAT(apart.uvs, ElementsAre(1, 0, 0, 1, 2, 2));
  EXPECT_TRUE(apart.second_uvs.empty());
  const Texture& turned = apart.textures[apart.materials[0].base_color_texture];
  EXPECT_THAT(turned.transform, Pointwise(FloatNear(1e-5f), std::vector<float>{0, 3, 0.25f, -2, 0, 0.5f}));
  EXPECT_THAT(apart.textures[apart.materials[0].emission_texture].transform, ElementsAre(1, 0, 0, 0, 1, 0));
}

TEST_F(Textures, WithoutCoordinatesGetAWord) {
  folder_.write_image("t.png", 1, 1, 3, {1, 1, 1});
  GltfFile file = textured({{"uri", "t.png"}});
  file.primitive()["attributes"].erase("TEXCOORD_0");
  const Scene s = read(file);
  EXPECT_THAT(s.uvs, ElementsAre(0, 0, 0, 0, 0, 0));
  EXPECT_THAT(s.warnings, Contains(HasSubstr("no TEXCOORD_0")));
}

TEST_F(Textures, PathsStayInTheScenesFolder) {
  folder_.write_image("secret.png", 1, 1, 3, {1, 1, 1});
  folder_.write_image("scene/t.png", 1, 1, 3, {1, 1, 1});
  std::filesystem::create_symlink(folder_.path("secret.png"), folder_.path("scene/link.png"));
  std::filesystem::create_symlink("t.png", folder_.path("scene/own.png"));
  std::filesystem::create_directory_symlink(folder_.path(""), folder_.path("scene/up"));
  const auto said = [&](const std::string& uri) {
    return refusal(folder_.write("scene/scene.glb", textured({{"uri", uri}}).glb()));
  };
  for (const char* uri : {"../secret.png", "sub/../../secret.png", "%2E%2E/secret.png", "link.png", "up/secret.png",
                          "..", "up", "/etc/hostname"}) {
    EXPECT_THAT(said(uri), AllOf(HasSubstr("images[0].uri"), HasSubstr("inside the scene's folder"))) << uri;
  }
  EXPECT_THAT(said(folder_.path("scene/t.png")), HasSubstr("inside the scene's folder"));  // absolute
  EXPECT_THAT(said("https://example.org/t.png"), HasSubstr("found none"));
  EXPECT_EQ(said("own.png"), "");
  EXPECT_EQ(said("sub/../t.png"), "");
  // The same when the scene is named without a folder.
  const auto before = std::filesystem::current_path();
  std::filesystem::current_path(folder_.path("scene"));
  EXPECT_EQ(import_scene("scene.glb").texels.size(), 1u);
  EXPECT_THAT(said("../secret.png"), HasSubstr("inside"));
  EXPECT_THAT(refusal("scene.glb"), HasSubstr("inside"));
  std::filesystem::current_path(before);
}

TEST_F(Textures, BadOnesAreNamed) {
  folder_.write("text.png", "this is no image at all, though it is long enough");
  folder_.write("movie.null", "null reader of OpenImageIO");
  folder_.write("empty.png", "");
  std::filesystem::create_directory(folder_.path("folder.png"));
  const std::string good = contents(folder_.write_image("good.png", 64, 64, 3, std::vector<float>(3 * 64 * 64, 0.3f)));
  const auto word = [](const std::string& uri) { return testing::AllOf(HasSubstr("images[0].uri"), HasSubstr(uri)); };
  for (const char* name : {"missing.png", "text.png", "movie.null", "folder.png", "empty.png"})
    EXPECT_THAT(refused(textured({{"uri", name}})), word(name)) << name;
  folder_.write("cut.png", good.substr(0, good.size() / 2));
  EXPECT_THAT(refused(textured({{"uri", "cut.png"}})), word("cut.png"));
  folder_.write("head.png", good.substr(0, 20));
  EXPECT_THAT(refused(textured({{"uri", "head.png"}})), word("head.png"));
  const std::string jpeg = contents(folder_.write_image("good.jpg", 64, 64, 3, noise(3 * 64 * 64)));
  folder_.write("cut.jpg", jpeg.substr(0, jpeg.size() / 2));
  EXPECT_THAT(refused(textured({{"uri", "cut.jpg"}})), word("cut.jpg"));
  EXPECT_THAT(refused(textured({{"uri", "data:image/jpeg;base64," + base64(jpeg.substr(0, jpeg.size() / 2))}})),
              HasSubstr("images[0].uri"));
  EXPECT_THAT(refused(textured({{"uri", "data:image/png;base64,"}})), HasSubstr("images[0].uri"));
  EXPECT_THAT(refused(textured({{"uri", "data:image/png;base64," + base64(good.substr(0, 60))}})),
              HasSubstr("images[0].uri"));
  // GIFs: cut short, noise behind a header, and a canvas of 17 GB, which their reader would take at once.
  const std::string canvas("GIF89a\x10\x00\x10\x00\x80\x00\x00\x00\x00\x00\xff\xff\xff", 19);
  std::string noisy = "GIF89a";
  for (int i = 0; i < 200; ++i) noisy += static_cast<char>(i);
  for (const auto& [name, bytes] : {std::pair<const char*, std::string>("cut.gif", canvas + ",1234"),
                                    {"head.gif", "GIF89a"},
                                    {"noise.gif", noisy},
                                    {"huge.gif", "GIF89a\xff\xff\xff\xff" + canvas.substr(10)},
                                    {"large.gif", std::string("GIF89a\x00\x40\x00\x40", 10) + canvas.substr(10)}}) {
    folder_.write(name, bytes);
    EXPECT_THAT(refused(textured({{"uri", name}})), word(name)) << name;
  }
  EXPECT_THAT(refused(textured({{"name", "nothing"}})), AllOf(HasSubstr("images[0].bufferView"), HasSubstr("none")));
  GltfFile file = textured({{"uri", "good.png"}});
  file.json["textures"][0].erase("source");
  EXPECT_THAT(import_text(folder_, "scene.glb", file.glb()).warnings, Contains(HasSubstr("textures[0]: no image")));
  file = textured({{"uri", "good.png"}});
  file.json["samplers"] = {{{"wrapS", 5}}};
  file.json["textures"][0]["sampler"] = 0;
  EXPECT_THAT(refused(file), AllOf(HasSubstr("samplers[0].wrapS"), HasSubstr("found 5")));
  // An image that no material wants may be missing.
  file = triangle_file();
  file.json["images"] = {{{"uri", "missing.png"}}};
  EXPECT_EQ(refused(file), "");
}

// A PNG whose header promises more than may be taken; the rest is never looked at.
TEST_F(Textures, SizesAreCheckedBeforeMemoryIsTaken) {
  const std::string good = contents(folder_.write_image("good.png", 4, 4, 3, std::vector<float>(48, 0.3f)));
  const auto crc = [](std::string_view bytes) {
    std::uint32_t c = 0xffffffff;
    for (const unsigned char b : bytes) {
      c ^= b;
      for (int k = 0; k < 8; ++k) c = c >> 1 ^ (c & 1 ? 0xedb88320u : 0);
    }
    return ~c;
  };
  const auto big_endian = [](std::string& to, std::size_t at, std::uint32_t value) {
    for (int k = 0; k < 4; ++k) to[at + std::size_t(k)] = static_cast<char>(value >> (24 - 8 * k));
  };
  for (const auto& [width, height] : {std::pair{16385u, 4u}, {4u, 16385u}, {0u, 4u}, {200000u, 200000u}}) {
    std::string bomb = good;
    big_endian(bomb, 16, width);
    big_endian(bomb, 20, height);
    big_endian(bomb, 29, crc(std::string_view(bomb).substr(12, 17)));
    folder_.write("bomb.png", bomb);
    EXPECT_THAT(refused(textured({{"uri", "bomb.png"}})), AllOf(HasSubstr("images[0].uri"), HasSubstr("bomb.png")))
        << width << "x" << height;
  }
  // Five of 16384 x 16384 are too many together, though each alone is not.
  std::string large = good;
  big_endian(large, 16, 16384);
  big_endian(large, 20, 16384);
  big_endian(large, 29, crc(std::string_view(large).substr(12, 17)));
  // Too little for its texels, even of one bit.
  folder_.write("small.png", large);
  EXPECT_THAT(refused(textured({{"uri", "small.png"}})), AllOf(HasSubstr("small.png"), HasSubstr("as many bytes")));
  large.append(40000, '\0');
  GltfFile file = triangle_file();
  for (int i = 0; i < 5; ++i) {
    folder_.write("large" + std::to_string(i) + ".png", large);
    file.json["images"].push_back({{"uri", "large" + std::to_string(i) + ".png"}});
    file.json["textures"].push_back({{"source", i}});
    json m;
    m["pbrMetallicRoughness"]["baseColorTexture"]["index"] = i;
    file.json["materials"].push_back(m);
  }
  EXPECT_THAT(refused(file), AllOf(HasSubstr("images[4].uri"), HasSubstr("texels in all")));
}

// --- environments ---------------------------------------------------------------------------------------------------

std::string environment_refusal(const std::string& path) {
  try {
    import_environment(path);
  } catch (const Error& error) {
    EXPECT_EQ(error.kind(), ErrorKind::bad_input);
    EXPECT_TRUE(std::string(error.what()).starts_with(path)) << error.what();
    return error.what();
  }
  return "";
}

TEST(EnvironmentImport, ReadsExrAndHdr) {
  const Folder folder;
  const std::vector<float> values = {1, 2, 4, 0.5f, 0, 8, 16, 0.25f, 1, 32, 64, 128};
  const Environment exr = import_environment(folder.write_image("e.exr", 2, 2, 3, values));
  EXPECT_EQ(exr.width, 2u);
  EXPECT_EQ(exr.height, 2u);
  EXPECT_EQ(exr.radiance, values);
  const Environment hdr = import_environment(folder.write_image("e.hdr", 2, 2, 3, values));
  ASSERT_EQ(hdr.radiance.size(), values.size());
  for (std::size_t i = 0; i < values.size(); ++i)
    EXPECT_NEAR(hdr.radiance[i], values[i], 0.01 * *std::max_element(&values[i / 3 * 3], &values[i / 3 * 3] + 3));
}

TEST(EnvironmentImport, GreyIsWhiteAndAlphaIsDropped) {
  const Folder folder;
  EXPECT_THAT(import_environment(folder.write_image("g.exr", 2, 1, 1, {3, 5})).radiance, ElementsAre(3, 3, 3, 5, 5, 5));
  EXPECT_THAT(import_environment(folder.write_image("a.exr", 1, 1, 4, {3, 5, 7, 0.5f})).radiance, ElementsAre(3, 5, 7));
}

// What lossy compression and overflowing suns leave in published skies.
TEST(EnvironmentImport, PixelsThatCannotBeAreMendedAndCounted) {
  const Folder folder;
  const float nan = std::numeric_limits<float>::quiet_NaN(), infinity = std::numeric_limits<float>::infinity();
  std::vector<std::string> warnings;
  const Environment e = import_environment(
      folder.write_image("n.exr", 2, 2, 3, {1, -0.25f, 2, nan, 1, 1, 3, infinity, 4, -1, -2, 5}), {}, &warnings);
  EXPECT_THAT(e.radiance, ElementsAre(1, 0, 2, 0, 1, 1, 3, 65504, 4, 0, 0, 5));
  EXPECT_THAT(warnings,
              ElementsAre(AllOf(HasSubstr("2 negative"), HasSubstr("1 not numbers"), HasSubstr("1 infinite"))));
}

TEST(EnvironmentImport, RotationAndStrength) {
  const Folder folder;
  const std::string path = folder.write_image("r.exr", 4, 1, 3, {1, 1, 1, 2, 2, 2, 3, 3, 3, 4, 4, 4});
  // A direction is (sin t sin p, cos t, -sin t cos p), p = 2 pi u: turned counter-clockwise about +y, what stood at p
  // stands at p less the angle.
  EXPECT_THAT(import_environment(path, {90, 10}).radiance, ElementsAre(20, 20, 20, 30, 30, 30, 40, 40, 40, 10, 10, 10));
  EXPECT_THAT(import_environment(path, {-450, 1}).radiance, ElementsAre(4, 4, 4, 1, 1, 1, 2, 2, 2, 3, 3, 3));
  EXPECT_THAT(import_environment(path, {45, 1}).radiance,
              ElementsAre(1.5f, 1.5f, 1.5f, 2.5f, 2.5f, 2.5f, 3.5f, 3.5f, 3.5f, 2.5f, 2.5f, 2.5f));
  EXPECT_THROW(import_environment(path, {std::nan(""), 1}), Error);
  EXPECT_THROW(import_environment(path, {0, -1}), Error);
}

TEST(EnvironmentImport, HalfDwaTilesAndCroppedWindows) {
  const Folder folder;
  const auto write = [&](const std::string& name, const std::function<void(OIIO::ImageSpec&)>& change) {
    OIIO::ImageSpec spec(8, 4, 3, OIIO::TypeDesc::HALF);
    change(spec);
    const std::vector<float> values(std::size_t(3 * spec.width * spec.height), 0.5f);
    const auto out = OIIO::ImageOutput::create("openexr");
    if (!out->open(folder.path(name), spec)) throw std::runtime_error(out->geterror());
    const bool done = spec.tile_width ? out->write_tiles(0, 8, 0, 4, 0, 1, OIIO::TypeDesc::FLOAT, values.data())
                                      : out->write_image(OIIO::TypeDesc::FLOAT, values.data());
    if (!done || !out->close()) throw std::runtime_error(out->geterror());
    return folder.path(name);
  };
  for (const char* compression : {"none", "zip", "piz", "dwaa", "b44"})
    EXPECT_THAT(
        import_environment(write("c.exr", [&](auto& spec) { spec.attribute("compression", compression); })).radiance,
        testing::Each(testing::FloatNear(0.5f, 2e-3f)))
        << compression;
  EXPECT_THAT(import_environment(write("t.exr", [](auto& spec) { spec.tile_width = spec.tile_height = 4; })).radiance,
              testing::Each(0.5f));
  std::vector<std::string> warnings;
  const Environment cropped = import_environment(write("w.exr",
                                                       [](auto& spec) {
                                                         spec.width = 2, spec.height = 2;
                                                         spec.x = 3, spec.y = 1;
                                                         spec.full_width = 8, spec.full_height = 4;
                                                       }),
                                                 {}, &warnings);
  EXPECT_EQ(cropped.width, 8u);
  EXPECT_EQ(cropped.height, 4u);
  EXPECT_EQ(cropped.radiance[3 * (1 * 8 + 3)], 0.5f);
  EXPECT_EQ(cropped.radiance[3 * (1 * 8 + 5)], 0.0f);
  EXPECT_THAT(warnings, ElementsAre(HasSubstr("data window")));
}

TEST(EnvironmentImport, BadOnesAreNamed) {
  const Folder folder;
  EXPECT_THAT(environment_refusal(folder.write_image("s.exr", 20000, 1, 1, std::vector<float>(20000))),
              HasSubstr("20000x1"));
  EXPECT_THAT(environment_refusal(folder.write("t.exr", "no image")), HasSubstr("an image"));
  EXPECT_THAT(environment_refusal(folder.write("t.hdr", "no image")), HasSubstr("an image"));
  EXPECT_THAT(environment_refusal(folder.write("e.exr", "")), HasSubstr("0 bytes"));
  EXPECT_THAT(environment_refusal(folder.path("none.hdr")), HasSubstr("none"));
  EXPECT_THAT(environment_refusal(folder.write("t.png", "x")), HasSubstr(".exr or .hdr"));
  const std::string good = contents(folder.write_image("g.exr", 64, 64, 3, std::vector<float>(3 * 64 * 64, 0.3f)));
  EXPECT_NE(environment_refusal(folder.write("cut.exr", good.substr(0, good.size() / 2))), "");
}

}  // namespace
}  // namespace gleaner::scene

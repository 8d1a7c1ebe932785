#include "import_files.h"

#include <OpenImageIO/imageio.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <fstream>

#include "scene/import/import.h"
#include "scene/model/error.h"

namespace gleaner::scene {

Folder::Folder() {
  std::string pattern = (std::filesystem::temp_directory_path() / "gleaner-import-XXXXXX").string();
  if (!mkdtemp(pattern.data())) throw std::runtime_error("no temporary folder");
  root_ = pattern;
}

Folder::~Folder() {
  std::error_code ignored;
  std::filesystem::remove_all(root_, ignored);
}

std::string Folder::write(const std::string& name, std::string_view text) const {
  const std::filesystem::path file = root_ / name;
  std::filesystem::create_directories(file.parent_path());
  // ext4 waits for the disk where a file is cut to nothing and written again, but not for a new one.
  std::filesystem::remove(file);
  std::ofstream(file, std::ios::binary).write(text.data(), static_cast<std::streamsize>(text.size()));
  return file.string();
}

std::string Folder::write_image(const std::string& name, int width, int height, int channels,
                                const std::vector<float>& values, bool sixteen_bits) const {
  const std::filesystem::path file = root_ / name;
  std::filesystem::create_directories(file.parent_path());
  const auto out = OIIO::ImageOutput::create(file.string());
  const std::string extension = file.extension().string();
  const bool is_float = extension == ".exr" || extension == ".hdr";
  OIIO::ImageSpec spec(width, height, channels,
                       is_float       ? OIIO::TypeDesc::FLOAT
                       : sixteen_bits ? OIIO::TypeDesc::UINT16
                                      : OIIO::TypeDesc::UINT8);
  spec.attribute("oiio:UnassociatedAlpha", 1);
  if (!out || !out->open(file.string(), spec) || !out->write_image(OIIO::TypeDesc::FLOAT, values.data()) ||
      !out->close())
    throw std::runtime_error("cannot write " + file.string());
  return file.string();
}

std::string base64(std::string_view bytes) {
  static const char* alphabet = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
  std::string text;
  for (std::size_t i = 0; i < bytes.size(); i += 3) {
    std::uint32_t bits = 0;
    const std::size_t have = std::min<std::size_t>(3, bytes.size() - i);
    for (std::size_t k = 0; k < 3; ++k) bits = bits << 8 | (k < have ? static_cast<unsigned char>(bytes[i + k]) : 0u);
    for (std::size_t k = 0; k < 4; ++k) text += k <= have ? alphabet[bits >> (18 - 6 * k) & 63] : '=';
  }
  return text;
}

GltfFile::GltfFile() {
  json = {{"asset", {{"version", "2.0"}}},
          {"scene", 0},
          {"scenes", {{{"nodes", {0}}}}},
          {"nodes", {{{"mesh", 0}}}},
          {"meshes", {{{"primitives", {{{"attributes", nlohmann::json::object()}}}}}}},
          {"accessors", nlohmann::json::array()},
          {"bufferViews", nlohmann::json::array()}};
}

std::size_t GltfFile::add_view(std::string_view bytes) {
  binary.resize((binary.size() + 3) / 4 * 4);
  json["bufferViews"].push_back({{"buffer", 0}, {"byteOffset", binary.size()}, {"byteLength", bytes.size()}});
  binary += bytes;
  return json["bufferViews"].size() - 1;
}

std::string GltfFile::gltf() const {
  nlohmann::json whole = json;
  if (!whole.contains("buffers"))
    whole["buffers"] = {
        {{"byteLength", binary.size()}, {"uri", "data:application/octet-stream;base64," + base64(binary)}}};
  return whole.dump();
}

std::string GltfFile::glb() const {
  nlohmann::json whole = json;
  if (!whole.contains("buffers")) whole["buffers"] = {{{"byteLength", binary.size()}}};
  std::string text = whole.dump(), data = binary;
  text.resize((text.size() + 3) / 4 * 4, ' ');
  data.resize((data.size() + 3) / 4 * 4);
  std::string bytes;
  const auto word = [&](std::uint32_t value) { bytes.append(reinterpret_cast<const char*>(&value), sizeof value); };
  word(0x46546c67);
  word(2);
  word(static_cast<std::uint32_t>(12 + 8 + text.size() + 8 + data.size()));
  word(static_cast<std::uint32_t>(text.size()));
  word(0x4e4f534a);
  bytes += text;
  word(static_cast<std::uint32_t>(data.size()));
  word(0x004e4942);
  return bytes + data;
}

GltfFile triangle_file() {
  GltfFile file;
  file.primitive()["attributes"]["POSITION"] = file.add<float>({0, 0, 0, 1, 0, 0, 0, 1, 0}, 5126, "VEC3");
  file.primitive()["indices"] = file.add<std::uint16_t>({0, 1, 2}, 5123, "SCALAR");
  file.json["materials"] = {{{"name", "grey"}, {"pbrMetallicRoughness", {{"baseColorFactor", {0.5, 0.5, 0.5, 1}}}}}};
  file.primitive()["material"] = 0;
  return file;
}

Scene import_text(const Folder& folder, const std::string& name, std::string_view text) {
  return import_scene(folder.write(name, text));
}

std::string refusal(const std::string& path) {
  try {
    import_scene(path);
  } catch (const Error& error) {
    EXPECT_EQ(error.kind(), ErrorKind::bad_input) << error.what();
    EXPECT_TRUE(std::string(error.what()).starts_with(path)) << error.what();
    return error.what();
  }
  return "";
}

}  // namespace gleaner::scene

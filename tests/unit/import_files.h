#pragma once
// Small scene files, written by code into a folder that goes away with the test.

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <span>
#include <string>
#include <vector>

#include "scene/model/scene.h"

namespace gleaner::scene {

// Of a quarter turn's quaternion.
inline constexpr double kHalf = 0.70710678118654752;

class Folder {
 public:
  Folder();
  ~Folder();
  Folder(const Folder&) = delete;
  Folder& operator=(const Folder&) = delete;

  std::string path(const std::string& name) const { return (root_ / name).string(); }
  std::string write(const std::string& name, std::string_view text) const;  // returns its path
  // An image by OpenImageIO, its format by the name; values from 0 to 1, channel by channel, row by row.
  std::string write_image(const std::string& name, int width, int height, int channels,
                          const std::vector<float>& values, bool sixteen_bits = false) const;

 private:
  std::filesystem::path root_;
};

std::string base64(std::string_view bytes);

// A glTF file that grows by accessors. It begins with one node and one mesh of one primitive without attributes.
struct GltfFile {
  nlohmann::json json;
  std::string binary;

  GltfFile();

  nlohmann::json& primitive() { return json["meshes"][0]["primitives"][0]; }

  std::size_t add_view(std::string_view bytes);
  template <typename T>
  std::size_t add(const std::vector<T>& values, int component_type, const std::string& type) {
    static const std::map<std::string, std::size_t> components = {
        {"SCALAR", 1}, {"VEC2", 2}, {"VEC3", 3}, {"VEC4", 4}, {"MAT4", 16}};
    const std::size_t view = add_view({reinterpret_cast<const char*>(values.data()), values.size() * sizeof(T)});
    json["accessors"].push_back({{"bufferView", view},
                                 {"componentType", component_type},
                                 {"count", values.size() / components.at(type)},
                                 {"type", type}});
    return json["accessors"].size() - 1;
  }

  // The text of a .gltf whose buffer is a data URI; the bytes of a .glb.
  std::string gltf() const;
  std::string glb() const;
};

// One triangle (0,0,0) (1,0,0) (0,1,0) with the indices 0 1 2 (16 bits) and a material of base colour 0.5.
GltfFile triangle_file();

// import_scene() of `text` written as `name`.
Scene import_text(const Folder& folder, const std::string& name, std::string_view text);

// What import_scene() says about a file it must refuse, kind checked; "" where it did not.
std::string refusal(const std::string& path);

}  // namespace gleaner::scene

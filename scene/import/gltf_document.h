#pragma once
// A glTF file as JSON with its buffers: every access is checked, and every error names the element ("meshes[3].name").

#include <cstddef>
#include <cstdint>
#include <limits>
#include <nlohmann/json.hpp>
#include <optional>
#include <span>
#include <string>
#include <vector>

namespace gleaner::scene {

// One value of the document with the way to it. Cheap enough to pass by value; refers to the document.
class Element {
 public:
  Element(const nlohmann::json& value, std::string name, const std::string& file)
      : value_(&value), name_(std::move(name)), file_(&file) {}

  const std::string& name() const { return name_; }
  const std::string& file() const { return *file_; }

  Element at(const char* key) const;                   // error where the object lacks it
  std::optional<Element> find(const char* key) const;  // nothing where the object lacks it
  std::size_t size() const;                            // of an array
  Element operator[](std::size_t index) const;         // of an array; index < size()

  double number(double lower = -std::numeric_limits<double>::max(),
                double upper = std::numeric_limits<double>::max()) const;  // finite, within [lower, upper]
  std::uint64_t count(std::uint64_t lower, std::uint64_t upper) const;     // a whole number within [lower, upper]
  std::size_t index(std::size_t limit) const;                              // a whole number below limit
  const std::string& text() const;
  bool boolean() const;
  bool is_object() const { return value_->is_object(); }
  std::vector<double> numbers(std::size_t count, double lower = -std::numeric_limits<double>::max(),
                              double upper = std::numeric_limits<double>::max()) const;

  [[noreturn]] void fail(const std::string& expected) const;  // found: this value
  [[noreturn]] void fail(const std::string& expected, const std::string& found) const;

 private:
  const nlohmann::json* value_;
  std::string name_;
  const std::string* file_;
};

// Elements of an accessor: bytes with a stride, and sparse replacements.
struct Accessor {
  std::string name;
  std::size_t count = 0;
  int component_type = 0;  // 5120 ... 5126
  std::size_t components = 0;
  bool normalized = false;
  std::size_t stride = 0;
  const std::byte* data = nullptr;  // null: all zeros
  std::size_t sparse_count = 0;
  int sparse_index_type = 0;
  const std::byte* sparse_indices = nullptr;
  const std::byte* sparse_values = nullptr;
};

class GltfDocument {
 public:
  // Reads a .gltf or .glb with all its buffers.
  explicit GltfDocument(const std::string& path);
  GltfDocument(const GltfDocument&) = delete;
  GltfDocument& operator=(const GltfDocument&) = delete;

  Element root() const { return {json_, "", file_}; }
  const std::string& file() const { return file_; }

  // The element of a top-level array that `reference` names by index ("accessors", "meshes", ...).
  Element item(const char* array, const Element& reference) const;
  // The number of elements of a top-level array; 0 where there is none.
  std::size_t size(const char* array) const;

  std::span<const std::byte> buffer_view(const Element& reference) const;

  // The accessor that `reference` names. `type` is SCALAR, VEC2, VEC3 or VEC4. All ranges are checked here.
  Accessor accessor(const Element& reference, const std::string& type) const;

  // `count * components` values; normalized integers become [0, 1] or [-1, 1].
  std::vector<float> floats(const Accessor& accessor) const;
  // Unsigned integers alone. Each must be below `limit`, the number of vertices.
  std::vector<std::uint32_t> indices(const Element& reference, std::size_t limit) const;

 private:
  void parse(std::span<const std::byte> text);
  void read_buffers(std::span<const std::byte> binary_chunk);
  std::span<const std::byte> range(const Element& view, std::uint64_t offset, std::uint64_t bytes) const;

  std::string file_;
  std::vector<std::byte> container_;  // of a .glb
  nlohmann::json json_;
  std::vector<std::vector<std::byte>> owned_;  // of buffers that are files or data URIs
  std::vector<std::span<const std::byte>> buffers_;
};

}  // namespace gleaner::scene

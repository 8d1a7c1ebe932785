#pragma once
// A glTF file as JSON with its buffers. Versions and required extensions are checked before anything else is read.

#include <cstddef>
#include <cstdint>
#include <map>
#include <nlohmann/json.hpp>
#include <span>
#include <string>
#include <vector>

#include "scene/files/warnings.h"
#include "scene/import/gltf/element.h"

namespace gleaner::scene::gltf {

class Document {
 public:
  // Reads a .gltf or .glb with all its buffers.
  Document(const std::string& path, Warnings& warnings);
  Document(const Document&) = delete;
  Document& operator=(const Document&) = delete;

  Element root() const { return {json_, "", file_}; }
  const std::string& file() const { return file_; }

  // The element of a top-level array that `reference` names by index ("accessors", "meshes", ...).
  Element item(const char* array, const Element& reference) const;
  Element item(const char* array, std::size_t index) const { return root().at(array)[index]; }
  // The number of elements of a top-level array; 0 where there is none.
  std::size_t size(const char* array) const;

  // Puts a value where the pointer leads; objects on the way that are not there are made.
  void put(const nlohmann::json::json_pointer& pointer, nlohmann::json value) { json_[pointer] = std::move(value); }

  // Bytes of all buffers together.
  std::uint64_t buffer_bytes() const;

  // The bytes of the buffer view that `reference` names, decompressed where it is compressed.
  std::span<const std::byte> buffer_view(const Element& reference) const;
  // Gives the memory of a large view back to the system, unless it shares bytes with a view that `uses` (one number a
  // view) still counts. Nobody reads it again.
  void release(std::size_t view, const std::vector<std::uint32_t>& uses);
  // `count` bytes of it from `offset` on, or an error.
  std::span<const std::byte> buffer_view(const Element& reference, std::uint64_t offset, std::uint64_t count) const;

 private:
  std::span<const std::byte> read_container();  // parses the JSON; the binary chunk of a .glb
  void parse(std::span<const std::byte> text);
  void check_version() const;
  void check_extensions() const;
  void warn_of_extensions() const;
  void read_buffers(std::span<const std::byte> binary_chunk);
  std::span<const std::byte> decompressed(const Element& view, const Element& compression) const;

  std::string file_;
  Warnings& warnings_;
  std::vector<std::byte> container_;  // of a .glb
  nlohmann::json json_;
  std::vector<std::vector<std::byte>> owned_;  // of buffers that are files or data URIs
  std::vector<std::span<const std::byte>> buffers_;
  mutable std::map<std::string, std::vector<std::byte>> decompressed_;  // by the view's name
};

}  // namespace gleaner::scene::gltf

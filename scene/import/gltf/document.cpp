#include "scene/import/gltf/document.h"

#include <sys/mman.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <set>

#include "scene/files/files.h"
#include "scene/files/text.h"
#include "scene/import/gltf/compression.h"
#include "scene/import/gltf/mend.h"
#include "scene/model/error.h"

namespace gleaner::scene::gltf {
namespace {

using nlohmann::json;

// Objects and arrays within one another; the deepest thing that glTF defines needs ten, people's extras a few more.
constexpr int kMaxNesting = 128;

template <typename T>
T load(const std::byte* from) {
  T value;
  std::memcpy(&value, from, sizeof value);
  return value;
}

// What this importer reads.
const std::set<std::string>& known_extensions() {
  static const std::set<std::string> names = {"EXT_mesh_gpu_instancing",
                                              "EXT_meshopt_compression",
                                              "EXT_texture_webp",
                                              "KHR_draco_mesh_compression",
                                              "KHR_lights_punctual",
                                              "KHR_materials_anisotropy",
                                              "KHR_animation_pointer",
                                              "KHR_materials_clearcoat",
                                              "KHR_materials_diffuse_transmission",
                                              "KHR_materials_emissive_strength",
                                              "KHR_materials_ior",
                                              "KHR_materials_iridescence",
                                              "KHR_materials_sheen",
                                              "KHR_materials_specular",
                                              "KHR_materials_transmission",
                                              "KHR_materials_unlit",
                                              "KHR_materials_variants",
                                              "KHR_materials_volume",
                                              "KHR_mesh_quantization",
                                              "KHR_texture_transform"};
  return names;
}

// What is left out where an extension is not read, for those that people meet.
std::string what_is_left_out(const std::string& extension) {
  static const std::map<std::string, std::string> words = {
      {"KHR_materials_dispersion", "all colours are refracted alike"},
      {"KHR_materials_pbrSpecularGlossiness", "the metallic-roughness values are taken, or their defaults"},
      {"KHR_texture_basisu", "the texture's other image is taken, or none"},
      {"EXT_texture_avif", "the texture's other image is taken, or none"},
      {"EXT_lights_image_based", "--environment lights a scene"},
      {"EXT_lights_ies", "light profiles"},
      {"KHR_node_visibility", "every node is seen"}};
  const auto known = words.find(extension);
  return known == words.end() ? "" : " (left out: " + known->second + ")";
}

// Names of all extensions under `value`, however deep: files use some without declaring them.
void collect_extensions(const json& value, std::set<std::string>& names) {
  std::vector<const json*> open = {&value};
  while (!open.empty()) {
    const json& next = *open.back();
    open.pop_back();
    if (next.is_array() && !next.empty() && next.front().is_number()) continue;
    if (next.is_object()) {
      for (const auto& [key, child] : next.items()) {
        if (key == "extras") continue;
        if (key == "extensions" && child.is_object())
          for (const auto& [name, unused] : child.items()) names.insert(name);
        if (child.is_structured()) open.push_back(&child);
      }
    } else if (next.is_array()) {
      for (const json& child : next)
        if (child.is_structured()) open.push_back(&child);
    }
  }
}

struct Version {
  unsigned long major = 0, minor = 0;
};

// "2.0" or the number 2.0.
Version version_of(const Element& element) {
  const std::string text = element.is_number() ? element.json().dump() : element.text();
  char* end = nullptr;
  Version version;
  version.major = std::strtoul(text.c_str(), &end, 10);
  if (end == text.c_str()) element.fail("glTF 2.x");
  if (*end == '.') version.minor = std::strtoul(end + 1, nullptr, 10);
  return version;
}

}  // namespace

Document::Document(const std::string& path, Warnings& warnings) : file_(path), warnings_(warnings) {
  const std::span<const std::byte> binary_chunk = read_container();
  mend(json_, warnings_);
  check_version();
  check_extensions();
  warn_of_extensions();
  read_buffers(binary_chunk);
}

std::span<const std::byte> Document::read_container() {
  const std::uint64_t file_size = file_bytes(file_, file_, "");
  container_ = read_file(file_, file_size, file_, "");
  std::span<const std::byte> bytes = container_;
  const bool has_magic = bytes.size() >= 4 && std::memcmp(bytes.data(), "glTF", 4) == 0;
  const auto is_text = [&] {
    const auto first = std::find_if(bytes.begin(), bytes.end(), [](std::byte b) { return b > std::byte(' '); });
    return first != bytes.end() && (*first == std::byte('{') || *first == std::byte(0xef));
  };
  const bool is_called_binary = file_.ends_with(".glb") || file_.ends_with(".GLB");
  if (!has_magic && is_called_binary && !is_text())
    throw Error::bad_input(file_, "header", "the magic \"glTF\"", "other bytes");
  if (!has_magic && is_called_binary) warnings_.add("header", "the file is JSON: it is read as .gltf");
  if (!has_magic) {
    parse(bytes);
    container_.clear();
    container_.shrink_to_fit();
    return {};
  }
  if (bytes.size() < 12) throw Error::bad_input(file_, "header", "12 bytes", std::to_string(bytes.size()));
  const auto version = load<std::uint32_t>(bytes.data() + 4), length = load<std::uint32_t>(bytes.data() + 8);
  if (version != 2) throw Error::bad_input(file_, "header.version", "2", std::to_string(version));
  if (length > bytes.size())
    throw Error::bad_input(file_, "header.length", "at most " + std::to_string(bytes.size()) + " (the file's size)",
                           std::to_string(length));
  if (length < bytes.size())
    warnings_.add("header.length", std::to_string(bytes.size() - length) + " bytes after its end are not read");
  bytes = bytes.first(length);
  std::span<const std::byte> chunks[2];  // JSON, BIN
  std::size_t place = 12;
  for (std::size_t i = 0; place < bytes.size(); ++i) {
    const std::string name = "chunk " + std::to_string(i);
    if (bytes.size() - place < 8)
      throw Error::bad_input(file_, name, "8 bytes of header", std::to_string(bytes.size() - place));
    const auto chunk_bytes = load<std::uint32_t>(bytes.data() + place);
    const auto type = load<std::uint32_t>(bytes.data() + place + 4);
    place += 8;
    if (chunk_bytes > bytes.size() - place)
      throw Error::bad_input(file_, name, "at most " + std::to_string(bytes.size() - place) + " bytes",
                             std::to_string(chunk_bytes));
    constexpr std::uint32_t types[] = {0x4e4f534au, 0x004e4942u};
    if (i == 0 && type != types[0]) throw Error::bad_input(file_, name, "JSON", "another type");
    if (i == 0 && chunk_bytes == 0) throw Error::bad_input(file_, name, "JSON", "0 bytes");
    if (i < 2 && type == types[i]) chunks[i] = bytes.subspan(place, chunk_bytes);
    place += chunk_bytes;
  }
  if (chunks[0].empty()) throw Error::bad_input(file_, "chunk 0", "JSON", "none");
  parse(chunks[0]);
  return chunks[1];
}

void Document::parse(std::span<const std::byte> bytes) {
  std::string_view text(reinterpret_cast<const char*>(bytes.data()), bytes.size());
  if (is_utf16(text)) throw Error::bad_input(file_, "", "JSON in UTF-8", "UTF-16");
  while (!text.empty() && text.back() == '\0') text.remove_suffix(1);  // some pad with zeros instead of spaces
  // Nesting is bounded before anything is built from it.
  int depth = 0;
  bool in_string = false;
  std::size_t line = 1;
  for (std::size_t i = 0; i < text.size(); ++i) {
    const char c = text[i];
    if (in_string) {
      if (c == '\\') ++i;
      if (c == '"') in_string = false;
    } else if (c == '"') {
      in_string = true;
    } else if (c == '[' || c == '{') {
      if (++depth > kMaxNesting)
        throw Error::bad_input(file_, "line " + std::to_string(line),
                               "JSON nested at most " + std::to_string(kMaxNesting) + " deep");
    } else if (c == ']' || c == '}') {
      --depth;
    } else if (c == '\n') {
      ++line;
    }
  }
  // Names in another encoding are people's; they cost a warning, not the scene.
  std::string mended;
  if (!is_utf8(text)) {
    mended = utf8_from_latin1(text);
    text = mended;
    warnings_.add("JSON", "not UTF-8: bytes that are not were read as Latin-1");
  }
  try {
    json_ = json::parse(text);
  } catch (const json::exception& error) {
    // "[json.exception.parse_error.101] parse error at line 1, column 5: syntax error ..."
    const std::string what = error.what();
    const std::size_t begin = what.find("] ");
    throw Error::bad_input(file_, "", "JSON", begin == std::string::npos ? what : what.substr(begin + 2));
  }
}

void Document::check_version() const {
  const Element asset = root().at("asset");
  const Version version = version_of(asset.at("version"));
  if (const auto least = asset.find("minVersion")) {
    const Version needed = version_of(*least);
    if (needed.major != 2 || needed.minor > 0) least->fail("at most 2.0, the version that is read");
    return;
  }
  if (version.major != 2) asset.at("version").fail("glTF 2.x");
}

void Document::check_extensions() const {
  const std::optional<Element> names = root().find("extensionsRequired");
  std::string unknown;
  std::optional<Element> first;
  for (std::size_t i = 0; names && i < names->size(); ++i) {
    const Element name = (*names)[i];
    if (known_extensions().contains(name.text())) continue;
    if (!first) first = name;
    unknown += (unknown.empty() ? "\"" : ", \"") + name.text() + "\"";
  }
  if (first) first->fail("an extension that this renderer knows", unknown);
}

void Document::warn_of_extensions() const {
  std::set<std::string> names;
  if (const auto used = root().find("extensionsUsed"))
    for (std::size_t i = 0; i < used->size(); ++i) names.insert((*used)[i].text());
  collect_extensions(json_, names);
  for (const std::string& name : names)
    if (!known_extensions().contains(name))
      warnings_.add("the extension " + name + " is not read" + what_is_left_out(name));
}

void Document::read_buffers(std::span<const std::byte> binary_chunk) {
  const std::size_t count = size("buffers");
  owned_.resize(count);
  buffers_.resize(count);
  std::uint64_t total = 0;
  for (std::size_t i = 0; i < count; ++i) {
    const Element buffer = item("buffers", i);
    const std::uint64_t bytes = buffer.at("byteLength").count(1, kMaxFileBytes);
    const std::optional<Element> uri = buffer.find("uri");
    // A place holder for what compressed views bring: nobody reads it.
    const auto compression = buffer.extension("EXT_meshopt_compression");
    if (compression && compression->find("fallback") && compression->at("fallback").boolean()) continue;
    total += bytes;
    if (total > kMaxFileBytes)
      buffer.at("byteLength")
          .fail("at most " + std::to_string(kMaxFileBytes) + " bytes in all buffers", std::to_string(total));
    std::span<const std::byte> found;
    if (!uri) {
      // Whoever exchanges such a file knows what belongs here; only what reads from it is in error.
      if (i != 0 || binary_chunk.empty()) {
        warnings_.add(buffer.name(), "neither a uri nor data: what reads from it is refused");
        continue;
      }
      found = binary_chunk;
    } else if (is_data_uri(uri->text())) {
      owned_[i] = data_uri_bytes(uri->text(), file_, uri->name());
      found = owned_[i];
    } else {
      const auto path =
          resolve_reference(percent_decoded(uri->text(), file_, uri->name()), file_, uri->name(), &warnings_);
      const std::uint64_t available = file_bytes(path, file_, uri->name());
      if (available < bytes)
        buffer.at("byteLength").fail("at most " + std::to_string(available) + " (the file's size)");
      owned_[i] = read_file(path, bytes, file_, uri->name());
      found = owned_[i];
    }
    if (found.size() < bytes)
      buffer.at("byteLength").fail("at most " + std::to_string(found.size()) + " (the data's size)");
    buffers_[i] = found.first(bytes);
  }
}

std::size_t Document::size(const char* array) const {
  const std::optional<Element> element = root().find(array);
  return element ? element->size() : 0;
}

std::uint64_t Document::buffer_bytes() const {
  std::uint64_t bytes = 0;
  for (const std::span<const std::byte>& buffer : buffers_) bytes += buffer.size();
  return bytes;
}

Element Document::item(const char* array, const Element& reference) const {
  const std::size_t index = reference.index(size(array));
  return item(array, index);
}

namespace {

// The bytes that `holder`, a view or its compression, cuts out of a buffer.
std::span<const std::byte> cut(const Element& holder, const std::vector<std::span<const std::byte>>& buffers) {
  const std::size_t buffer = holder.at("buffer").index(buffers.size());
  const std::uint64_t first = holder.find("byteOffset") ? holder.at("byteOffset").count(0, kMaxFileBytes) : 0;
  const std::uint64_t length = holder.at("byteLength").count(1, kMaxFileBytes);
  if (first + length > buffers[buffer].size())
    holder.fail(
        "bytes within the " + std::to_string(buffers[buffer].size()) + " of buffers[" + std::to_string(buffer) + "]",
        std::to_string(first + length));
  return buffers[buffer].subspan(first, length);
}

}  // namespace

std::span<const std::byte> Document::decompressed(const Element& view, const Element& compression) const {
  const auto [place, is_new] = decompressed_.try_emplace(view.name());
  if (is_new) place->second = meshopt_decoded(compression, cut(compression, buffers_));
  return place->second;
}

std::span<const std::byte> Document::buffer_view(const Element& reference) const {
  const Element view = item("bufferViews", reference);
  if (const auto compression = view.extension("EXT_meshopt_compression")) return decompressed(view, *compression);
  return cut(view, buffers_);
}

void Document::release(std::size_t index, const std::vector<std::uint32_t>& uses) {
  const Element view = item("bufferViews", index);
  if (view.extension("EXT_meshopt_compression")) {
    decompressed_.erase(view.name());
    return;
  }
  constexpr std::size_t large = std::size_t(1) << 20;
  const std::span<const std::byte> bytes = cut(view, buffers_);
  if (bytes.size() < large) return;
  for (std::size_t other = 0; other < uses.size(); ++other) {
    if (uses[other] == 0 || item("bufferViews", other).extension("EXT_meshopt_compression")) continue;
    const std::span<const std::byte> its = cut(item("bufferViews", other), buffers_);
    if (its.data() < bytes.data() + bytes.size() && bytes.data() < its.data() + its.size()) return;
  }
  const auto page = static_cast<std::uintptr_t>(sysconf(_SC_PAGESIZE));
  const auto begin = reinterpret_cast<std::uintptr_t>(bytes.data());
  const std::uintptr_t first = (begin + page - 1) / page * page, last = (begin + bytes.size()) / page * page;
  // The pages are anonymous memory of this process: they read as zeros from now on.
  if (first < last) madvise(reinterpret_cast<void*>(first), last - first, MADV_DONTNEED);
}

std::span<const std::byte> Document::buffer_view(const Element& reference, std::uint64_t offset,
                                                 std::uint64_t count) const {
  const std::span<const std::byte> bytes = buffer_view(reference);
  if (offset > bytes.size() || count > bytes.size() - offset)
    item("bufferViews", reference)
        .fail("at least " + std::to_string(offset) + " + " + std::to_string(count) + " bytes",
              std::to_string(bytes.size()));
  return bytes.subspan(offset, count);
}

}  // namespace gleaner::scene::gltf

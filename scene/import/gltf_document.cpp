#include "scene/import/gltf_document.h"

#include <algorithm>
#include <cmath>
#include <cstring>

#include "scene/import/files.h"
#include "scene/model/error.h"
#include "scene/model/limits.h"

namespace gleaner::scene {
namespace {

using nlohmann::json;

constexpr int kByte = 5120, kUnsignedByte = 5121, kShort = 5122, kUnsignedShort = 5123, kUnsignedInt = 5125,
              kFloat = 5126;

// Objects and arrays within one another; the deepest thing that glTF defines needs ten.
constexpr int kMaxNesting = 64;

// Zeros that an accessor without a buffer view may ask for: nothing in the file stands for them.
constexpr std::size_t kMaxZeros = std::size_t(1) << 20;

std::size_t component_bytes(int type) {
  switch (type) {
    case kByte:
    case kUnsignedByte:
      return 1;
    case kShort:
    case kUnsignedShort:
      return 2;
    case kUnsignedInt:
    case kFloat:
      return 4;
    default:
      return 0;
  }
}

std::size_t component_count(const std::string& type) {
  if (type == "SCALAR") return 1;
  if (type == "VEC2") return 2;
  if (type == "VEC3") return 3;
  if (type == "VEC4") return 4;
  return 0;
}

std::string describe(const json& value) {
  switch (value.type()) {
    case json::value_t::object:
      return "an object";
    case json::value_t::array:
      return "an array of " + std::to_string(value.size());
    case json::value_t::string: {
      const std::string& text = value.get_ref<const std::string&>();
      return "\"" + text.substr(0, 80) + (text.size() > 80 ? "...\"" : "\"");
    }
    default:
      return value.dump();
  }
}

template <typename T>
T load(const std::byte* from) {
  T value;
  std::memcpy(&value, from, sizeof value);
  return value;
}

float component(const std::byte* from, int type, bool normalized) {
  switch (type) {
    case kByte: {
      const float v = load<std::int8_t>(from);
      return normalized ? std::max(v / 127.0f, -1.0f) : v;
    }
    case kUnsignedByte: {
      const float v = load<std::uint8_t>(from);
      return normalized ? v / 255.0f : v;
    }
    case kShort: {
      const float v = load<std::int16_t>(from);
      return normalized ? std::max(v / 32767.0f, -1.0f) : v;
    }
    case kUnsignedShort: {
      const float v = load<std::uint16_t>(from);
      return normalized ? v / 65535.0f : v;
    }
    case kUnsignedInt:
      return static_cast<float>(load<std::uint32_t>(from));
    default:
      return load<float>(from);
  }
}

std::uint32_t unsigned_component(const std::byte* from, int type) {
  if (type == kUnsignedByte) return load<std::uint8_t>(from);
  if (type == kUnsignedShort) return load<std::uint16_t>(from);
  return load<std::uint32_t>(from);
}

bool is_unsigned(int type) { return type == kUnsignedByte || type == kUnsignedShort || type == kUnsignedInt; }

std::string text_of(std::size_t n) { return std::to_string(n); }

}  // namespace

void Element::fail(const std::string& expected) const { fail(expected, describe(*value_)); }

void Element::fail(const std::string& expected, const std::string& found) const {
  throw Error::bad_input(*file_, name_, expected, found);
}

std::optional<Element> Element::find(const char* key) const {
  if (!value_->is_object()) fail("an object");
  const auto place = value_->find(key);
  if (place == value_->end()) return std::nullopt;
  return Element(*place, name_.empty() ? key : name_ + "." + key, *file_);
}

Element Element::at(const char* key) const {
  if (std::optional<Element> element = find(key)) return *element;
  throw Error::bad_input(*file_, name_.empty() ? key : name_ + "." + key, "a value", "none");
}

std::size_t Element::size() const {
  if (!value_->is_array()) fail("an array");
  return value_->size();
}

Element Element::operator[](std::size_t index) const {
  return {value_->at(index), name_ + "[" + text_of(index) + "]", *file_};
}

double Element::number(double lower, double upper) const {
  if (!value_->is_number()) fail("a number");
  const double value = value_->get<double>();
  if (value >= lower && value <= upper) return value;
  const auto shown = [](double x) {
    char text[32];
    std::snprintf(text, sizeof text, "%g", x);
    return std::string(text);
  };
  const bool is_open = upper >= std::numeric_limits<float>::max();  // what a float can hold is no limit to speak of
  if (lower <= -upper && is_open) fail("a finite number");
  fail(is_open ? "a finite number of at least " + shown(lower)
               : "a number from " + shown(lower) + " to " + shown(upper));
}

std::uint64_t Element::count(std::uint64_t lower, std::uint64_t upper) const {
  const std::string expected = "a whole number from " + std::to_string(lower) + " to " + std::to_string(upper);
  std::uint64_t value = 0;
  if (value_->is_number_unsigned()) {
    value = value_->get<std::uint64_t>();
  } else if (value_->is_number_float()) {  // some exporters write 5.0
    const double real = value_->get<double>();
    if (!(real >= 0 && real <= 9007199254740992.0 && real == std::floor(real))) fail(expected);
    value = static_cast<std::uint64_t>(real);
  } else {
    fail(expected);
  }
  if (value < lower || value > upper) fail(expected);
  return value;
}

std::size_t Element::index(std::size_t limit) const {
  if (limit == 0) fail("no index: there is nothing to name");
  const std::string expected = "an index below " + text_of(limit);
  if (!value_->is_number_unsigned()) fail(expected);
  const std::uint64_t value = value_->get<std::uint64_t>();
  if (value >= limit) fail(expected);
  return value;
}

const std::string& Element::text() const {
  if (!value_->is_string()) fail("a string");
  return value_->get_ref<const std::string&>();
}

bool Element::boolean() const {
  if (!value_->is_boolean()) fail("true or false");
  return value_->get<bool>();
}

std::vector<double> Element::numbers(std::size_t count, double lower, double upper) const {
  if (!value_->is_array() || value_->size() != count) fail("an array of " + text_of(count) + " numbers");
  std::vector<double> values;
  for (std::size_t i = 0; i < count; ++i) values.push_back((*this)[i].number(lower, upper));
  return values;
}

GltfDocument::GltfDocument(const std::string& path) : file_(path) {
  container_ = read_file(path, file_bytes(path, path, ""), path, "");
  const std::span<const std::byte> bytes = container_;
  const bool has_magic = bytes.size() >= 4 && std::memcmp(bytes.data(), "glTF", 4) == 0;
  if (!has_magic && path.size() >= 4 && (path.ends_with(".glb") || path.ends_with(".GLB")))
    throw Error::bad_input(file_, "header", "the magic \"glTF\"", "other bytes");
  if (!has_magic) {
    parse(bytes);
    container_.clear();
    container_.shrink_to_fit();
    read_buffers({});
    return;
  }
  if (bytes.size() < 12) throw Error::bad_input(file_, "header", "12 bytes", text_of(bytes.size()));
  const auto version = load<std::uint32_t>(bytes.data() + 4), length = load<std::uint32_t>(bytes.data() + 8);
  if (version != 2) throw Error::bad_input(file_, "header.version", "2", text_of(version));
  if (length != bytes.size())
    throw Error::bad_input(file_, "header.length", text_of(bytes.size()) + " (the file's)", text_of(length));
  std::span<const std::byte> chunks[2];  // JSON, BIN
  std::size_t place = 12;
  for (std::size_t i = 0; place < bytes.size(); ++i) {
    const std::string name = "chunk " + text_of(i);
    if (bytes.size() - place < 8)
      throw Error::bad_input(file_, name, "8 bytes of header", text_of(bytes.size() - place));
    const auto chunk_bytes = load<std::uint32_t>(bytes.data() + place);
    const auto type = load<std::uint32_t>(bytes.data() + place + 4);
    place += 8;
    if (chunk_bytes > bytes.size() - place)
      throw Error::bad_input(file_, name, "at most " + text_of(bytes.size() - place) + " bytes", text_of(chunk_bytes));
    constexpr std::uint32_t types[] = {0x4e4f534au, 0x004e4942u};
    if (i == 0 && type != types[0]) throw Error::bad_input(file_, name, "JSON", "another type");
    if (i == 0 && chunk_bytes == 0) throw Error::bad_input(file_, name, "JSON", "0 bytes");
    if (i < 2 && type == types[i]) chunks[i] = bytes.subspan(place, chunk_bytes);
    place += chunk_bytes;
  }
  if (chunks[0].empty()) throw Error::bad_input(file_, "chunk 0", "JSON", "none");
  parse(chunks[0]);
  read_buffers(chunks[1]);
}

void GltfDocument::parse(std::span<const std::byte> bytes) {
  const std::string_view text(reinterpret_cast<const char*>(bytes.data()), bytes.size());
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
        throw Error::bad_input(file_, "line " + text_of(line), "JSON nested at most " + text_of(kMaxNesting) + " deep");
    } else if (c == ']' || c == '}') {
      --depth;
    } else if (c == '\n') {
      ++line;
    }
  }
  try {
    json_ = json::parse(text);
  } catch (const json::exception& error) {
    // "[json.exception.parse_error.101] parse error at line 1, column 5: syntax error ..."
    const std::string what = error.what();
    const std::size_t begin = what.find("] ");
    throw Error::bad_input(file_, "", "JSON", begin == std::string::npos ? what : what.substr(begin + 2));
  }
  const std::string& version = root().at("asset").at("version").text();
  if (!version.starts_with("2.")) root().at("asset").at("version").fail("glTF 2.x");
}

void GltfDocument::read_buffers(std::span<const std::byte> binary_chunk) {
  const std::size_t count = size("buffers");
  owned_.resize(count);
  std::uint64_t total = 0;
  for (std::size_t i = 0; i < count; ++i) {
    const Element buffer = root().at("buffers")[i];
    const std::uint64_t bytes = buffer.at("byteLength").count(1, kMaxFileBytes);
    total += bytes;
    if (total > kMaxFileBytes)
      buffer.at("byteLength")
          .fail("at most " + std::to_string(kMaxFileBytes) + " bytes in all buffers", std::to_string(total));
    const std::optional<Element> uri = buffer.find("uri");
    std::span<const std::byte> found;
    if (!uri) {
      if (i != 0) buffer.fail("a uri", "none");
      found = binary_chunk;
    } else if (is_data_uri(uri->text())) {
      owned_[i] = data_uri_bytes(uri->text(), file_, uri->name());
      found = owned_[i];
    } else {
      const auto path = resolve_inside(percent_decoded(uri->text(), file_, uri->name()), file_, uri->name());
      const std::uint64_t available = file_bytes(path, file_, uri->name());
      if (available < bytes)
        buffer.at("byteLength").fail("at most " + std::to_string(available) + " (the file's size)");
      owned_[i] = read_file(path, bytes, file_, uri->name());
      found = owned_[i];
    }
    if (found.size() < bytes) buffer.at("byteLength").fail("at most " + text_of(found.size()) + " (the data's size)");
    buffers_.push_back(found.first(bytes));
  }
}

std::size_t GltfDocument::size(const char* array) const {
  const std::optional<Element> element = root().find(array);
  return element ? element->size() : 0;
}

Element GltfDocument::item(const char* array, const Element& reference) const {
  const std::size_t index = reference.index(size(array));
  return root().at(array)[index];
}

std::span<const std::byte> GltfDocument::range(const Element& view, std::uint64_t offset, std::uint64_t bytes) const {
  const std::size_t buffer = view.at("buffer").index(buffers_.size());
  const std::uint64_t first = view.find("byteOffset") ? view.at("byteOffset").count(0, kMaxFileBytes) : 0;
  const std::uint64_t length = view.at("byteLength").count(1, kMaxFileBytes);
  if (first + length > buffers_[buffer].size())
    view.fail("bytes within the " + text_of(buffers_[buffer].size()) + " of buffers[" + text_of(buffer) + "]",
              std::to_string(first + length));
  if (offset > length || bytes > length - offset)
    view.fail("at least " + std::to_string(offset) + " + " + std::to_string(bytes) + " bytes", std::to_string(length));
  return buffers_[buffer].subspan(first + offset, bytes);
}

std::span<const std::byte> GltfDocument::buffer_view(const Element& reference) const {
  const Element view = item("bufferViews", reference);
  return range(view, 0, view.at("byteLength").count(1, kMaxFileBytes));
}

Accessor GltfDocument::accessor(const Element& reference, const std::string& type) const {
  const Element element = item("accessors", reference);
  Accessor accessor;
  accessor.name = element.name();
  if (element.at("type").text() != type) element.at("type").fail("\"" + type + "\" (for " + reference.name() + ")");
  accessor.components = component_count(type);
  accessor.count = element.at("count").count(1, 0xffffffffu);
  const auto type_of = [](const Element& holder) {
    const Element field = holder.at("componentType");
    const int value = static_cast<int>(field.count(0, 65535));
    if (component_bytes(value) == 0) field.fail("5120, 5121, 5122, 5123, 5125 or 5126");
    return value;
  };
  accessor.component_type = type_of(element);
  if (const auto normalized = element.find("normalized")) {
    accessor.normalized = normalized->boolean();
    if (accessor.normalized && (accessor.component_type == kFloat || accessor.component_type == kUnsignedInt))
      normalized->fail("false for 32-bit components");
  }
  const std::size_t element_bytes = component_bytes(accessor.component_type) * accessor.components;
  accessor.stride = element_bytes;
  if (const auto reference_to_view = element.find("bufferView")) {
    const Element view = item("bufferViews", *reference_to_view);
    if (const auto stride = view.find("byteStride")) {
      const std::size_t bytes = stride->count(0, 252);
      if (bytes != 0 && bytes < element_bytes) stride->fail("at least " + text_of(element_bytes));
      if (bytes != 0) accessor.stride = bytes;  // some exporters write 0 for tightly packed
    }
    const std::uint64_t offset = element.find("byteOffset") ? element.at("byteOffset").count(0, kMaxFileBytes) : 0;
    const std::uint64_t bytes = (accessor.count - 1) * std::uint64_t(accessor.stride) + element_bytes;
    const std::uint64_t available = view.at("byteLength").count(1, kMaxFileBytes);
    if (offset > available || bytes > available - offset)
      element.fail("elements within the " + std::to_string(available) + " bytes of " + view.name(),
                   text_of(accessor.count) + " that end at byte " + std::to_string(offset + bytes));
    accessor.data = range(view, offset, bytes).data();
  } else if (accessor.count > kMaxZeros) {
    element.at("count").fail("at most " + text_of(kMaxZeros) + " without a bufferView");
  }
  if (const auto sparse = element.find("sparse")) {
    accessor.sparse_count = sparse->at("count").count(1, accessor.count);
    const Element at = sparse->at("indices"), values = sparse->at("values");
    accessor.sparse_index_type = type_of(at);
    if (!is_unsigned(accessor.sparse_index_type)) at.at("componentType").fail("an unsigned type");
    const auto part = [&](const Element& holder, std::size_t stride) {
      const Element view = item("bufferViews", holder.at("bufferView"));
      const std::uint64_t offset = holder.find("byteOffset") ? holder.at("byteOffset").count(0, kMaxFileBytes) : 0;
      return range(view, offset, accessor.sparse_count * std::uint64_t(stride)).data();
    };
    accessor.sparse_indices = part(at, component_bytes(accessor.sparse_index_type));
    accessor.sparse_values = part(values, element_bytes);
    for (std::size_t i = 0; i < accessor.sparse_count; ++i) {
      const std::size_t bytes = component_bytes(accessor.sparse_index_type);
      const std::uint32_t index = unsigned_component(accessor.sparse_indices + i * bytes, accessor.sparse_index_type);
      if (index >= accessor.count) at.fail("indices below " + text_of(accessor.count), text_of(index));
    }
  }
  return accessor;
}

std::vector<float> GltfDocument::floats(const Accessor& a) const {
  const std::size_t step = component_bytes(a.component_type);
  std::vector<float> values(a.count * a.components);
  if (a.data && a.component_type == kFloat && a.stride == step * a.components) {
    std::memcpy(values.data(), a.data, values.size() * sizeof(float));
  } else if (a.data) {
    for (std::size_t i = 0; i < a.count; ++i)
      for (std::size_t c = 0; c < a.components; ++c)
        values[i * a.components + c] = component(a.data + i * a.stride + c * step, a.component_type, a.normalized);
  }
  const std::size_t index_bytes = component_bytes(a.sparse_index_type);
  for (std::size_t i = 0; i < a.sparse_count; ++i) {
    const std::size_t target = unsigned_component(a.sparse_indices + i * index_bytes, a.sparse_index_type);
    for (std::size_t c = 0; c < a.components; ++c)
      values[target * a.components + c] =
          component(a.sparse_values + (i * a.components + c) * step, a.component_type, a.normalized);
  }
  return values;
}

std::vector<std::uint32_t> GltfDocument::indices(const Element& reference, std::size_t limit) const {
  const Accessor a = accessor(reference, "SCALAR");
  if (!is_unsigned(a.component_type))
    throw Error::bad_input(file_, a.name + ".componentType", "an unsigned type, for indices",
                           text_of(a.component_type));
  std::vector<std::uint32_t> values(a.count);
  if (a.data)
    for (std::size_t i = 0; i < a.count; ++i) values[i] = unsigned_component(a.data + i * a.stride, a.component_type);
  const std::size_t step = component_bytes(a.component_type), index_bytes = component_bytes(a.sparse_index_type);
  for (std::size_t i = 0; i < a.sparse_count; ++i)
    values[unsigned_component(a.sparse_indices + i * index_bytes, a.sparse_index_type)] =
        unsigned_component(a.sparse_values + i * step, a.component_type);
  for (std::size_t i = 0; i < a.count; ++i) {
    if (values[i] >= limit)
      reference.fail("vertices below " + text_of(limit), text_of(values[i]) + " at index " + text_of(i));
  }
  return values;
}

}  // namespace gleaner::scene

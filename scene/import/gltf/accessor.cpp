#include "scene/import/gltf/accessor.h"

#include <algorithm>
#include <array>

#include "scene/files/files.h"
#include "scene/model/error.h"

namespace gleaner::scene::gltf {
namespace {

// Zeros that an accessor without a buffer view may ask for, where the file is smaller than that: nothing stands for
// them.
constexpr std::uint64_t kMaxZeros = std::uint64_t(1) << 20;

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
  if (type == "MAT4") return 16;
  return 0;
}

template <typename T>
T value_at(const std::byte* from) {
  T value;
  std::memcpy(&value, from, sizeof value);
  return value;
}

template <typename T>
float signed_component(const std::byte* from, bool normalized, float most) {
  const auto value = static_cast<float>(value_at<T>(from));
  return normalized ? std::max(value / most, -1.0f) : value;
}

template <typename T>
float unsigned_fraction(const std::byte* from, bool normalized, float most) {
  const auto value = static_cast<float>(value_at<T>(from));
  return normalized ? value / most : value;
}

float component(const std::byte* from, int type, bool normalized) {
  switch (type) {
    case kByte:
      return signed_component<std::int8_t>(from, normalized, 127.0f);
    case kUnsignedByte:
      return unsigned_fraction<std::uint8_t>(from, normalized, 255.0f);
    case kShort:
      return signed_component<std::int16_t>(from, normalized, 32767.0f);
    case kUnsignedShort:
      return unsigned_fraction<std::uint16_t>(from, normalized, 65535.0f);
    case kUnsignedInt:
      return unsigned_fraction<std::uint32_t>(from, normalized, 4294967295.0f);
    default:
      return value_at<float>(from);
  }
}

std::uint32_t unsigned_component(const std::byte* from, int type) {
  if (type == kUnsignedByte) return value_at<std::uint8_t>(from);
  if (type == kUnsignedShort) return value_at<std::uint16_t>(from);
  return value_at<std::uint32_t>(from);
}

bool is_unsigned(int type) { return type == kUnsignedByte || type == kUnsignedShort || type == kUnsignedInt; }

int component_type_of(const Element& holder) {
  const Element field = holder.at("componentType");
  const int value = static_cast<int>(field.count(0, 65535));
  if (component_bytes(value) == 0) field.fail("5120, 5121, 5122, 5123, 5125 or 5126");
  return value;
}

std::uint64_t offset_of(const Element& holder) {
  const auto offset = holder.find("byteOffset");
  return offset ? offset->count(0, kMaxFileBytes) : 0;
}

void read_data(const Document& document, const Element& element, std::size_t element_bytes, Accessor& accessor) {
  accessor.stride = element_bytes;
  const auto reference = element.find("bufferView");
  if (!reference) {
    const std::uint64_t most = std::max(kMaxZeros, document.buffer_bytes());
    if (accessor.count > most) element.at("count").fail("at most " + std::to_string(most) + " without a bufferView");
    return;
  }
  const Element view = document.item("bufferViews", *reference);
  const std::span<const std::byte> bytes = document.buffer_view(*reference);
  if (const auto stride = view.find("byteStride")) {
    const std::size_t step = stride->count(0, 252);
    if (step != 0 && step < element_bytes) stride->fail("at least " + std::to_string(element_bytes));
    if (step != 0) accessor.stride = step;  // some exporters write 0 for tightly packed
  }
  const std::uint64_t offset = offset_of(element);
  const std::uint64_t needed = (accessor.count - 1) * std::uint64_t(accessor.stride) + element_bytes;
  if (offset > bytes.size() || needed > bytes.size() - offset)
    element.fail("elements within the " + std::to_string(bytes.size()) + " bytes of " + view.name(),
                 std::to_string(accessor.count) + " that end at byte " + std::to_string(offset + needed));
  accessor.data = bytes.data() + offset;
}

void read_sparse(const Document& document, const Element& sparse, std::size_t element_bytes, Accessor& accessor) {
  accessor.sparse_count = sparse.at("count").count(1, accessor.count);
  const Element at = sparse.at("indices"), values = sparse.at("values");
  accessor.sparse_index_type = component_type_of(at);
  if (!is_unsigned(accessor.sparse_index_type)) at.at("componentType").fail("an unsigned type");
  const std::size_t index_bytes = component_bytes(accessor.sparse_index_type);
  accessor.sparse_indices =
      document.buffer_view(at.at("bufferView"), offset_of(at), accessor.sparse_count * std::uint64_t(index_bytes))
          .data();
  accessor.sparse_values =
      document
          .buffer_view(values.at("bufferView"), offset_of(values), accessor.sparse_count * std::uint64_t(element_bytes))
          .data();
  for (std::size_t i = 0; i < accessor.sparse_count; ++i) {
    const std::uint32_t index =
        unsigned_component(accessor.sparse_indices + i * index_bytes, accessor.sparse_index_type);
    if (index >= accessor.count) at.fail("indices below " + std::to_string(accessor.count), std::to_string(index));
  }
}

// Calls `with(element, component, bytes)` for every value that the accessor holds, the sparse ones last.
template <typename With>
void each_value(const Accessor& a, const With& with) {
  const std::size_t step = component_bytes(a.component_type), index_bytes = component_bytes(a.sparse_index_type);
  if (a.data)
    for (std::size_t i = 0; i < a.count; ++i)
      for (std::size_t c = 0; c < a.components; ++c) with(i, c, a.data + i * a.stride + c * step);
  for (std::size_t i = 0; i < a.sparse_count; ++i) {
    const std::size_t target = unsigned_component(a.sparse_indices + i * index_bytes, a.sparse_index_type);
    for (std::size_t c = 0; c < a.components; ++c) with(target, c, a.sparse_values + (i * a.components + c) * step);
  }
}

}  // namespace

Accessor accessor_of(const Document& document, const Element& reference, std::initializer_list<const char*> types) {
  const Element element = document.item("accessors", reference);
  Accessor accessor;
  accessor.name = element.name();
  const std::string& type = element.at("type").text();
  if (std::find(types.begin(), types.end(), type) == types.end()) {
    std::string expected;
    for (const char* each : types) expected += (expected.empty() ? "\"" : "\" or \"") + std::string(each);
    element.at("type").fail(expected + "\" (for " + reference.name() + ")");
  }
  accessor.components = component_count(type);
  accessor.count = element.at("count").count(1, 0xffffffffu);
  accessor.component_type = component_type_of(element);
  if (const auto normalized = element.find("normalized")) {
    accessor.normalized = normalized->boolean();
    if (accessor.normalized && accessor.component_type == kFloat) normalized->fail("false for floats");
  }
  const std::size_t element_bytes = component_bytes(accessor.component_type) * accessor.components;
  read_data(document, element, element_bytes, accessor);
  if (const auto sparse = element.find("sparse")) read_sparse(document, *sparse, element_bytes, accessor);
  return accessor;
}

FloatView::FloatView(const Accessor& a) : size_(a.count), components_(a.components) {
  if (a.data && a.component_type == kFloat && a.sparse_count == 0) {
    data_ = a.data;
    stride_ = a.stride;
    return;
  }
  owned_.resize(a.count * a.components);
  each_value(a, [&](std::size_t i, std::size_t c, const std::byte* from) {
    owned_[i * components_ + c] = component(from, a.component_type, a.normalized);
  });
  data_ = reinterpret_cast<const std::byte*>(owned_.data());
  stride_ = components_ * sizeof(float);
}

FloatView::FloatView(std::vector<float> values, std::size_t components)
    : size_(values.size() / components), components_(components), owned_(std::move(values)) {
  data_ = reinterpret_cast<const std::byte*>(owned_.data());
  stride_ = components_ * sizeof(float);
}

IndexView::IndexView(const Accessor& a, const Element& reference) : size_(a.count), type_(a.component_type) {
  if (!is_unsigned(a.component_type))
    throw Error::bad_input(reference.file(), a.name + ".componentType", "an unsigned type, for indices",
                           std::to_string(a.component_type));
  if (a.data && a.sparse_count == 0) {
    data_ = a.data;
    stride_ = a.stride;
    return;
  }
  owned_.resize(a.count * a.components);
  each_value(a, [&](std::size_t i, std::size_t c, const std::byte* from) {
    owned_[i * a.components + c] = unsigned_component(from, a.component_type);
  });
  type_ = kUnsignedInt;
  data_ = reinterpret_cast<const std::byte*>(owned_.data());
  stride_ = a.components * sizeof(std::uint32_t);
}

IndexView::IndexView(std::vector<std::uint32_t> values, std::size_t components)
    : stride_(components * sizeof(std::uint32_t)), size_(values.size() / components), owned_(std::move(values)) {
  data_ = reinterpret_cast<const std::byte*>(owned_.data());
}

std::uint32_t IndexView::at(std::size_t i, std::size_t component) const {
  return unsigned_component(data_ + i * stride_ + component * component_bytes(type_), type_);
}

}  // namespace gleaner::scene::gltf

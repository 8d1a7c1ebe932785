#pragma once
// Accessors: what buffers hold, by element. All ranges are checked when an accessor is made.

#include <cstddef>
#include <cstdint>
#include <cstring>
#include <span>
#include <string>
#include <vector>

#include "scene/import/gltf/document.h"

namespace gleaner::scene::gltf {

inline constexpr int kByte = 5120, kUnsignedByte = 5121, kShort = 5122, kUnsignedShort = 5123, kUnsignedInt = 5125,
                     kFloat = 5126;

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

// The accessor that `reference` names; its type must be among `types` (SCALAR, VEC2, VEC3, VEC4, MAT4).
Accessor accessor_of(const Document& document, const Element& reference, std::initializer_list<const char*> types);

// Values of an accessor as floats, straight from the buffer where that holds them so, else converted: normalized
// integers become [0, 1] or [-1, 1].
class FloatView {
 public:
  FloatView() = default;
  explicit FloatView(const Accessor& accessor);
  FloatView(std::vector<float> values, std::size_t components);  // as they are
  FloatView(const FloatView&) = delete;
  FloatView& operator=(const FloatView&) = delete;
  FloatView(FloatView&&) = default;
  FloatView& operator=(FloatView&&) = default;

  std::size_t size() const { return size_; }
  std::size_t components() const { return components_; }
  // `to` has room for components().
  void load(std::size_t i, float* to) const { std::memcpy(to, data_ + i * stride_, components_ * sizeof(float)); }

 private:
  const std::byte* data_ = nullptr;
  std::size_t stride_ = 0, size_ = 0, components_ = 0;
  std::vector<float> owned_;
};

// Unsigned integers of an accessor, straight from the buffer where it is not sparse.
class IndexView {
 public:
  IndexView() = default;
  // Refuses other than unsigned types.
  IndexView(const Accessor& accessor, const Element& reference);
  explicit IndexView(std::vector<std::uint32_t> values, std::size_t components = 1);  // as they are
  IndexView(const IndexView&) = delete;
  IndexView& operator=(const IndexView&) = delete;
  IndexView(IndexView&&) = default;
  IndexView& operator=(IndexView&&) = default;

  std::size_t size() const { return size_; }
  std::uint32_t at(std::size_t i, std::size_t component = 0) const;

 private:
  const std::byte* data_ = nullptr;
  std::size_t stride_ = 0, size_ = 0;
  int type_ = kUnsignedInt;
  std::vector<std::uint32_t> owned_;
};

}  // namespace gleaner::scene::gltf

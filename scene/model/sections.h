#pragma once
// Runs of bytes with a table of sections: BlobHeader, then `sections` BlobSection records, then the sections' bytes,
// each beginning at a multiple of 64, gaps filled with zeros. Little-endian. Sections come in a fixed order, so that
// equal contents have equal bytes.

#include <algorithm>
#include <bit>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <initializer_list>
#include <span>
#include <string>
#include <type_traits>
#include <vector>

#include "scene/model/blob.h"
#include "scene/model/error.h"

namespace gleaner::scene {

static_assert(std::endian::native == std::endian::little, "blobs are little-endian and copied as they stand");

inline constexpr std::uint64_t kAlignment = 64;
inline constexpr std::uint32_t kVersion = 4;

struct BlobHeader {
  char magic[8];
  std::uint32_t version;
  std::uint32_t sections;
  std::uint64_t bytes;  // of the whole blob
};
static_assert(sizeof(BlobHeader) == 24);

struct BlobSection {
  std::uint32_t id;
  std::uint32_t element_bytes;
  std::uint64_t offset;  // from the blob's beginning
  std::uint64_t count;   // elements
};
static_assert(sizeof(BlobSection) == 24);

class SectionWriter {
 public:
  SectionWriter(const char (&magic)[8], std::uint32_t sections) : sections_(sections) {
    bytes_.resize(sizeof(BlobHeader) + sections * sizeof(BlobSection));
    BlobHeader header{{}, kVersion, sections, 0};
    std::copy_n(magic, sizeof magic, header.magic);
    std::memcpy(bytes_.data(), &header, sizeof header);
  }

  // Reserving what all sections will take spares a scene of many megabytes its copies.
  void expect(std::uint64_t bytes) { bytes_.reserve(bytes_.size() + bytes + sections_ * kAlignment); }

  template <typename T>
  void add(std::uint32_t id, const std::vector<T>& values) {
    static_assert(std::is_trivially_copyable_v<T>);
    bytes_.resize((bytes_.size() + kAlignment - 1) / kAlignment * kAlignment);
    const BlobSection section{id, sizeof(T), bytes_.size(), values.size()};
    std::memcpy(bytes_.data() + sizeof(BlobHeader) + written_++ * sizeof(BlobSection), &section, sizeof section);
    const auto* first = reinterpret_cast<const std::byte*>(values.data());
    bytes_.insert(bytes_.end(), first, first + values.size() * sizeof(T));
  }

  Bytes finish() {
    const std::uint64_t bytes = bytes_.size();
    std::memcpy(bytes_.data() + offsetof(BlobHeader, bytes), &bytes, sizeof bytes);
    return std::move(bytes_);
  }

 private:
  std::uint32_t sections_, written_ = 0;
  Bytes bytes_;
};

class SectionReader {
 public:
  // `counts`: how many sections there may be.
  SectionReader(std::span<const std::byte> bytes, const char (&magic)[8], std::initializer_list<std::uint32_t> counts,
                const std::string& origin)
      : bytes_(bytes), origin_(origin) {
    BlobHeader header;
    if (bytes.size() < sizeof header) fail("header", std::to_string(sizeof header) + " bytes", bytes.size());
    std::memcpy(&header, bytes.data(), sizeof header);
    if (!std::equal(header.magic, header.magic + sizeof magic, magic))
      throw Error::bad_input(origin_, "magic", magic, "other bytes");
    if (header.version != kVersion) fail("version", std::to_string(kVersion), header.version);
    if (header.bytes != bytes.size()) fail("bytes", std::to_string(header.bytes), bytes.size());
    const std::uint32_t sections = header.sections;
    if (std::find(counts.begin(), counts.end(), sections) == counts.end())
      fail("sections", std::to_string(*counts.begin()), sections);
    if (bytes.size() < sizeof header + sections * sizeof(BlobSection)) fail("table", "all sections", bytes.size());
    sections_.resize(sections);
    std::memcpy(sections_.data(), bytes.data() + sizeof header, sections * sizeof(BlobSection));
    std::uint64_t end = sizeof header + sections * sizeof(BlobSection);
    for (std::uint32_t id = 0; id < sections; ++id) {
      const BlobSection& s = sections_[id];
      const std::string name = "section " + std::to_string(id);
      if (s.id != id) fail(name, "id " + std::to_string(id), s.id);
      // Sections follow one another and only zeros lie between them: one scene, one run of bytes.
      const std::uint64_t start = (end + kAlignment - 1) / kAlignment * kAlignment;
      if (s.offset != start || start > bytes.size()) fail(name, "offset " + std::to_string(start), s.offset);
      if (std::any_of(bytes.begin() + end, bytes.begin() + start, [](std::byte b) { return b != std::byte{0}; }))
        throw Error::bad_input(origin_, name, "zeros before it", "other bytes");
      const std::uint64_t room = bytes.size() - start;
      if (s.element_bytes == 0 || s.count > room / s.element_bytes)
        fail(name, "at most " + std::to_string(room) + " bytes", s.count);
      end = start + s.count * s.element_bytes;
    }
    if (end != bytes.size()) fail("end", std::to_string(end), bytes.size());
  }

  std::uint32_t sections() const { return static_cast<std::uint32_t>(sections_.size()); }

  template <typename T>
  std::vector<T> read(std::uint32_t id) const {
    static_assert(std::is_trivially_copyable_v<T>);
    const BlobSection& s = sections_[id];
    if (s.element_bytes != sizeof(T))
      fail("section " + std::to_string(id), "elements of " + std::to_string(sizeof(T)) + " bytes", s.element_bytes);
    std::vector<T> values(s.count);
    if (s.count) std::memcpy(values.data(), bytes_.data() + s.offset, s.count * sizeof(T));
    return values;
  }

  template <typename T>
  std::vector<T> read(std::uint32_t id, std::uint64_t count) const {
    if (sections_[id].count != count)
      fail("section " + std::to_string(id), std::to_string(count) + " elements", sections_[id].count);
    return read<T>(id);
  }

  [[noreturn]] void fail(const std::string& element, const std::string& expected, std::uint64_t found) const {
    throw Error::bad_input(origin_, element, expected, std::to_string(found));
  }

 private:
  std::span<const std::byte> bytes_;
  const std::string& origin_;
  std::vector<BlobSection> sections_;
};

}  // namespace gleaner::scene

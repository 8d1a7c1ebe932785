#include "proto/packing.h"

#include <zstd.h>

#include <memory>

#include "scene/model/error.h"

namespace gleaner {

namespace {

// Of a scene, level 1 leaves 40 %, 3 35 %; of records 3 and 9 do the same. A core packs 0.25 GB of scenes a second, and
// 0.5 GB of records.
constexpr int level = 3;
constexpr std::size_t least_bytes = 256;  // fewer save nothing that counts

struct FreeCompressor {
  void operator()(ZSTD_CCtx* context) const { ZSTD_freeCCtx(context); }
};
struct FreeDecompressor {
  void operator()(ZSTD_DCtx* context) const { ZSTD_freeDCtx(context); }
};

// Calls move(where the byte lies in the records, where in the planes) for every byte.
template <typename Move>
void for_planes(std::size_t bytes, std::size_t stride, const Move& move) {
  std::size_t at = 0;
  for (std::size_t plane = 0; plane < stride && plane < bytes; ++plane)
    for (std::size_t from = plane; from < bytes; from += stride) move(from, at++);
}

}  // namespace

std::string pack(std::span<const std::byte> bytes, std::uint32_t stride) {
  if (bytes.size() < least_bytes) return {};
  thread_local const std::unique_ptr<ZSTD_CCtx, FreeCompressor> context(ZSTD_createCCtx());
  if (!context) throw Error::failed("no memory for Zstandard");
  scene::Bytes planes;
  if (stride > 1) {
    planes.resize(bytes.size());
    for_planes(bytes.size(), stride, [&](std::size_t from, std::size_t to) { planes[to] = bytes[from]; });
    bytes = planes;
  }
  // One byte less than what it is made of is room enough: a frame that does not fit saves nothing.
  std::string packed(bytes.size() - 1, '\0');
  const std::size_t size =
      ZSTD_compressCCtx(context.get(), packed.data(), packed.size(), bytes.data(), bytes.size(), level);
  if (ZSTD_isError(size)) return {};
  packed.resize(size);
  return packed;
}

scene::Bytes unpack(std::string_view packed, std::uint32_t stride, std::size_t most_bytes) {
  thread_local const std::unique_ptr<ZSTD_DCtx, FreeDecompressor> context(ZSTD_createDCtx());
  if (!context) throw Error::failed("no memory for Zstandard");
  if (stride == 0) throw Error::bad_input("packed bytes", "stride", "at least 1", "0");
  const unsigned long long size = ZSTD_getFrameContentSize(packed.data(), packed.size());
  if (size == ZSTD_CONTENTSIZE_ERROR || size == ZSTD_CONTENTSIZE_UNKNOWN || size > most_bytes)
    throw Error::bad_input("packed bytes", "Zstandard frame", "one of at most " + std::to_string(most_bytes) + " bytes",
                           size > most_bytes && size < ZSTD_CONTENTSIZE_ERROR ? std::to_string(size) : "other bytes");
  scene::Bytes planes(size);
  const std::size_t found =
      ZSTD_decompressDCtx(context.get(), planes.data(), planes.size(), packed.data(), packed.size());
  if (ZSTD_isError(found) || found != size)
    throw Error::bad_input("packed bytes", "Zstandard frame", "one whole frame",
                           ZSTD_isError(found) ? ZSTD_getErrorName(found) : std::to_string(found) + " bytes");
  if (stride == 1) return planes;
  scene::Bytes bytes(planes.size());
  for_planes(bytes.size(), stride, [&](std::size_t to, std::size_t from) { bytes[to] = planes[from]; });
  return bytes;
}

}  // namespace gleaner

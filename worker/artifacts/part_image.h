#pragma once
// A part of a retained artifact as its holder keeps it and its readers check it: the image (of a counted artifact the
// table of counts, then the records) and the SHA-256 sums of the image's pieces. worker.proto has the definition.

#include <cstddef>
#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "scene/model/blob.h"

namespace gleaner::worker {

inline constexpr std::size_t sum_bytes = 32;
// Small, so that who reads the records of a few items fetches little beside them.
inline constexpr std::size_t summed_piece_bytes = std::size_t{64} << 10;

inline std::uint64_t pieces_of(std::uint64_t image_bytes) {
  return (image_bytes + summed_piece_bytes - 1) / summed_piece_bytes;
}

// The sums of an image that is given as segments, one behind the other: 32 bytes a piece.
scene::Bytes piece_sums(const std::vector<std::span<const std::byte>>& segments);
std::string digest_of_sums(std::span<const std::byte> sums);  // 32 bytes
// Whether these are the bytes of the image's piece `index`.
bool piece_matches(std::span<const std::byte> sums, std::uint64_t index, std::span<const std::byte> piece);

}  // namespace gleaner::worker

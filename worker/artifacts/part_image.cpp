#include "worker/artifacts/part_image.h"

#include <algorithm>
#include <cstring>

#include "proto/sha256.h"

namespace gleaner::worker {

scene::Bytes piece_sums(const std::vector<std::span<const std::byte>>& segments) {
  std::uint64_t bytes = 0;
  for (const auto& segment : segments) bytes += segment.size();
  scene::Bytes sums;
  sums.reserve(pieces_of(bytes) * sum_bytes);
  Sha256 hash;
  std::size_t filled = 0;
  const auto close = [&] {
    const std::string sum = hash.raw();
    const auto raw = std::as_bytes(std::span(sum));
    sums.insert(sums.end(), raw.begin(), raw.end());
    filled = 0;
  };
  for (auto segment : segments)
    while (!segment.empty()) {
      const std::size_t count = std::min(segment.size(), summed_piece_bytes - filled);
      hash.update(segment.first(count));
      segment = segment.subspan(count);
      filled += count;
      if (filled == summed_piece_bytes) close();
    }
  if (filled > 0) close();
  return sums;
}

std::string digest_of_sums(std::span<const std::byte> sums) {
  Sha256 hash;
  hash.update(sums);
  return hash.raw();
}

bool piece_matches(std::span<const std::byte> sums, std::uint64_t index, std::span<const std::byte> piece) {
  if (index >= sums.size() / sum_bytes) return false;
  const std::string sum = digest_of_sums(piece);  // the SHA-256 of any bytes
  return std::memcmp(sum.data(), sums.data() + index * sum_bytes, sum_bytes) == 0;
}

}  // namespace gleaner::worker

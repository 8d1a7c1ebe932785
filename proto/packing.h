#pragma once
// Bytes as they travel between coordinator and workers: compressed with Zstandard. Of records, all first bytes come
// first, then all second ones and so on: signs and exponents of neighbouring records are much alike, their mantissas
// are not.

#include <cstddef>
#include <cstdint>
#include <span>
#include <string>
#include <string_view>

#include "scene/model/blob.h"

namespace gleaner {

// The bytes as records of `stride` bytes (the last one may be cut; 1: no records), packed. Empty where that saves
// nothing.
std::string pack(std::span<const std::byte> bytes, std::uint32_t stride);
// Throws Error::bad_input where these are not packed bytes, or more than `most_bytes`: memory is taken for no more.
scene::Bytes unpack(std::string_view packed, std::uint32_t stride, std::size_t most_bytes);

}  // namespace gleaner

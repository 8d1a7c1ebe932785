#pragma once
// What coordinator and workers must agree on beside the messages of gleaner/v1.

#include <cstddef>
#include <cstdint>

namespace gleaner {

// A coordinator refuses workers of another version. Raised where a message or the records and parameters of a stage
// (kernels/*_records.h) change.
inline constexpr std::uint32_t protocol_version = 10;
inline constexpr std::size_t piece_bytes = std::size_t{1} << 20;  // largest piece of a blob, a file or a result

}  // namespace gleaner

#pragma once
// What a farm calls the files of a job's frames: frame_0007.exr, .png and .json.

#include <charconv>
#include <cstdint>
#include <cstdio>
#include <optional>
#include <string>
#include <string_view>

namespace gleaner::coordinator {

inline constexpr std::string_view before_frame_number = "frame_";

// Without its ending.
inline std::string frame_stem(std::uint32_t frame) {
  char number[16];
  std::snprintf(number, sizeof number, "%04u", frame);
  return std::string(before_frame_number) + number;
}

// The frame whose files have this stem; none: it is no frame's.
inline std::optional<std::uint32_t> frame_of_stem(std::string_view stem) {
  if (!stem.starts_with(before_frame_number)) return std::nullopt;
  stem.remove_prefix(before_frame_number.size());
  std::uint32_t frame = 0;
  const char* end = stem.data() + stem.size();
  if (const auto read = std::from_chars(stem.data(), end, frame); read.ec != std::errc() || read.ptr != end)
    return std::nullopt;
  return frame;
}

}  // namespace gleaner::coordinator

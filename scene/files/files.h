#pragma once
// Files that a scene consists of: read with their size known beforehand, and never from outside the scene's folder.

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

#include "scene/files/warnings.h"

namespace gleaner::scene {

// Largest file that is read: offsets in a .glb have 32 bits.
inline constexpr std::uint64_t kMaxFileBytes = 0xffffffffu;

// The size of a regular file. Throws Error::bad_input about `file` and `element` where there is none, or it is empty or
// too large. `file` and `element` say where the path was named; `path` is what is looked for.
std::uint64_t file_bytes(const std::filesystem::path& path, const std::string& file, const std::string& element);

// The first `count` bytes of a file that file_bytes() has measured.
std::vector<std::byte> read_file(const std::filesystem::path& path, std::uint64_t count, const std::string& file,
                                 const std::string& element);

// The path of something that `file` refers to by a relative `reference`, symbolic links resolved. Throws
// Error::bad_input where that lies outside the folder of `file`.
std::filesystem::path resolve_inside(const std::string& reference, const std::string& file, const std::string& element);

// resolve_inside(), forgiving what other systems forgive, with a warning: backslashes between folders, letters in
// another case. The path need not exist.
std::filesystem::path resolve_reference(const std::string& reference, const std::string& file,
                                        const std::string& element, Warnings* warnings = nullptr);

// "%20" to " "; a per cent sign without two hexadecimal digits stays. Throws Error::bad_input on a zero byte.
std::string percent_decoded(std::string_view uri, const std::string& file, const std::string& element);

// The bytes of a "data:" URI.
std::vector<std::byte> data_uri_bytes(std::string_view uri, const std::string& file, const std::string& element);

inline bool is_data_uri(std::string_view uri) { return uri.starts_with("data:"); }

}  // namespace gleaner::scene

#pragma once
// Files that are whole or absent: whoever opens `path` sees the old content or the new, whatever dies in between.

#include <cstddef>
#include <span>
#include <string>

namespace gleaner::coordinator {

// Temporary name in the same folder, fsync, rename, fsync of the folder. A symbolic link is followed. Several writers
// of one path: the last rename wins, whole. Throws Error::failed naming the path and the reason (missing folder, no
// space, not a regular file); the temporary file is gone then and an older file stands untouched.
void write_atomically(const std::string& path, std::span<const std::byte> bytes);

}  // namespace gleaner::coordinator

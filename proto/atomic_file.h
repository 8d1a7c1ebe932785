#pragma once
// Files that are whole or absent: whoever opens `path` sees the old content or the new, whatever dies in between.

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <span>
#include <string>

#include "scene/model/error.h"

namespace gleaner {

// There is no room, now: somebody may make some.
struct DiskFull : Error {
  explicit DiskFull(std::string message) : Error(ErrorKind::failed, std::move(message)) {}
};

// Temporary name in the same folder, fsync, rename, fsync of the folder. A symbolic link is followed. Several writers
// of one path: the last rename wins, whole. All throw Error::failed naming the path and the reason (missing folder, not
// a regular file); DiskFull where there is no room.
class AtomicFile {
 public:
  // `mode`: of the new file, as open() takes it.
  explicit AtomicFile(const std::string& path, unsigned mode = 0666);
  ~AtomicFile();  // without commit() the temporary file is gone then, and an older file stands untouched
  AtomicFile(const AtomicFile&) = delete;
  AtomicFile& operator=(const AtomicFile&) = delete;

  void append(std::span<const std::byte> bytes);
  void write_at(std::uint64_t offset, std::span<const std::byte> bytes);
  void commit();

 private:
  void check(bool ok, const char* step);

  std::string path_;  // as people named it
  std::filesystem::path target_, folder_;
  std::string temporary_;
  std::uint64_t size_ = 0;
  int descriptor_ = -1;
};

void write_atomically(const std::string& path, std::span<const std::byte> bytes, unsigned mode = 0666);

}  // namespace gleaner

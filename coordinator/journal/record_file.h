#pragma once
// A file of accepted records, for a coordinator that goes on where another one died. The journal knows what lies where.

#include <cstdint>
#include <filesystem>
#include <mutex>
#include <span>
#include <utility>

#include "scene/model/blob.h"

namespace gleaner::coordinator {

// Thread-safe. The file is opened when it is first used.
class RecordFile {
 public:
  explicit RecordFile(std::filesystem::path path) : path_(std::move(path)) {}
  ~RecordFile();
  RecordFile(const RecordFile&) = delete;
  RecordFile& operator=(const RecordFile&) = delete;

  const std::filesystem::path& path() const { return path_; }
  // Behind what was there; makes file and folder. Returns where the bytes begin. Throws Error::failed, naming the file
  // and the reason.
  std::uint64_t append(std::span<const std::byte> bytes);
  // Throws Error::failed where the file is not there or has no such bytes.
  scene::Bytes read(std::uint64_t offset, std::uint64_t bytes);

 private:
  void open(bool make);  // mutex held

  const std::filesystem::path path_;
  std::mutex mutex_;
  int descriptor_ = -1;
  std::uint64_t size_ = 0;
};

}  // namespace gleaner::coordinator

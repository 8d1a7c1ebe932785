#pragma once
// A coordinator's folder is its own: two of them would write over each other's files.

#include <filesystem>

namespace gleaner::cli {

class DataLock {
 public:
  // Makes the folder. Throws Error::failed where it cannot be written, or another process holds it. The lock ends with
  // the process, however that ends.
  explicit DataLock(const std::filesystem::path& folder);
  ~DataLock();
  DataLock(const DataLock&) = delete;
  DataLock& operator=(const DataLock&) = delete;

 private:
  int descriptor_ = -1;
};

}  // namespace gleaner::cli

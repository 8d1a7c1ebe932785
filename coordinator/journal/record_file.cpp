#include "coordinator/journal/record_file.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <system_error>

#include "scene/model/error.h"
#include "scene/model/names.h"

namespace gleaner::coordinator {

namespace {

[[noreturn]] void fail(const std::filesystem::path& path, const char* step, int code) {
  throw Error::failed(printable(path.string()) + ": cannot " + step + ": " + std::generic_category().message(code));
}

}  // namespace

RecordFile::~RecordFile() {
  if (descriptor_ >= 0) ::close(descriptor_);
}

void RecordFile::open(bool make) {
  if (descriptor_ >= 0) return;
  if (make) {
    std::error_code code;
    std::filesystem::create_directories(path_.parent_path(), code);
    if (code) fail(path_.parent_path(), "make the folder", code.value());
  }
  descriptor_ = ::open(path_.c_str(), O_RDWR | O_CLOEXEC | (make ? O_CREAT : 0), 0644);
  struct stat status {};
  if (descriptor_ < 0 || ::fstat(descriptor_, &status) != 0) fail(path_, "open", errno);
  size_ = static_cast<std::uint64_t>(status.st_size);
}

std::uint64_t RecordFile::append(std::span<const std::byte> bytes) {
  std::uint64_t begin = 0;
  {
    std::lock_guard lock(mutex_);
    open(true);
    begin = size_;
    size_ += bytes.size();
  }
  for (std::uint64_t offset = begin; !bytes.empty();) {
    const ssize_t count = ::pwrite(descriptor_, bytes.data(), bytes.size(), static_cast<off_t>(offset));
    if (count < 0 && errno == EINTR) continue;
    if (count < 0) fail(path_, "write", errno);
    bytes = bytes.subspan(static_cast<std::size_t>(count));
    offset += static_cast<std::uint64_t>(count);
  }
  return begin;
}

scene::Bytes RecordFile::read(std::uint64_t offset, std::uint64_t bytes) {
  {
    std::lock_guard lock(mutex_);
    open(false);
    // Checked before memory is taken.
    if (offset > size_ || bytes > size_ - offset)
      throw Error::failed(printable(path_.string()) + ": expected " + std::to_string(bytes) + " bytes at " +
                          std::to_string(offset) + ", found a file of " + std::to_string(size_));
  }
  scene::Bytes all(bytes);
  for (std::uint64_t done = 0; done < bytes;) {
    const ssize_t count = ::pread(descriptor_, all.data() + done, bytes - done, static_cast<off_t>(offset + done));
    if (count < 0 && errno == EINTR) continue;
    if (count < 0) fail(path_, "read", errno);
    if (count == 0) throw Error::failed(printable(path_.string()) + ": it has become shorter");
    done += static_cast<std::uint64_t>(count);
  }
  return all;
}

}  // namespace gleaner::coordinator

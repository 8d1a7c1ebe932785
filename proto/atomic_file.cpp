#include "proto/atomic_file.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <atomic>
#include <cerrno>
#include <filesystem>
#include <system_error>
#include <utility>

#include "scene/model/error.h"

namespace gleaner {
namespace {

[[noreturn]] void fail(const std::string& path, const std::string& step, int code) {
  const std::string words = path + ": cannot " + step + ": " + std::generic_category().message(code);
  if (code == ENOSPC || code == EDQUOT) throw DiskFull(words);
  throw Error::failed(words);
}

// Calls `make` with names of temporary files in the folder until one is free. They do not grow from the target's, which
// may be as long as the file system allows.
template <typename Make>
std::string make_beside(const std::filesystem::path& folder, const std::string& target, const Make& make) {
  static std::atomic<unsigned> counter{0};
  while (true) {
    const auto name = ".gleaner-" + std::to_string(::getpid()) + "-" + std::to_string(counter++) + ".tmp";
    const auto path = (folder / name).string();
    if (make(path.c_str()) >= 0) return path;
    if (errno != EEXIST) fail(target, "write", errno);
  }
}

}  // namespace

AtomicFile::AtomicFile(const std::string& path, unsigned mode) : path_(path), target_(path) {
  std::error_code ignored;
  for (int hops = 0; hops < 40 && std::filesystem::is_symlink(target_, ignored); ++hops)
    target_ = target_.parent_path() / std::filesystem::read_symlink(target_, ignored);
  // A rename would replace a device node such as /dev/null by a file, for everyone on the machine.
  const auto kind = std::filesystem::status(target_, ignored);
  if (std::filesystem::exists(kind) && !std::filesystem::is_regular_file(kind))
    throw Error::failed(path_ + ": cannot write: not a regular file");
  folder_ = target_.has_parent_path() ? target_.parent_path() : std::filesystem::path(".");
  // Without a name, nothing of it is left where the process is killed.
  descriptor_ = ::open(folder_.c_str(), O_TMPFILE | O_WRONLY | O_CLOEXEC, mode);
  if (descriptor_ >= 0) return;
  // Not every file system has such files.
  temporary_ = make_beside(folder_, path_, [&](const char* name) {
    return descriptor_ = ::open(name, O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, mode);
  });
}

AtomicFile::~AtomicFile() {
  if (descriptor_ >= 0) ::close(descriptor_);
  if (!temporary_.empty()) ::unlink(temporary_.c_str());
}

void AtomicFile::check(bool ok, const char* step) {
  if (!ok) fail(path_, step, errno);
}

void AtomicFile::append(std::span<const std::byte> bytes) {
  write_at(size_, bytes);
  size_ += bytes.size();
}

void AtomicFile::write_at(std::uint64_t offset, std::span<const std::byte> bytes) {
  while (!bytes.empty()) {
    const ssize_t written = ::pwrite(descriptor_, bytes.data(), bytes.size(), static_cast<off_t>(offset));
    if (written < 0 && errno == EINTR) continue;
    check(written >= 0, "write");
    bytes = bytes.subspan(static_cast<std::size_t>(written));
    offset += static_cast<std::uint64_t>(written);
  }
}

void AtomicFile::commit() {
  check(::fsync(descriptor_) == 0, "flush");
  // A link cannot take another file's place; a rename can.
  if (temporary_.empty()) {
    const std::string own = "/proc/self/fd/" + std::to_string(descriptor_);
    temporary_ = make_beside(folder_, path_, [&](const char* name) {
      return ::linkat(AT_FDCWD, own.c_str(), AT_FDCWD, name, AT_SYMLINK_FOLLOW);
    });
  }
  // NFS and quotas report a failed write here, so the result of close counts.
  const int descriptor = std::exchange(descriptor_, -1);
  check(::close(descriptor) == 0, "close");
  check(::rename(temporary_.c_str(), target_.c_str()) == 0, "rename");
  temporary_.clear();

  // The file is whole and in place; only a file system that cannot flush folders (EINVAL) is excused.
  descriptor_ = ::open(folder_.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  check(descriptor_ >= 0, "open the folder of");
  check(::fsync(descriptor_) == 0 || errno == EINVAL, "flush the folder of");
}

void write_atomically(const std::string& path, std::span<const std::byte> bytes, unsigned mode) {
  AtomicFile file(path, mode);
  file.append(bytes);
  file.commit();
}

}  // namespace gleaner

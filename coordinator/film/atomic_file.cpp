#include "coordinator/film/atomic_file.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <atomic>
#include <cerrno>
#include <filesystem>
#include <system_error>

#include "scene/model/error.h"

namespace gleaner::coordinator {
namespace {

[[noreturn]] void fail(const std::string& path, const std::string& step, int code) {
  throw Error::failed(path + ": cannot " + step + ": " + std::generic_category().message(code));
}

class Descriptor {
 public:
  explicit Descriptor(int fd) : fd_(fd) {}
  ~Descriptor() {
    if (fd_ >= 0) ::close(fd_);
  }
  Descriptor(const Descriptor&) = delete;
  Descriptor& operator=(const Descriptor&) = delete;
  int get() const { return fd_; }
  // NFS and quotas report a failed write here, so the result of close counts.
  int close() {
    const int fd = fd_;
    fd_ = -1;
    return ::close(fd);
  }

 private:
  int fd_;
};

struct Temporary {
  std::string path;
  int fd;
};

// The name does not grow from the target's, which may be as long as the file system allows.
Temporary create_beside(const std::filesystem::path& folder, const std::string& target) {
  static std::atomic<unsigned> counter{0};
  while (true) {
    const auto name = ".gleaner-" + std::to_string(::getpid()) + "-" + std::to_string(counter++) + ".tmp";
    const auto path = (folder / name).string();
    const int fd = ::open(path.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0666);
    if (fd >= 0) return {path, fd};
    if (errno != EEXIST) fail(target, "write", errno);
  }
}

}  // namespace

void write_atomically(const std::string& path, std::span<const std::byte> bytes) {
  std::filesystem::path target = path;
  std::error_code ignored;
  for (int hops = 0; hops < 40 && std::filesystem::is_symlink(target, ignored); ++hops)
    target = target.parent_path() / std::filesystem::read_symlink(target, ignored);
  // A rename would replace a device node such as /dev/null by a file, for everyone on the machine.
  const auto kind = std::filesystem::status(target, ignored);
  if (std::filesystem::exists(kind) && !std::filesystem::is_regular_file(kind))
    throw Error::failed(path + ": cannot write: not a regular file");
  const auto folder = target.has_parent_path() ? target.parent_path() : std::filesystem::path(".");

  const Temporary temporary = create_beside(folder, path);
  Descriptor file(temporary.fd);
  const auto check = [&](bool ok, const char* step) {
    if (ok) return;
    const int code = errno;
    ::unlink(temporary.path.c_str());
    fail(path, step, code);
  };
  for (auto rest = bytes; !rest.empty();) {
    const ssize_t written = ::write(file.get(), rest.data(), rest.size());
    if (written < 0 && errno == EINTR) continue;
    check(written >= 0, "write");
    rest = rest.subspan(static_cast<std::size_t>(written));
  }
  check(::fsync(file.get()) == 0, "flush");
  check(file.close() == 0, "close");
  check(::rename(temporary.path.c_str(), target.c_str()) == 0, "rename");

  // The file is whole and in place; only a file system that cannot flush folders (EINVAL) is excused.
  Descriptor directory(::open(folder.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC));
  if (directory.get() < 0) fail(path, "open the folder of", errno);
  if (::fsync(directory.get()) != 0 && errno != EINVAL) fail(path, "flush the folder of", errno);
}

}  // namespace gleaner::coordinator

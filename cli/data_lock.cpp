#include "cli/data_lock.h"

#include <fcntl.h>
#include <sys/file.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>
#include <string>
#include <system_error>

#include "scene/model/error.h"

namespace gleaner::cli {

namespace fs = std::filesystem;

DataLock::DataLock(const fs::path& folder) {
  std::error_code code;
  fs::create_directories(folder, code);
  if (code) throw Error::failed(folder.string() + ": cannot make the folder: " + code.message());
  const fs::path file = folder / "lock";
  descriptor_ = ::open(file.c_str(), O_RDWR | O_CREAT | O_CLOEXEC, 0644);
  if (descriptor_ < 0) throw Error::failed(file.string() + ": cannot open: " + std::strerror(errno));
  if (::flock(descriptor_, LOCK_EX | LOCK_NB) != 0) {
    const int why = errno;
    ::close(descriptor_);
    if (why == EWOULDBLOCK)
      throw Error::failed("--data " + folder.string() + ": another coordinator works in this folder");
    throw Error::failed(file.string() + ": cannot lock: " + std::strerror(why));
  }
}

DataLock::~DataLock() { ::close(descriptor_); }

}  // namespace gleaner::cli

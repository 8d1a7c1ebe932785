#include "worker/device/compile_turn.h"

#include <fcntl.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include <thread>

namespace gleaner::worker {
namespace {

bool is_done(int descriptor) {
  struct stat file {};
  return ::fstat(descriptor, &file) == 0 && file.st_size > 0;
}

}  // namespace

CompileTurn::CompileTurn(const std::filesystem::path& mark, std::chrono::milliseconds patience) {
  if (mark.empty()) return;
  // Kernels are launched for the first time in every batch: the folder is made where it is missing alone.
  const auto open_mark = [&] { return ::open(mark.c_str(), O_RDWR | O_CREAT | O_CLOEXEC, 0644); };
  descriptor_ = open_mark();
  if (std::error_code ignored; descriptor_ < 0 && std::filesystem::create_directories(mark.parent_path(), ignored))
    descriptor_ = open_mark();
  if (descriptor_ < 0) return;
  const auto end = std::chrono::steady_clock::now() + patience;
  while (!is_done(descriptor_) && ::flock(descriptor_, LOCK_EX | LOCK_NB) != 0 &&
         std::chrono::steady_clock::now() < end)
    std::this_thread::sleep_for(std::chrono::milliseconds(5));
  if (!is_done(descriptor_)) return;
  ::close(descriptor_);
  descriptor_ = -1;
}

CompileTurn::~CompileTurn() {
  if (descriptor_ >= 0) ::close(descriptor_);
}

void CompileTurn::done() {
  // Where it cannot be written, others take turns again: that costs them a look at the cache.
  if (descriptor_ < 0) return;
  [[maybe_unused]] const ssize_t written = ::pwrite(descriptor_, "1", 1, 0);
}

}  // namespace gleaner::worker

#include "scene/model/program_folder.h"

#include <system_error>

namespace gleaner {

std::filesystem::path program_folder() {
  std::error_code code;
  const auto program = std::filesystem::read_symlink("/proc/self/exe", code);
  return code ? std::filesystem::path() : program.parent_path().parent_path();
}

}  // namespace gleaner

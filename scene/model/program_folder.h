#pragma once

#include <filesystem>

namespace gleaner {

// The folder that holds the running program's bin/ (or tests/) and, beside it, what programs load: lib/, oidn/. Empty
// where the system does not tell it.
std::filesystem::path program_folder();

}  // namespace gleaner

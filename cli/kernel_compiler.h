#pragma once
// A process that compiles kernels for a worker (worker/device/kernel_compilers.h): the same program, started with a
// word that people do not type.

#include <string>
#include <vector>

namespace gleaner::cli {

// What starts it, without the device's number.
std::vector<std::string> kernel_compiler();
// Whether this process was started so; then it has served until its input ended.
bool served_as_kernel_compiler(int argc, char** argv);

}  // namespace gleaner::cli

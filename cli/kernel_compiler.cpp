#include "cli/kernel_compiler.h"

#include <cstdlib>
#include <iostream>

#include "worker/device/kernel_compilers.h"

namespace gleaner::cli {
namespace {
constexpr const char* kWord = "compile-kernels";
}

std::vector<std::string> kernel_compiler() { return {"/proc/self/exe", kWord}; }

bool served_as_kernel_compiler(int argc, char** argv) {
  if (argc != 3 || argv[1] != std::string(kWord)) return false;
  worker::DeviceChoice choice;
  choice.device = std::atoi(argv[2]);
  try {
    worker::serve_kernel_compiler(choice, std::cin, std::cout);
  } catch (const std::exception& error) {
    // Who started it compiles alone then, and meets the same error.
    std::cerr << error.what() << "\n";
  }
  return true;
}

}  // namespace gleaner::cli

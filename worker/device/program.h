#pragma once
// A built program, and what parameters its kernels declare.

#include <filesystem>
#include <map>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "worker/device/opencl.h"

namespace gleaner::worker {

struct KernelParameter {
  enum class Kind { buffer, uint, real, other };
  std::string name;
  Kind kind = Kind::other;
};

// By kernel. A kernel that the preprocessor chooses from several has several declarations.
using KernelDeclarations = std::multimap<std::string, std::vector<KernelParameter>>;

// Reads the declarations in the text of a program: clGetKernelArgInfo knows nothing of a program that was loaded as a
// binary. A macro that stands for parameters (SCENE_PARAMETERS) is expanded; a parameter list must not contain
// preprocessor lines. Throws Error::failed (named `file`) on a list that it cannot read.
KernelDeclarations parse_kernels(std::string_view text, const std::string& file);

struct Program {
  std::string file, options;
  cl::Program handle{};
  std::shared_ptr<const KernelDeclarations> kernels{};
  // With a kernel's name behind it: its turn to be compiled (compile_turn.h). May be empty.
  std::filesystem::path mark{};
};

}  // namespace gleaner::worker

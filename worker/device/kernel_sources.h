#pragma once
// The kernels' text as it was when the program was built.

#include <string_view>
#include <vector>

namespace gleaner::worker {

struct KernelSource {
  std::string_view path;  // below the source root, as #include names it
  std::string_view text;
};

const std::vector<KernelSource>& kernel_sources();

}  // namespace gleaner::worker

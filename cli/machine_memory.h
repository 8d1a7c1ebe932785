#pragma once
// How much memory this process may take.

#include <cstdint>

namespace gleaner::cli {

// Bytes: the machine's, or its container's limit (cgroup v2, v1) where that is less.
std::uint64_t machine_memory();

}  // namespace gleaner::cli

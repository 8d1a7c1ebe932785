#pragma once
// What each target tells initialize.cpp.

#include <string>
#include <vector>

namespace gleaner::fuzz {

// Inputs that a fuzzer may begin with. Each target defines it.
std::vector<std::string> seeds();

}  // namespace gleaner::fuzz

#pragma once
// Reading --set KEY=VALUE.

#include <cstdint>
#include <string>

#include "coordinator/plan/plan.h"

namespace gleaner::coordinator {

// The setting's value, or `otherwise` where it was not given. Throws Error::usage for what is no number of the range.
std::uint32_t whole_setting(const FrameSettings& settings, const std::string& key, std::uint32_t otherwise,
                            std::uint32_t least, std::uint32_t most);
double real_setting(const FrameSettings& settings, const std::string& key, double otherwise, double least, double most);

}  // namespace gleaner::coordinator

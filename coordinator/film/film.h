#pragma once
// A frame's picture: named float channels of one size, row 0 at the top.

#include <cstdint>
#include <string>
#include <vector>

namespace gleaner::coordinator {

struct Channel {
  std::string name;           // EXR name: "R", "direct.G", "depth.Z", ...
  std::vector<float> values;  // width * height
};

struct Film {
  std::uint32_t width = 0, height = 0;
  std::vector<Channel> channels;

  Channel& channel(const std::string& name);           // made (zero) where it is not there
  const Channel* find(const std::string& name) const;  // null where it is not there
};

}  // namespace gleaner::coordinator

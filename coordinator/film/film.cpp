#include "coordinator/film/film.h"

#include <algorithm>

namespace gleaner::coordinator {

Channel& Film::channel(const std::string& name) {
  const auto found = std::ranges::find(channels, name, &Channel::name);
  if (found != channels.end()) return *found;
  return channels.emplace_back(Channel{name, std::vector<float>(std::size_t{width} * height)});
}

const Channel* Film::find(const std::string& name) const {
  const auto found = std::ranges::find(channels, name, &Channel::name);
  return found == channels.end() ? nullptr : &*found;
}

}  // namespace gleaner::coordinator

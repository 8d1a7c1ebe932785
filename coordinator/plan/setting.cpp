#include "coordinator/plan/setting.h"

#include <charconv>

#include "scene/model/error.h"

namespace gleaner::coordinator {
namespace {

template <typename Number>
Number read(const FrameSettings& settings, const std::string& key, Number otherwise, Number least, Number most,
            const char* what) {
  const auto given = settings.set.find(key);
  if (given == settings.set.end()) return otherwise;
  const std::string& text = given->second;
  Number value{};
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (error != std::errc() || end != text.data() + text.size() || !(value >= least && value <= most)) {
    std::string range = std::to_string(least) + " to " + std::to_string(most);
    throw Error::usage("--set " + key + ": expected " + what + " from " + range + ", found \"" + text + "\"");
  }
  return value;
}

}  // namespace

std::uint32_t whole_setting(const FrameSettings& settings, const std::string& key, std::uint32_t otherwise,
                            std::uint32_t least, std::uint32_t most) {
  return read(settings, key, otherwise, least, most, "a whole number");
}

double real_setting(const FrameSettings& settings, const std::string& key, double otherwise, double least,
                    double most) {
  return read(settings, key, otherwise, least, most, "a number");
}

}  // namespace gleaner::coordinator

#include "scene/model/names.h"

namespace gleaner {

std::size_t utf8_length(std::string_view text) {
  if (text.empty()) return 0;
  const auto byte = [&](std::size_t i) -> unsigned {
    return i < text.size() ? static_cast<unsigned char>(text[i]) : 0;
  };
  const auto follows = [&](std::size_t i, unsigned lower = 0x80, unsigned upper = 0xbf) {
    return byte(i) >= lower && byte(i) <= upper;
  };
  const unsigned first = byte(0);
  if (first < 0x80) return 1;
  if (first >= 0xc2 && first <= 0xdf) return follows(1) ? 2 : 0;
  if (first >= 0xe0 && first <= 0xef) {
    // No overlong forms, no surrogates.
    const unsigned lower = first == 0xe0 ? 0xa0 : 0x80, upper = first == 0xed ? 0x9f : 0xbf;
    return follows(1, lower, upper) && follows(2) ? 3 : 0;
  }
  if (first >= 0xf0 && first <= 0xf4) {
    const unsigned lower = first == 0xf0 ? 0x90 : 0x80, upper = first == 0xf4 ? 0x8f : 0xbf;
    return follows(1, lower, upper) && follows(2) && follows(3) ? 4 : 0;
  }
  return 0;
}

namespace {

// Escape sequences begin with them, and lines end: U+0000 to U+001F, U+007F to U+009F.
bool is_control(std::string_view character) {
  const auto first = static_cast<unsigned char>(character.front());
  return first < 0x20 || first == 0x7f || (first == 0xc2 && static_cast<unsigned char>(character[1]) < 0xa0);
}

}  // namespace

std::string printable(std::string_view name) {
  constexpr char digits[] = "0123456789abcdef";
  std::string text;
  while (!name.empty()) {
    if (const std::size_t length = utf8_length(name); length > 0 && !is_control(name.substr(0, length))) {
      text.append(name.substr(0, length));
      name.remove_prefix(length);
      continue;
    }
    const auto byte = static_cast<unsigned char>(name.front());
    text.append("\\x").push_back(digits[byte >> 4]);
    text.push_back(digits[byte & 15]);
    name.remove_prefix(1);
  }
  return text;
}

}  // namespace gleaner

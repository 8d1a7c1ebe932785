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

// Whether a terminal shows the character, instead of obeying it. `character` is well-formed UTF-8.
bool is_shown(std::string_view character) {
  const auto byte = [&](std::size_t i) { return static_cast<unsigned char>(character[i]); };
  switch (character.size()) {
    case 1:
      return byte(0) >= 0x20 && byte(0) != 0x7f;
    case 2:
      return byte(0) != 0xc2 || byte(1) >= 0xa0;  // U+0080 to U+009F
    case 3:
      // U+2028 to U+202E and U+2066 to U+2069: breaks of lines and paragraphs, embedded and isolated directions.
      return !(byte(0) == 0xe2 && ((byte(1) == 0x80 && byte(2) >= 0xa8 && byte(2) <= 0xae) ||
                                   (byte(1) == 0x81 && byte(2) >= 0xa6 && byte(2) <= 0xa9)));
    default:
      return true;
  }
}

// What stands for the first character of `text`, which it is removed from.
std::string take_character(std::string_view& text) {
  constexpr char digits[] = "0123456789abcdef";
  const std::size_t length = utf8_length(text);
  const std::string_view character = text.substr(0, length == 0 ? 1 : length);
  text.remove_prefix(character.size());
  if (length > 0 && is_shown(character)) return std::string(character);
  std::string escaped;
  for (const char c : character) {
    const auto byte = static_cast<unsigned char>(c);
    escaped.append("\\x").push_back(digits[byte >> 4]);
    escaped.push_back(digits[byte & 15]);
  }
  return escaped;
}

}  // namespace

std::string printable(std::string_view name, std::size_t most_bytes) {
  std::string text;
  while (!name.empty()) {
    const std::string character = take_character(name);
    if (character.size() > most_bytes - text.size()) break;
    text += character;
  }
  return text;
}

std::string printable_lines(std::string_view text) {
  std::string lines;
  for (std::size_t end; (end = text.find('\n')) != std::string_view::npos; text.remove_prefix(end + 1))
    lines += printable(text.substr(0, end)) + "\n";
  return lines + printable(text);
}

}  // namespace gleaner

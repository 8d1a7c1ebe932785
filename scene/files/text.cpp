#include "scene/files/text.h"

#include <algorithm>
#include <cctype>

#include "scene/model/names.h"

namespace gleaner::scene {

bool is_utf8(std::string_view text) {
  while (!text.empty()) {
    const std::size_t length = utf8_length(text);
    if (length == 0) return false;
    text.remove_prefix(length);
  }
  return true;
}

bool is_utf16(std::string_view text) {
  if (text.starts_with("\xff\xfe") || text.starts_with("\xfe\xff")) return true;
  return text.size() >= 4 && ((text[0] == 0 && text[1] != 0 && text[2] == 0 && text[3] != 0) ||
                              (text[0] != 0 && text[1] == 0 && text[2] != 0 && text[3] == 0));
}

std::string utf8_from_latin1(std::string_view text) {
  std::string result;
  result.reserve(text.size() + text.size() / 16);
  while (!text.empty()) {
    if (const std::size_t length = utf8_length(text)) {
      result.append(text.substr(0, length));
      text.remove_prefix(length);
      continue;
    }
    const auto byte = static_cast<unsigned char>(text.front());
    result.push_back(static_cast<char>(0xc0 | byte >> 6));
    result.push_back(static_cast<char>(0x80 | (byte & 0x3f)));
    text.remove_prefix(1);
  }
  return result;
}

std::string lower_case(std::string_view text) {
  std::string lower(text);
  std::transform(lower.begin(), lower.end(), lower.begin(), [](unsigned char c) { return std::tolower(c); });
  return lower;
}

std::string name_in_utf8(std::string_view text) { return is_utf8(text) ? std::string(text) : utf8_from_latin1(text); }

std::string in_quotes(std::string_view text) {
  constexpr std::size_t most = 80;
  if (text.empty()) return "nothing";
  std::string quoted = "\"";
  quoted.append(text.substr(0, most));
  return quoted.append(text.size() > most ? "...\"" : "\"");
}

}  // namespace gleaner::scene

#pragma once
// What encoding a text is in, and how a message quotes it.

#include <string>
#include <string_view>

namespace gleaner::scene {

bool is_utf8(std::string_view text);
// By its first bytes: a mark, or zeros between the letters.
bool is_utf16(std::string_view text);
// What is UTF-8 stays; each other byte becomes the letter that Latin-1 has for it.
std::string utf8_from_latin1(std::string_view text);

std::string lower_case(std::string_view text);

// A name as UTF-8, whichever of the two encodings the file is in.
std::string name_in_utf8(std::string_view text);

// For messages: the beginning of what was found in a file, or the word nothing.
std::string in_quotes(std::string_view text);

}  // namespace gleaner::scene

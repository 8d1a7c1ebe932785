#pragma once
// Names are bytes: those of files and of what is in them need not be UTF-8, but messages and JSON must be.

#include <cstddef>
#include <string>
#include <string_view>

namespace gleaner {

// Bytes of the well-formed UTF-8 sequence (Unicode 15, table 3-7) that `text` begins with; 0 where it begins with none.
std::size_t utf8_length(std::string_view text);

constexpr std::size_t most_name_bytes = 256;  // of a name that is shown

// `name` for messages, reports, logs and JSON: one line of UTF-8. UTF-8 stays as it is; any other byte becomes "\xHH",
// and so do the bytes of characters that a terminal obeys (control characters, breaks of lines, text directions). What
// is longer than `most_bytes` is cut between characters.
std::string printable(std::string_view name, std::size_t most_bytes = std::string_view::npos);

// The same for text that may have several lines, such as a compiler's messages: these stay.
std::string printable_lines(std::string_view text);

}  // namespace gleaner

#pragma once
// Names are bytes: those of files and of what is in them need not be UTF-8, but messages and JSON must be.

#include <cstddef>
#include <string>
#include <string_view>

namespace gleaner {

// Bytes of the well-formed UTF-8 sequence (Unicode 15, table 3-7) that `text` begins with; 0 where it begins with none.
std::size_t utf8_length(std::string_view text);

// `name` for messages, reports, logs and JSON: UTF-8 stays as it is, any other byte and those of control characters
// (new lines, what terminals obey) become "\xHH".
std::string printable(std::string_view name);

}  // namespace gleaner

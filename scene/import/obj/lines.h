#pragma once
// A text file line by line, read piece by piece.

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <fstream>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "scene/files/text.h"

namespace gleaner::scene::obj {

inline bool is_space(char c) { return c == ' ' || c == '\t' || c == '\v' || c == '\f'; }

inline std::string_view trimmed(std::string_view text) {
  while (!text.empty() && is_space(text.front())) text.remove_prefix(1);
  while (!text.empty() && is_space(text.back())) text.remove_suffix(1);
  return text;
}

// Takes the next word off the front of `text`; empty at its end.
inline std::string_view take_word(std::string_view& text) {
  std::size_t begin = 0;
  while (begin < text.size() && is_space(text[begin])) ++begin;
  std::size_t end = begin;
  while (end < text.size() && !is_space(text[end])) ++end;
  const std::string_view word = text.substr(begin, end - begin);
  text.remove_prefix(end);
  return word;
}

// Whether a word is how programs write NaN or an infinity.
bool is_not_finite(std::string_view word);

// The word as a finite number; nothing where it is none. What is too small for a double is 0.
std::optional<double> finite_number(std::string_view word);

// Lines end with LF, CR or both; a byte order mark is no part of the first. Continuation lines are joined. Comments are
// cut off, but not from statements whose rest is a name: '#' may be part of one. Makes errors that name the line.
class Lines {
 public:
  // `shown` and `element` name the file where it cannot be read; `path` is what is read.
  Lines(const std::filesystem::path& path, const std::string& shown, const std::string& element);

  // The next line that is not empty; nothing at the end. The view lasts until the next call.
  std::optional<std::string_view> next();

  std::string here() const { return "line " + std::to_string(number_); }
  const std::string& file() const { return file_; }

  [[noreturn]] void fail(const std::string& what, const std::string& expected, const std::string& found) const;
  // Finite numbers.
  double number(std::string_view word, const char* what) const;
  double within(std::string_view word, const char* what, double lower, double upper) const;

 private:
  std::optional<std::string_view> physical_line();
  std::optional<std::string_view> held_or_next_line();
  std::optional<std::string_view> next_special(std::string_view line);
  bool fill();

  std::string file_;
  std::ifstream stream_;
  std::vector<char> buffer_;
  std::size_t begin_ = 0, end_ = 0;  // of what is buffered and not yet read
  bool at_end_ = false;
  bool is_plain_ = true;  // the line that was read last has neither '#' nor a backslash nor a zero byte
  std::string joined_;
  std::optional<std::string> held_;  // a line that was read and not taken
  std::string given_;                // the held line that was given out
  std::size_t number_ = 0;
};

}  // namespace gleaner::scene::obj

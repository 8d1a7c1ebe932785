#include "scene/import/obj/lines.h"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <cstdio>
#include <cstring>

#include "scene/import/files.h"
#include "scene/import/text.h"
#include "scene/model/error.h"

namespace gleaner::scene::obj {
namespace {

constexpr std::size_t kPiece = std::size_t(1) << 20;  // bytes read at a time

// Statements whose rest is a name or a path, to the end of the line.
bool takes_a_name(std::string_view keyword) {
  const std::string word = lower_case(keyword);
  for (const char* each :
       {"g", "o", "usemtl", "mtllib", "newmtl", "usemap", "maplib", "bump", "norm", "disp", "decal", "refl"})
    if (word == each) return true;
  return word.starts_with("map_");
}

std::string_view without_comment(std::string_view line) {
  if (!std::memchr(line.data(), '#', line.size())) return line;
  std::string_view rest = line;
  if (takes_a_name(take_word(rest))) return line;
  std::size_t at = line.find('#');
  // "1.#IND" and its like are how some C libraries write what is no number.
  while (at != line.npos && at > 0 && line[at - 1] == '.') at = line.find('#', at + 1);
  return line.substr(0, at);
}

// Whether a line begins a statement of OBJ or MTL.
bool begins_statement(std::string_view line) {
  const std::string word = lower_case(take_word(line));
  for (const char* each : {"",   "v",  "vn", "vt", "vp", "f",  "l",  "p",     "s",  "ka", "kd",
                           "ks", "ke", "ns", "ni", "d",  "tr", "tf", "illum", "pr", "pm"})
    if (word == each) return true;
  return takes_a_name(word) || word.starts_with('#');
}

}  // namespace

std::string_view trimmed(std::string_view text) {
  while (!text.empty() && is_space(text.front())) text.remove_prefix(1);
  while (!text.empty() && is_space(text.back())) text.remove_suffix(1);
  return text;
}

std::string_view take_word(std::string_view& text) {
  std::size_t begin = 0;
  while (begin < text.size() && is_space(text[begin])) ++begin;
  std::size_t end = begin;
  while (end < text.size() && !is_space(text[end])) ++end;
  const std::string_view word = text.substr(begin, end - begin);
  text.remove_prefix(end);
  return word;
}

Lines::Lines(const std::filesystem::path& path, const std::string& shown, const std::string& element) : file_(shown) {
  file_bytes(path, shown, element);
  stream_.open(path, std::ios::binary);
  if (!stream_) throw Error::bad_input(shown, element, "a readable file", in_quotes(path.string()));
  file_ = element.empty() ? shown : path.string();
  fill();
  const std::string_view head(buffer_.data() + begin_, std::min<std::size_t>(end_ - begin_, 4));
  if (is_utf16(head)) throw Error::bad_input(file_, "", "text in UTF-8 or ASCII", "UTF-16");
  if (head.starts_with("\xef\xbb\xbf")) begin_ += 3;
}

// Makes room for more of the file behind what is buffered. False at the file's end.
bool Lines::fill() {
  if (at_end_) return false;
  std::copy(buffer_.begin() + static_cast<std::ptrdiff_t>(begin_), buffer_.begin() + static_cast<std::ptrdiff_t>(end_),
            buffer_.begin());
  end_ -= begin_;
  begin_ = 0;
  // A line that is longer than what is buffered doubles it.
  if (end_ + kPiece > buffer_.size()) buffer_.resize(std::max(end_ + kPiece, 2 * buffer_.size()));
  stream_.read(buffer_.data() + end_, static_cast<std::streamsize>(buffer_.size() - end_));
  const auto count = static_cast<std::size_t>(stream_.gcount());
  end_ += count;
  at_end_ = count == 0;
  return !at_end_;
}

std::optional<std::string_view> Lines::physical_line() {
  std::size_t at = begin_;
  for (;;) {
    while (at < end_ && buffer_[at] != '\n' && buffer_[at] != '\r') ++at;
    // What follows a CR decides whether it ends the line alone.
    if (at < end_ && (buffer_[at] == '\n' || at + 1 < end_ || at_end_)) break;
    const std::size_t length = at - begin_;
    if (!fill()) {
      if (begin_ == end_) return std::nullopt;
      at = begin_ + length;
      break;
    }
    at = begin_ + length;
  }
  ++number_;
  const std::string_view line(buffer_.data() + begin_, at - begin_);
  begin_ = at;
  if (begin_ < end_) begin_ += buffer_[at] == '\r' && at + 1 < end_ && buffer_[at + 1] == '\n' ? 2 : 1;
  return line;
}

std::optional<std::string_view> Lines::held_or_next_line() {
  if (!held_) return physical_line();
  given_ = std::move(*held_);
  held_.reset();
  return given_;
}

std::optional<std::string_view> Lines::next() {
  while (std::optional<std::string_view> line = held_or_next_line()) {
    std::string_view text = *line;
    // A comment goes on to its line's end, whatever stands there.
    if (trimmed(text).starts_with('#')) continue;
    if (trimmed(text).ends_with('\\')) {
      std::string_view rest = text;
      const bool is_name = takes_a_name(take_word(rest));
      joined_.assign(text);
      for (text = trimmed(joined_); text.ends_with('\\'); text = trimmed(joined_)) {
        line = physical_line();
        // A name may end with a backslash; the next statement is then no part of it.
        if (is_name && line && begins_statement(*line)) {
          held_ = std::string(*line);
          break;
        }
        joined_.assign(text.substr(0, text.size() - 1)).push_back(' ');
        joined_.append(line.value_or(std::string_view()));
      }
      text = joined_;
    }
    text = trimmed(without_comment(text));
    if (text.find('\0') != std::string_view::npos) fail("the text", "no zero bytes", "one");
    if (!text.empty()) return text;
  }
  return std::nullopt;
}

void Lines::fail(const std::string& what, const std::string& expected, const std::string& found) const {
  throw Error::bad_input(file_, here() + ": " + what, expected, found);
}

double Lines::number(std::string_view word, const char* what) const {
  double value = 0;
  std::string_view digits = word;
  if (digits.starts_with('+')) digits.remove_prefix(1);
  const auto [end, code] = std::from_chars(digits.data(), digits.data() + digits.size(), value);
  // What is too small for a double is as good as 0.
  const bool is_tiny = code == std::errc::result_out_of_range && digits.find("e-") != std::string_view::npos;
  if ((code != std::errc() && !is_tiny) || end != digits.data() + digits.size() || !std::isfinite(value))
    fail(what, "a finite number", in_quotes(word));
  return is_tiny ? 0 : value;
}

bool is_not_finite(std::string_view word) {
  if (word.starts_with('+') || word.starts_with('-')) word.remove_prefix(1);
  const std::string lower = lower_case(word);
  return lower.starts_with("nan") || lower.starts_with("inf") || lower.starts_with("1.#");
}

double Lines::within(std::string_view word, const char* what, double lower, double upper) const {
  const double value = number(word, what);
  // What rounding left beside the range.
  constexpr double rounding = 1e-5;
  if (value > upper && value <= upper * (1 + rounding)) return upper;
  if (!(value >= lower && value <= upper)) {
    char range[64];
    std::snprintf(range, sizeof range, upper < 1e30 ? "a number from %g to %g" : "a number of at least %g", lower,
                  upper);
    fail(what, range, in_quotes(word));
  }
  return value;
}

}  // namespace gleaner::scene::obj

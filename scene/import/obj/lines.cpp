#include "scene/import/obj/lines.h"

#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <cstdio>
#include <cstring>

#include "scene/files/files.h"
#include "scene/files/text.h"
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

// What a byte means for the division into lines.
enum Byte : unsigned char { kOrdinary, kSpecial, kEnd };
constexpr std::array<unsigned char, 256> kBytes = [] {
  std::array<unsigned char, 256> bytes{};
  for (const unsigned char c : {'#', '\\', '\0'}) bytes[c] = kSpecial;
  for (const unsigned char c : {'\n', '\r'}) bytes[c] = kEnd;
  return bytes;
}();

}  // namespace

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
  is_plain_ = true;
  for (;;) {
    // In locals: what is written to a member may be a byte of the buffer, as far as the compiler knows.
    const char* const bytes = buffer_.data();
    const std::size_t end = end_;
    unsigned char seen = kOrdinary, byte = kOrdinary;
    while (at < end && (byte = kBytes[static_cast<unsigned char>(bytes[at])]) != kEnd) seen |= byte, ++at;
    is_plain_ &= seen == kOrdinary;
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
  is_plain_ = false;
  given_ = std::move(*held_);
  held_.reset();
  return given_;
}

std::optional<std::string_view> Lines::next() {
  while (std::optional<std::string_view> line = held_or_next_line()) {
    line = is_plain_ ? trimmed(*line) : next_special(*line);
    if (line && !line->empty()) return line;
  }
  return std::nullopt;
}

// The statement that begins with `text`, a line with comments or continuations; nothing where all of it is a comment.
std::optional<std::string_view> Lines::next_special(std::string_view text) {
  // A comment goes on to its line's end, whatever stands there.
  if (trimmed(text).starts_with('#')) return std::nullopt;
  if (trimmed(text).ends_with('\\')) {
    std::string_view rest = text;
    const bool is_name = takes_a_name(take_word(rest));
    joined_.assign(text);
    for (text = trimmed(joined_); text.ends_with('\\'); text = trimmed(joined_)) {
      const std::optional<std::string_view> line = physical_line();
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
  return text;
}

void Lines::fail(const std::string& what, const std::string& expected, const std::string& found) const {
  throw Error::bad_input(file_, here() + ": " + what, expected, found);
}

double Lines::number(std::string_view word, const char* what) const {
  const std::optional<double> value = finite_number(word);
  if (!value) fail(what, "a finite number", in_quotes(word));
  return *value;
}

std::optional<double> finite_number(std::string_view word) {
  double value = 0;
  if (word.starts_with('+')) word.remove_prefix(1);
  const auto [end, code] = std::from_chars(word.data(), word.data() + word.size(), value);
  if (end != word.data() + word.size()) return std::nullopt;
  if (code == std::errc() && std::isfinite(value)) return value;
  if (code == std::errc::result_out_of_range && (word.find("e-") != word.npos || word.find("E-") != word.npos))
    return 0;
  return std::nullopt;
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

#pragma once
// A file's bytes in order, read in large pieces and handed out in small ones.

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <fstream>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "scene/files/files.h"
#include "scene/model/error.h"

namespace gleaner::scene {

class PieceReader {
 public:
  explicit PieceReader(const std::string& path)
      : path_(path), left_(file_bytes(path, path, "")), stream_(path, std::ios::binary), buffer_(kPiece) {
    if (!stream_) throw Error::bad_input(path, "", "a readable file", "another");
  }

  // Bytes that have not been handed out.
  std::uint64_t left() const { return left_; }

  // The next `count` bytes, at most a piece's; they last until the next call. Throws where the file ends before.
  const char* take(std::size_t count, const char* what) {
    if (count > left_)
      throw Error::bad_input(path_, what, std::to_string(count) + " more bytes", std::to_string(left_));
    if (end_ - begin_ < count) fill(what, count);
    const char* place = buffer_.data() + begin_;
    begin_ += count;
    left_ -= count;
    return place;
  }

  template <typename T>
  T take_value(const char* what) {
    T value;
    std::memcpy(&value, take(sizeof value, what), sizeof value);
    return value;
  }

  // Passes over a byte order mark, which a text editor may have put before the first word.
  void skip_mark() {
    if (left_ < 3) return;
    if (end_ - begin_ < 3) fill("header", 3);
    if (std::string_view(buffer_.data() + begin_, 3) == "\xef\xbb\xbf") take(3, "header");
  }

  // The next line without its end; at most a piece long. The first line decides whether lines end with LF or with CR
  // alone: what follows the last line may be binary and begin with any byte.
  std::string_view take_line(const char* what) {
    std::size_t length = 0;
    for (;;) {
      if (const auto end = end_of_line(length)) {
        length = *end;
        break;
      }
      length = end_ - begin_;
      if (length == left_) break;
      if (length > 0 && line_end_ == 0) --length;  // a CR may be the last byte
      if (length >= kPiece / 2) throw Error::bad_input(path_, what, "shorter lines", "one of a megabyte");
      fill(what, std::min<std::size_t>(length + 2, left_));
    }
    const bool has_end = length < left_;
    const char* place = take(length + has_end, what);
    std::string_view line(place, length);
    if (line.ends_with('\r')) line.remove_suffix(1);
    return line;
  }

  // The next word between white space; empty at the end.
  std::string_view take_word(const char* what) {
    const auto is_space = [](char c) { return c == ' ' || (c >= '\t' && c <= '\r'); };
    while (left_ > 0) {
      if (begin_ == end_) fill(what, 1);
      if (!is_space(buffer_[begin_])) break;
      ++begin_, --left_;
    }
    std::size_t length = 0;
    for (; length < left_; ++length) {
      if (begin_ + length == end_) {
        if (length >= kPiece / 2) throw Error::bad_input(path_, what, "shorter words", "one of a megabyte");
        fill(what, length + 1);
      }
      if (is_space(buffer_[begin_ + length])) break;
    }
    return {take(length, what), length};
  }

  // Whether nothing but blanks is left of the line, or of the file; passes over the blanks.
  bool ends_line(const char* what) {
    for (; left_ > 0; ++begin_, --left_) {
      if (begin_ == end_) fill(what, 1);
      const char c = buffer_[begin_];
      if (c == '\n' || c == '\r') return true;
      if (c != ' ' && c != '\t') return false;
    }
    return true;
  }

 private:
  static constexpr std::size_t kPiece = std::size_t(1) << 21;

  // Where the line ends that begins what is buffered, if it ends there; its first `seen` bytes hold no end.
  std::optional<std::size_t> end_of_line(std::size_t seen) {
    const std::string_view buffered(buffer_.data() + begin_, end_ - begin_);
    if (line_end_ == 0) {
      const std::size_t end = buffered.find_first_of("\r\n", seen);
      const bool is_decided = end != buffered.npos && (end + 1 < buffered.size() || buffered.size() == left_);
      if (!is_decided) return std::nullopt;
      line_end_ = buffered[end] == '\r' && buffered.substr(end + 1, 1) != "\n" ? '\r' : '\n';
    }
    const std::size_t end = buffered.find(line_end_, seen);
    return end == buffered.npos ? std::nullopt : std::optional(end);
  }

  // Makes at least `count` bytes available, of which there are that many.
  void fill(const char* what, std::size_t count) {
    std::copy(buffer_.begin() + static_cast<std::ptrdiff_t>(begin_),
              buffer_.begin() + static_cast<std::ptrdiff_t>(end_), buffer_.begin());
    end_ -= begin_;
    begin_ = 0;
    if (count > buffer_.size()) buffer_.resize(count);
    stream_.read(buffer_.data() + end_, static_cast<std::streamsize>(buffer_.size() - end_));
    end_ += static_cast<std::size_t>(stream_.gcount());
    if (end_ < count) throw Error::bad_input(path_, what, "a file that keeps its size", "a shorter one");
  }

  std::string path_;
  std::uint64_t left_;
  std::ifstream stream_;
  std::vector<char> buffer_;
  std::size_t begin_ = 0, end_ = 0;  // of what is buffered
  char line_end_ = 0;                // CR or LF; 0 before the first line
};

}  // namespace gleaner::scene

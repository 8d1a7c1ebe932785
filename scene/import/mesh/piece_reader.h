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

#include "scene/import/files.h"
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

  // The next line without its end (LF, or CR and LF); at most a piece long.
  std::string_view take_line(const char* what) {
    std::size_t length = 0;
    for (;;) {
      const char* from = buffer_.data() + begin_;
      if (const void* end = std::memchr(from + length, '\n', end_ - begin_ - length)) {
        length = static_cast<std::size_t>(static_cast<const char*>(end) - from);
        break;
      }
      length = end_ - begin_;
      if (length == left_) break;
      if (length >= kPiece / 2) throw Error::bad_input(path_, what, "shorter lines", "one of a megabyte");
      fill(what, length + 1);
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

 private:
  static constexpr std::size_t kPiece = std::size_t(1) << 21;

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
};

}  // namespace gleaner::scene

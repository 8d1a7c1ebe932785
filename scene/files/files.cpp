#include "scene/files/files.h"

#include <algorithm>
#include <array>
#include <cctype>
#include <fstream>
#include <system_error>

#include "scene/files/text.h"
#include "scene/model/error.h"

namespace gleaner::scene {
namespace fs = std::filesystem;
namespace {

int hex_digit(char c) {
  if (c >= '0' && c <= '9') return c - '0';
  if (c >= 'a' && c <= 'f') return c - 'a' + 10;
  if (c >= 'A' && c <= 'F') return c - 'A' + 10;
  return -1;
}

std::vector<std::byte> base64_decoded(std::string_view text, const std::string& file, const std::string& element) {
  static constexpr int invalid = -1;
  static const std::array<int, 256> digits = [] {
    std::array<int, 256> table;
    table.fill(invalid);
    const std::string_view alphabet = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    for (std::size_t i = 0; i < alphabet.size(); ++i) table[static_cast<unsigned char>(alphabet[i])] = int(i);
    return table;
  }();
  std::size_t length = text.size();
  while (length > 0 && text[length - 1] == '=') --length;
  if (text.size() - length > 2 || length % 4 == 1)
    throw Error::bad_input(file, element, "base64 in groups of four characters", std::to_string(text.size()));
  std::vector<std::byte> bytes;
  bytes.reserve(length / 4 * 3 + 2);
  std::uint32_t bits = 0;
  int pending = 0;
  for (std::size_t i = 0; i < length; ++i) {
    const int digit = digits[static_cast<unsigned char>(text[i])];
    if (digit == invalid)
      throw Error::bad_input(
          file, element, "base64",
          "byte " + std::to_string(static_cast<unsigned char>(text[i])) + " at character " + std::to_string(i));
    bits = bits << 6 | static_cast<std::uint32_t>(digit);
    pending += 6;
    if (pending >= 8) {
      pending -= 8;
      bytes.push_back(static_cast<std::byte>(bits >> pending & 0xff));
    }
  }
  return bytes;
}

}  // namespace

std::uint64_t file_bytes(const fs::path& path, const std::string& file, const std::string& element) {
  const bool is_itself = path == fs::path(file);
  const auto fail = [&](const std::string& found) {
    throw Error::bad_input(file, element, is_itself ? "a readable file" : "the file " + in_quotes(path.string()),
                           found);
  };
  std::error_code code;
  const fs::file_status status = fs::status(path, code);
  if (!fs::exists(status)) fail(status.type() == fs::file_type::not_found ? "none" : code.message());
  if (fs::is_directory(status)) fail("a folder");
  if (!fs::is_regular_file(status)) fail("something that is not a regular file");
  const std::uint64_t bytes = fs::file_size(path, code);
  if (code) fail(code.message());
  if (bytes == 0) fail("0 bytes");
  if (bytes > kMaxFileBytes)
    throw Error::bad_input(file, element, "at most " + std::to_string(kMaxFileBytes) + " bytes", std::to_string(bytes));
  return bytes;
}

std::vector<std::byte> read_file(const fs::path& path, std::uint64_t count, const std::string& file,
                                 const std::string& element) {
  std::ifstream stream(path, std::ios::binary);
  if (!stream) throw Error::bad_input(file, element, "a readable file", in_quotes(path.string()));
  std::vector<std::byte> bytes(count);
  stream.read(reinterpret_cast<char*>(bytes.data()), static_cast<std::streamsize>(count));
  if (static_cast<std::uint64_t>(stream.gcount()) != count)
    throw Error::bad_input(file, element, std::to_string(count) + " bytes", std::to_string(stream.gcount()));
  return bytes;
}

fs::path resolve_inside(const std::string& reference, const std::string& file, const std::string& element) {
  const std::string expected = "a path inside the scene's folder";
  const fs::path relative(reference);
  if (reference.empty() || relative.is_absolute())
    throw Error::bad_input(file, element, expected, in_quotes(reference));
  std::error_code code;
  const fs::path parent = fs::path(file).parent_path();
  const fs::path folder = fs::canonical(parent.empty() ? fs::path(".") : parent, code);
  if (code) throw Error::bad_input(file, element, "a readable folder", code.message());
  const fs::path target = fs::weakly_canonical(folder / relative, code);
  if (code) throw Error::bad_input(file, element, "the file " + in_quotes(reference), code.message());
  const fs::path inside = target.lexically_relative(folder);
  if (inside.empty() || *inside.begin() == ".." || inside == ".")
    throw Error::bad_input(file, element, expected, in_quotes(reference));
  return target;
}

namespace {

bool is_same_but_for_case(const std::string& a, const std::string& b) {
  return std::equal(a.begin(), a.end(), b.begin(), b.end(),
                    [](unsigned char x, unsigned char y) { return std::tolower(x) == std::tolower(y); });
}

// The file or folder in `folder` whose name differs from `name` in the case of its letters alone; the first in the
// order of bytes. Empty where there is none.
fs::path in_another_case(const fs::path& folder, const std::string& name) {
  fs::path found;
  std::error_code code;
  for (fs::directory_iterator entry(folder, code), end; !code && entry != end; entry.increment(code)) {
    const fs::path& path = entry->path();
    if (is_same_but_for_case(path.filename().string(), name) && (found.empty() || path < found)) found = path;
  }
  return found;
}

// `relative` under `folder`, each part in whatever case it has there. Empty where there is none.
fs::path found_in_any_case(const fs::path& folder, const fs::path& relative) {
  fs::path place = folder;
  std::error_code code;
  for (const fs::path& part : relative) {
    if (part == "." || part == "..") {
      place /= part;
      continue;
    }
    fs::path next = place / part;
    if (!fs::exists(next, code)) next = in_another_case(place, part.string());
    if (next.empty()) return {};
    place = next;
  }
  return place;
}

}  // namespace

fs::path resolve_reference(const std::string& reference, const std::string& file, const std::string& element,
                           Warnings* warnings) {
  std::error_code code;
  const fs::path folder = fs::path(file).parent_path().empty() ? fs::path(".") : fs::path(file).parent_path();
  const bool is_plain = !reference.empty() && !fs::path(reference).is_absolute();
  if (is_plain && fs::exists(folder / reference, code)) return resolve_inside(reference, file, element);
  std::string slashed = reference;
  std::replace(slashed.begin(), slashed.end(), '\\', '/');
  if (slashed.empty() || fs::path(slashed).is_absolute()) return resolve_inside(slashed, file, element);
  const fs::path found = found_in_any_case(folder, slashed);
  if (found.empty()) return resolve_inside(slashed, file, element);
  const fs::path inside = resolve_inside(found.lexically_relative(folder).string(), file, element);
  if (warnings) warnings->add(element, "found under another spelling: backslashes, or letters in another case");
  return inside;
}

std::string percent_decoded(std::string_view uri, const std::string& file, const std::string& element) {
  std::string text;
  text.reserve(uri.size());
  for (std::size_t i = 0; i < uri.size(); ++i) {
    char c = uri[i];
    if (c == '%') {
      const int high = i + 2 < uri.size() ? hex_digit(uri[i + 1]) : -1;
      const int low = i + 2 < uri.size() ? hex_digit(uri[i + 2]) : -1;
      // A name that nobody encoded may hold a per cent sign.
      if (high >= 0 && low >= 0) {
        c = static_cast<char>(high * 16 + low);
        i += 2;
      }
    }
    if (c == 0) throw Error::bad_input(file, element, "a URI without zero bytes", in_quotes(uri));
    text += c;
  }
  return text;
}

std::vector<std::byte> data_uri_bytes(std::string_view uri, const std::string& file, const std::string& element) {
  const std::size_t comma = uri.find(',');
  if (comma == std::string_view::npos)
    throw Error::bad_input(file, element, "a comma before the data of a data URI", in_quotes(uri));
  if (!lower_case(uri.substr(0, comma)).ends_with(";base64"))
    throw Error::bad_input(file, element, "a data URI in base64", in_quotes(uri.substr(0, comma)));
  const std::string_view digits = uri.substr(comma + 1);
  const auto is_blank = [](char c) { return c == ' ' || c == '\t' || c == '\n' || c == '\r'; };
  if (std::none_of(digits.begin(), digits.end(), is_blank)) return base64_decoded(digits, file, element);
  std::string joined(digits);  // some break base64 into lines
  std::erase_if(joined, is_blank);
  return base64_decoded(joined, file, element);
}

}  // namespace gleaner::scene

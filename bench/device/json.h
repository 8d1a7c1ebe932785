#pragma once
// Just enough JSON to write: the device library stands alone, and so does what is built on it.

#include <cmath>
#include <cstdint>
#include <cstdio>
#include <string>
#include <vector>

namespace gleaner::bench {

class Json {
 public:
  Json& begin(char bracket) { return value(std::string(1, bracket)).open(bracket); }
  Json& begin(const std::string& name, char bracket) { return key(name).begin(bracket); }
  Json& end() {
    const char bracket = open_.back();
    open_.pop_back();
    text_ += "\n" + std::string(2 * open_.size(), ' ') + (bracket == '{' ? "}" : "]");
    first_ = false;
    return *this;
  }
  Json& add(const std::string& name, const std::string& text) { return key(name).value(quoted(text)); }
  Json& add(const std::string& name, const char* text) { return add(name, std::string(text)); }
  Json& add(const std::string& name, double number) {
    char digits[32];
    std::snprintf(digits, sizeof digits, "%.6g", number);
    return key(name).value(std::isfinite(number) ? digits : "null");
  }
  Json& add(const std::string& name, std::uint64_t number) { return key(name).value(std::to_string(number)); }
  Json& add(const std::string& name, unsigned number) { return add(name, std::uint64_t{number}); }
  Json& add(const std::string& name, bool yes) { return key(name).value(yes ? "true" : "false"); }
  const std::string& text() const { return text_; }

 private:
  static std::string quoted(const std::string& text) {
    std::string out = "\"";
    for (const char c : text) {
      if (c == '"' || c == '\\') out += '\\';
      if (static_cast<unsigned char>(c) >= 0x20) out += c;
    }
    return out + "\"";
  }
  Json& open(char bracket) {
    open_.push_back(bracket);
    first_ = true;
    return *this;
  }
  Json& key(const std::string& name) {
    separate();
    text_ += quoted(name) + ": ";
    keyed_ = true;
    return *this;
  }
  Json& value(const std::string& text) {
    if (!keyed_) separate();
    keyed_ = first_ = false;
    text_ += text;
    return *this;
  }
  void separate() {
    if (!open_.empty()) text_ += (first_ ? "\n" : ",\n") + std::string(2 * open_.size(), ' ');
    first_ = false;
  }

  std::string text_;
  std::vector<char> open_;
  bool first_ = true, keyed_ = false;
};

}  // namespace gleaner::bench

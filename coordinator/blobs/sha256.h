#pragma once
// SHA-256, the name that bytes go by.

#include <cstddef>
#include <memory>
#include <span>
#include <string>
#include <string_view>

namespace gleaner::coordinator {

class Sha256 {
 public:
  Sha256();
  ~Sha256();
  void update(std::span<const std::byte> bytes);
  std::string hex();  // 64 lower-case digits; the last call

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

std::string sha256_hex(std::span<const std::byte> bytes);
bool is_sha256_hex(std::string_view id);

}  // namespace gleaner::coordinator

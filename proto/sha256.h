#pragma once
// SHA-256 and what the wire's two ends make of it.

#include <cstddef>
#include <memory>
#include <span>
#include <string>
#include <string_view>

namespace gleaner {

class Sha256 {
 public:
  Sha256();
  ~Sha256();
  void update(std::span<const std::byte> bytes);
  // Both end the sum; what is added afterwards begins another one.
  std::string raw();  // 32 bytes
  std::string hex();  // 64 lower-case digits

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

std::string to_hex(std::string_view bytes);  // lower case
std::string sha256_hex(std::span<const std::byte> bytes);
bool is_sha256_hex(std::string_view id);

// Opens an artifact's parts at the worker whose token it is (worker.proto): HMAC-SHA-256 of the artifact's id, 64
// lower-case hexadecimal digits.
std::string artifact_ticket(const std::string& token, const std::string& artifact);
// Takes the same time wherever the two differ.
bool same_secret(std::string_view a, std::string_view b);
// 32 hexadecimal digits that nobody can guess.
std::string new_token();

}  // namespace gleaner

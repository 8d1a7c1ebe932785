#pragma once
// Tokens: what people may show instead of a certificate. JSON Web Tokens (RFC 7519), signed by the farm's authority
// (ES256), with the claims sub (name), jti (serial number), exp and roles.

#include <chrono>
#include <map>
#include <mutex>
#include <optional>
#include <string>
#include <string_view>

#include "proto/role.h"

namespace gleaner {

// Throws Error::failed where it cannot be signed with `authority_key` (PEM).
std::string sign_token(const Peer& holder, std::chrono::system_clock::time_point good_until,
                       const std::string& authority_key);

// Reads tokens by one authority. Thread-safe.
class TokenReader {
 public:
  // Throws Error::failed where `authority` (PEM) is no certificate.
  explicit TokenReader(const std::string& authority);

  // Nothing for what is no token of this authority, has expired, or names a role that is not for people (work and
  // coordinate: these need keys to answer with).
  std::optional<Peer> read(std::string_view token);

 private:
  struct Known {
    Peer peer;
    std::chrono::system_clock::time_point good_until;
  };
  std::optional<Known> verify(const std::string& token) const;

  std::string public_key_;  // PEM
  std::mutex mutex_;
  std::map<std::string, Known, std::less<>> known_;  // verified before: a signature takes a tenth of a millisecond
};

}  // namespace gleaner

#include "proto/token.h"

#include <jwt.h>

#include <cerrno>
#include <cstdlib>
#include <memory>
#include <nlohmann/json.hpp>

#include "proto/openssl_handles.h"
#include "scene/model/error.h"
#include "scene/model/names.h"

namespace gleaner {

using Clock = std::chrono::system_clock;
using openssl::Held;

namespace {

constexpr std::size_t most_token_bytes = 4096, most_known = 1024;

struct ReleaseToken {
  void operator()(jwt_t* token) const { jwt_free(token); }
};
using HeldToken = std::unique_ptr<jwt_t, ReleaseToken>;

struct ReleaseText {
  void operator()(char* text) const { std::free(text); }
};

void check(int status, const char* what) {
  if (status != 0) throw Error::failed(std::string("libjwt: ") + what + " failed");
}

const unsigned char* bytes_of(const std::string& text) { return reinterpret_cast<const unsigned char*>(text.c_str()); }

bool for_people(Role role) { return role != Role::work && role != Role::coordinate; }

}  // namespace

std::string sign_token(const Peer& holder, Clock::time_point good_until, const std::string& authority_key) {
  nlohmann::json roles = nlohmann::json::array();
  for (const Role role : holder.roles) roles.push_back(role_name(role));
  const nlohmann::json claims = {
      {"sub", holder.name}, {"jti", holder.serial}, {"exp", Clock::to_time_t(good_until)}, {"roles", std::move(roles)}};
  jwt_t* made = nullptr;
  check(jwt_new(&made), "making a token");
  const HeldToken token(made);
  check(jwt_add_grants_json(made, claims.dump().c_str()), "filling in a token");
  check(jwt_set_alg(made, JWT_ALG_ES256, bytes_of(authority_key), static_cast<int>(authority_key.size())),
        "choosing a signature");
  const std::unique_ptr<char, ReleaseText> text(jwt_encode_str(made));
  check(text ? 0 : errno, "signing");
  return text.get();
}

TokenReader::TokenReader(const std::string& authority)
    : public_key_([&] {
        const Held<X509> certificate = openssl::parse_certificate(authority);
        if (!certificate) throw Error::failed("tokens: expected the authority's certificate (PEM)");
        return openssl::pem_of(
            [&](BIO* bio) { return PEM_write_bio_PUBKEY(bio, X509_get0_pubkey(certificate.get())); });
      }()) {}

std::optional<TokenReader::Known> TokenReader::verify(const std::string& text) const {
  jwt_t* decoded = nullptr;
  if (jwt_decode(&decoded, text.c_str(), bytes_of(public_key_), static_cast<int>(public_key_.size())) != 0)
    return std::nullopt;
  const HeldToken token(decoded);
  // The library takes the algorithm that the token names, and the public key is no secret to sign with (HS256).
  if (jwt_get_alg(decoded) != JWT_ALG_ES256) return std::nullopt;
  const std::unique_ptr<char, ReleaseText> grants(jwt_get_grants_json(decoded, nullptr));
  if (!grants) return std::nullopt;
  const nlohmann::json claims = nlohmann::json::parse(grants.get(), nullptr, false);
  try {
    Known known{.peer = {.name = printable(claims.at("sub").get<std::string>()),
                         .serial = claims.at("jti").get<std::string>(),
                         .roles = {}},
                .good_until = Clock::from_time_t(claims.at("exp").get<std::time_t>())};
    for (const nlohmann::json& word : claims.at("roles")) {
      const Role role = parse_role(word.get<std::string>());
      if (!for_people(role)) return std::nullopt;
      known.peer.roles.insert(role);
    }
    known.peer.roles = with_included(std::move(known.peer.roles));
    return known;
  } catch (const nlohmann::json::exception&) {  // signed by this authority, for something else
    return std::nullopt;
  } catch (const Error&) {  // a role of another version
    return std::nullopt;
  }
}

std::optional<Peer> TokenReader::read(std::string_view token) {
  if (token.size() > most_token_bytes) return std::nullopt;
  const auto good = [](const Known& known) { return Clock::now() < known.good_until; };
  {
    std::lock_guard lock(mutex_);
    if (const auto at = known_.find(token); at != known_.end())
      return good(at->second) ? std::optional(at->second.peer) : std::nullopt;
  }
  std::optional<Known> known = verify(std::string(token));
  if (!known || !good(*known)) return std::nullopt;
  std::lock_guard lock(mutex_);
  if (known_.size() >= most_known) known_.clear();
  known_.insert_or_assign(std::string(token), *known);
  return known->peer;
}

}  // namespace gleaner

#pragma once
// Who is who on a farm: keys of an authority of the farm's own, TLS with certificates on both sides, or with a token on
// a person's, and what their holder may do. `gleaner keys` (proto/authority.h) makes them.

#include <grpcpp/security/auth_context.h>
#include <grpcpp/security/credentials.h>
#include <grpcpp/security/server_credentials.h>
#include <grpcpp/support/channel_arguments.h>

#include <filesystem>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <set>
#include <string>
#include <string_view>

#include "proto/role.h"
#include "proto/token.h"

namespace gleaner {

// Files of a folder of keys, PEM.
inline constexpr const char* authority_file = "authority.crt";  // whose certificates count
inline constexpr const char* certificate_file = "own.crt";
inline constexpr const char* key_file = "own.key";
inline constexpr const char* token_file = "token";  // in the place of the two before, for people
inline constexpr const char* revoked_file =
    "revoked";  // one serial number a line, then anything; read by a coordinator

// The contents of a folder of keys: a certificate and its key, or a token.
struct Keys {
  std::filesystem::path folder;
  std::string authority, certificate, key, token;
};

// Throws Error::bad_input, which names the file, where one is missing, is no certificate or key, does not fit the
// others or has expired.
Keys load_keys(const std::filesystem::path& folder);
// This program's: of the folder that $GLEANER_KEYS names; null where it names none.
std::shared_ptr<const Keys> own_keys();

// Who calls: the holder of the connection's certificate, or else of the call's token.
class Identities {
 public:
  explicit Identities(const Keys& keys) : tokens_(keys.authority) {}
  using Metadata = std::multimap<grpc::string_ref, grpc::string_ref>;
  // Nothing where it shows neither. A token belongs to its call: others on the same connection may have other ones.
  std::optional<Peer> of(const grpc::AuthContext& context, const Metadata& metadata);

 private:
  TokenReader tokens_;
};

// The serial numbers of a folder's revoked certificates. The list is read again when it changes.
class Revocations {
 public:
  explicit Revocations(const Keys& keys) : file_(keys.folder / revoked_file) {}
  bool contains(const std::string& serial);

 private:
  const std::filesystem::path file_;
  std::mutex mutex_;
  std::filesystem::file_time_type read_at_{};
  std::set<std::string> serials_;
};

// The role that a method ("/gleaner.v1.Farm/ListJobs") asks of its caller.
using MethodRule = std::function<Role(std::string_view method)>;

enum class Admits { certificates, tokens_too };

// Null keys: in the clear, and everybody may do everything. Else a call is refused with UNAUTHENTICATED where its
// caller shows nothing that counts or what was revoked (the list is read again when it changes), with PERMISSION_DENIED
// where that allows something else. Throws Error::usage where the keys are a token.
std::shared_ptr<grpc::ServerCredentials> server_credentials(std::shared_ptr<const Keys> keys, MethodRule rule,
                                                            Admits admits);
// For a peer that has role `expected`; sets the arguments that go with it.
std::shared_ptr<grpc::ChannelCredentials> channel_credentials(const Keys* keys, Role expected,
                                                              grpc::ChannelArguments& arguments);
// Throws Error::usage where they are a token: `who` ("a worker") needs keys that it can answer with.
void require_certificate(const Keys& keys, const std::string& who);

}  // namespace gleaner

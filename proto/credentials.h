#pragma once
// Who is who on a farm: keys of an authority of the farm's own, TLS with certificates on both sides, and what each
// certificate's holder may do. `gleaner keys` (cli/authority.h) makes them.

#include <grpcpp/security/auth_context.h>
#include <grpcpp/security/credentials.h>
#include <grpcpp/security/server_credentials.h>
#include <grpcpp/support/channel_arguments.h>

#include <filesystem>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <set>
#include <string>
#include <string_view>

namespace gleaner {

// What a certificate allows. A role is written into it as the DNS name "ROLE.gleaner", so that TLS itself sees to it
// that who answers as a coordinator or a worker is one, at whatever address.
enum class Role { coordinate, work, observe, submit, administer };
inline constexpr Role every_role[] = {Role::coordinate, Role::work, Role::observe, Role::submit, Role::administer};
const char* role_name(Role role);
// Throws Error::usage for a word that is no role.
Role parse_role(const std::string& word);
std::string role_dns_name(Role role);

// Files of a folder of keys, PEM.
inline constexpr const char* authority_file = "authority.crt";  // whose certificates count
inline constexpr const char* certificate_file = "own.crt";
inline constexpr const char* key_file = "own.key";
inline constexpr const char* revoked_file =
    "revoked";  // one serial number a line, then anything; read by a coordinator

// The contents of a folder of keys.
struct Keys {
  std::filesystem::path folder;
  std::string authority, certificate, key;
};

// Throws Error::bad_input, which names the file, where one is missing, is no certificate or key, does not fit the
// others or has expired.
Keys load_keys(const std::filesystem::path& folder);
// This program's: of the folder that $GLEANER_KEYS names; null where it names none.
std::shared_ptr<const Keys> own_keys();

// Who is at the other end of a connection, as its certificate says.
struct Peer {
  std::string name;    // the certificate's common name
  std::string serial;  // hexadecimal
  std::set<Role> roles;
};
// Nothing where the connection has no certificate.
std::optional<Peer> peer_of(const grpc::AuthContext& context);

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

// Null keys: in the clear, and everybody may do everything. Else a call is refused with UNAUTHENTICATED where its
// caller's certificate was revoked (the list is read again when it changes), with PERMISSION_DENIED where it allows
// something else. Who may administer may submit, who may submit or coordinate
// may observe.
std::shared_ptr<grpc::ServerCredentials> server_credentials(std::shared_ptr<const Keys> keys, MethodRule rule);
// For a peer that has role `expected`; sets the arguments that go with it.
std::shared_ptr<grpc::ChannelCredentials> channel_credentials(const Keys* keys, Role expected,
                                                              grpc::ChannelArguments& arguments);

}  // namespace gleaner

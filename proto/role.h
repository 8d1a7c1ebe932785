#pragma once
// What the holder of a certificate or a token may do on a farm, and who that is.

#include <set>
#include <string>

namespace gleaner {

// A role is written into a certificate as the DNS name "ROLE.gleaner", so that TLS itself sees to it that who answers
// as a coordinator or a worker is one, at whatever address.
enum class Role { coordinate, work, observe, submit, administer };
inline constexpr Role every_role[] = {Role::coordinate, Role::work, Role::observe, Role::submit, Role::administer};
const char* role_name(Role role);
// Throws Error::usage for a word that is no role.
Role parse_role(const std::string& word);
std::string role_dns_name(Role role);
// "submit,observe"
std::string role_words(const std::set<Role>& roles);

// Who is at the other end of a connection, as its certificate or its token says.
struct Peer {
  std::string name;    // the certificate's common name, the token's subject
  std::string serial;  // hexadecimal
  std::set<Role> roles;
};

// With what the roles include: who may administer may submit, who may submit or coordinate may observe.
std::set<Role> with_included(std::set<Role> roles);

}  // namespace gleaner

#include "proto/role.h"

#include "scene/model/error.h"

namespace gleaner {

const char* role_name(Role role) {
  switch (role) {
    case Role::coordinate:
      return "coordinate";
    case Role::work:
      return "work";
    case Role::observe:
      return "observe";
    case Role::submit:
      return "submit";
    case Role::administer:
      return "administer";
  }
  return "";
}

Role parse_role(const std::string& word) {
  for (const Role role : every_role)
    if (word == role_name(role)) return role;
  throw Error::usage("--role: expected coordinate, work, observe, submit or administer, found \"" + word + "\"");
}

std::string role_dns_name(Role role) { return std::string(role_name(role)) + ".gleaner"; }

std::string role_words(const std::set<Role>& roles) {
  std::string words;
  for (const Role role : roles) words.append(words.empty() ? "" : ",").append(role_name(role));
  return words;
}

std::set<Role> with_included(std::set<Role> roles) {
  if (roles.contains(Role::administer)) roles.insert(Role::submit);
  if (roles.contains(Role::coordinate)) roles.insert(Role::observe);  // itself: --check
  if (roles.contains(Role::submit)) roles.insert(Role::observe);
  return roles;
}

}  // namespace gleaner

#pragma once
// A farm's own authority: a folder with its key, what it issued and what it revoked, and the folders of keys that it
// made (proto/credentials.h). ECDSA over P-256 and SHA-256.

#include <filesystem>
#include <set>
#include <string>
#include <vector>

#include "proto/credentials.h"
#include "proto/role.h"

namespace gleaner {

class Authority {
 public:
  struct Issued {
    std::string serial, name;
    std::set<Role> roles;
    std::string good_until;  // YYYY-MM-DD
    bool token = false;      // else a certificate
    bool revoked = false;
  };

  // Makes one in `folder`, which must be empty or not there, and its coordinator's keys in FOLDER/coordinator. Throws
  // Error::usage where something is in the way, Error::failed where a file cannot be written.
  static Authority init(const std::filesystem::path& folder, int days);
  // Throws Error::bad_input where `folder` is none.
  explicit Authority(std::filesystem::path folder);

  // Makes a folder of keys at `to`, which must not be there. Throws Error::usage for a bad name, no role, or an
  // authority that ends before the certificate would.
  void issue(const std::string& name, const std::set<Role>& roles, int days, const std::filesystem::path& to) const;
  // The same with a token in the place of a certificate: for people, so that roles to work and to coordinate are
  // refused.
  void issue_token(const std::string& name, const std::set<Role>& roles, int days,
                   const std::filesystem::path& to) const;
  // Every certificate and token of that name. Coordinators that use FOLDER/coordinator refuse them from now on. Returns
  // how many were revoked; throws Error::usage where none is good.
  int revoke(const std::string& name) const;
  std::vector<Issued> issued() const;

  std::filesystem::path revoked_list() const { return folder_ / "coordinator" / revoked_file; }

 private:
  struct Issuer;
  Issuer issuer() const;
  void record(const Issued& one) const;

  std::filesystem::path folder_;
};

}  // namespace gleaner

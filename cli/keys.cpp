// `gleaner keys`: a farm's own authority, and the certificates and tokens by which its parts and its people know each
// other.

#include <CLI/CLI.hpp>
#include <cstdio>
#include <iostream>
#include <memory>

#include "cli/commands.h"
#include "proto/authority.h"

namespace gleaner::cli {

namespace {

struct KeysOptions {
  std::string folder, name, to;
  std::vector<std::string> roles;
  int days = 365, authority_days = 3650;
  bool token = false;
};

int init(const KeysOptions& options) {
  Authority::init(options.folder, options.authority_days);
  std::cout << options.folder << ": the authority's key; keep it where nobody else comes\n"
            << options.folder << "/coordinator: for gleaner-coordinator --keys\n";
  return 0;
}

int issue(const KeysOptions& options) {
  std::set<Role> roles;
  for (const std::string& word : options.roles) roles.insert(parse_role(word));
  const std::string to = options.to.empty() ? options.folder + "/" + options.name : options.to;
  const Authority authority(options.folder);
  if (options.token)
    authority.issue_token(options.name, roles, options.days, to);
  else
    authority.issue(options.name, roles, options.days, to);
  std::cout << to << "\n";
  return 0;
}

int revoke(const KeysOptions& options) {
  const Authority authority(options.folder);
  const int revoked = authority.revoke(options.name);
  std::cout << revoked << " revoked; " << authority.revoked_list().string()
            << " belongs into the keys of every coordinator\n";
  return 0;
}

int list(const KeysOptions& options) {
  for (const Authority::Issued& one : Authority(options.folder).issued()) {
    std::printf("%-24s %-24s %-11s until %s%s\n", one.name.c_str(), role_words(one.roles).c_str(),
                one.token ? "token" : "certificate", one.good_until.c_str(), one.revoked ? "  revoked" : "");
  }
  return 0;
}

}  // namespace

void add_keys(CLI::App& app, Run& run) {
  auto options = std::make_shared<KeysOptions>();
  CLI::App* command = app.add_subcommand("keys", "A farm's own authority, certificates and tokens");
  command->require_subcommand(1);
  const auto add = [&](const char* word, const char* help, int (*what)(const KeysOptions&)) {
    CLI::App* sub = command->add_subcommand(word, help);
    sub->add_option("FOLDER", options->folder, "of the authority")->required();
    sub->callback([options, &run, what] { run = [options, what] { return what(*options); }; });
    return sub;
  };
  const auto days = CLI::Range(1, 36500);
  add("init", "Make an authority, and the coordinator's keys", init)
      ->add_option("--days", options->authority_days, "for which it is good")
      ->capture_default_str()
      ->check(days);
  CLI::App* issuing = add("issue", "Make a folder of keys for a worker or a person", issue);
  issuing->add_option("NAME", options->name, "1 to 64 of [A-Za-z0-9._-]")->required();
  issuing
      ->add_option("--role", options->roles,
                   "work (for workers), observe, submit, administer (for people) or coordinate; may be given again")
      ->required();
  issuing->add_flag("--token", options->token, "a token in the place of a certificate: for people alone");
  issuing->add_option("-o,--output", options->to, "the folder to make (default: FOLDER/NAME)");
  issuing->add_option("--days", options->days, "for which they are good")->capture_default_str()->check(days);
  add("revoke", "Let coordinators refuse all certificates and tokens of a name", revoke)
      ->add_option("NAME", options->name, "as it was issued")
      ->required();
  add("list", "What was issued", list);
}

}  // namespace gleaner::cli

#pragma once
// A PostgreSQL server of a test's own, on a socket in a temporary folder.

#include <pwd.h>
#include <unistd.h>

#include <algorithm>

#include "tests/farm/processes.h"

namespace gleaner::test {

class PostgresServer {
 public:
  // Why there can be none here; empty: there can.
  static std::string missing() {
    if (programs().empty()) return "no PostgreSQL server in /usr/lib/postgresql (Debian's package postgresql)";
    if (::geteuid() == 0 && !::getpwnam("postgres"))
      return "PostgreSQL refuses to run as root, and there is no user postgres";
    return {};
  }

  PostgresServer() {
    const auto as = user();
    std::filesystem::permissions(folder_.path(), std::filesystem::perms::owner_all |
                                                     std::filesystem::perms::group_exec |
                                                     std::filesystem::perms::others_exec);
    const std::filesystem::path home = folder_.path() / "postgres";
    std::filesystem::create_directory(home);
    if (const passwd* owner = ::geteuid() == 0 ? ::getpwnam("postgres") : nullptr)
      if (::chown(home.c_str(), owner->pw_uid, owner->pw_gid) != 0) throw Error::failed("chown " + home.string());
    std::vector<std::string> words = as;
    for (const char* word : {"/bin/sh", "-c", "cd / && exec \"$@\"", "sh"}) words.push_back(word);
    words.push_back((programs() / "initdb").string());
    for (const std::string& word :
         {std::string("-D"), (home / "data").string(), std::string("-A"), std::string("trust"), std::string("-U"),
          std::string("gleaner"), std::string("--no-sync")})
      words.push_back(word);
    Process made(words, folder_.path() / "initdb");
    if (made.wait() != 0) throw Error::failed("initdb: " + made.err());
    start();
  }
  ~PostgresServer() { stop(SIGQUIT); }

  std::string address() const {
    return "postgresql://gleaner@/postgres?host=" + (folder_.path() / "postgres").string();
  }
  void start() {
    const std::filesystem::path home = folder_.path() / "postgres";
    // The server's own process is killed, not the one that changes the user: setpriv becomes it.
    std::vector<std::string> words = user();
    for (const std::string& word :
         {std::string("/bin/sh"), std::string("-c"), std::string("cd / && exec \"$@\""), std::string("sh"),
          (programs() / "postgres").string(), std::string("-D"), (home / "data").string(), std::string("-k"),
          home.string(), std::string("-c"), std::string("listen_addresses=")})
      words.push_back(word);
    server_ = std::make_unique<Process>(words, folder_.path() / "server");
    if (!eventually([&] { return server_->err().find("ready to accept connections") != std::string::npos; }, 60))
      throw Error::failed("PostgreSQL does not start: " + server_->err());
  }
  void stop(int signal) {
    if (!server_) return;
    server_->signal(signal);
    server_->wait();
    server_.reset();
  }

 private:
  static std::filesystem::path programs() {
    std::error_code none;
    std::vector<std::filesystem::path> found;
    for (const auto& version : std::filesystem::directory_iterator("/usr/lib/postgresql", none))
      if (std::filesystem::exists(version.path() / "bin" / "postgres")) found.push_back(version.path() / "bin");
    return found.empty() ? std::filesystem::path() : *std::max_element(found.begin(), found.end());
  }
  // What runs a program as somebody whom PostgreSQL accepts.
  static std::vector<std::string> user() {
    if (::geteuid() != 0) return {};
    return {"/usr/bin/setpriv", "--reuid=postgres", "--regid=postgres", "--clear-groups"};
  }

  TemporaryFolder folder_;
  std::unique_ptr<Process> server_;
};

}  // namespace gleaner::test

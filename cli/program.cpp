#include "cli/program.h"

#include <google/protobuf/stubs/logging.h>

#include <CLI/CLI.hpp>
#include <csignal>
#include <cstdlib>
#include <iostream>
#include <new>

#include "scene/model/error.h"
#include "scene/model/names.h"

namespace gleaner::cli {

void add_keys_option(CLI::App& command) {
  command.add_option_function<std::string>(
      "--keys", [](const std::string& folder) { ::setenv("GLEANER_KEYS", folder.c_str(), 1); },
      "folder of this caller's keys, made by `gleaner keys` (default: $GLEANER_KEYS)");
}

int run_program(CLI::App& app, int argc, char** argv, const std::function<int()>& run) {
  // A file beyond the limit of its size (ulimit -f) is then an error of write(), as a full disk is, and not the end.
  std::signal(SIGXFSZ, SIG_IGN);
  const std::string error_words = app.get_name() + ": error: ";
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    if (error.get_exit_code() == 0) return app.exit(error);  // --help, --version
    std::cerr << error_words << printable_lines(error.what()) << "\n";
    const CLI::App* asked = &app;
    for (const auto& sub : app.get_subcommands()) asked = sub;
    std::cerr << "usage: " << app.get_name() << (asked == &app ? "" : " " + asked->get_name())
              << " --help tells the options\n";
    return static_cast<int>(ErrorKind::usage);
  }
  try {
    return run();
  } catch (const Error& error) {
    std::cerr << error_words << printable_lines(error.what()) << "\n";
    return static_cast<int>(error.kind());
  } catch (const std::bad_alloc&) {
    std::cerr << error_words << "out of memory\n";
  } catch (const std::exception& error) {
    std::cerr << error_words << printable_lines(error.what()) << "\n";
  }
  return static_cast<int>(ErrorKind::failed);
}

void silence_grpc() {
  ::setenv("GRPC_VERBOSITY", "NONE", 0);
  // protobuf would print a line for every malformed message that a hostile peer sends.
  google::protobuf::SetLogHandler(nullptr);
}

}  // namespace gleaner::cli

// `gleaner`: the command that people type.

#include <CLI/CLI.hpp>

#include "cli/commands.h"
#include "cli/kernel_compiler.h"
#include "cli/present_commands.h"
#include "cli/program.h"
#include "gleaner/version.h"

int main(int argc, char** argv) {
  if (gleaner::cli::served_as_kernel_compiler(argc, argv)) return 0;
  gleaner::cli::silence_grpc();
  CLI::App app{"Gleaner: a render farm that splits one frame", "gleaner"};
  app.require_subcommand(1);
  app.set_version_flag("--version", std::string("gleaner ") + gleaner::version);
  gleaner::cli::Run run;
#define GLEANER_ADD(command) gleaner::cli::add_##command(app, run);
  GLEANER_COMMANDS(GLEANER_ADD)
#undef GLEANER_ADD
  return gleaner::cli::run_program(app, argc, argv, [&] { return run(); });
}

#include "coordinator/plan/methods.h"

#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <memory>

#include "cli/commands.h"

namespace gleaner::cli {
namespace {

int methods(bool markdown) {
  if (markdown) {
    fmt::print("{}", coordinator::settings_page());
    return 0;
  }
  for (const coordinator::Method& method : coordinator::methods()) fmt::print("{:8} {}\n", method.name, method.help);
  fmt::print("\n{}\n", coordinator::settings_help());
  return 0;
}

}  // namespace

void add_methods(CLI::App& app, Run& run) {
  auto* command = app.add_subcommand("methods", "methods that render frames, and their settings");
  auto markdown = std::make_shared<bool>(false);
  command->add_flag("--markdown", *markdown, "as docs/reference/settings.md");
  command->callback([markdown, &run] { run = [markdown] { return methods(*markdown); }; });
}

}  // namespace gleaner::cli

// `gleaner why`: why batches of a job wait.

#include <CLI/CLI.hpp>
#include <iostream>
#include <memory>

#include "cli/client.h"
#include "cli/commands.h"

namespace gleaner::cli {

namespace {

struct WhyOptions {
  std::string coordinator, job;
};

int why(const WhyOptions& options) {
  for (const std::string& reason : Client(options.coordinator).why(options.job)) std::cout << reason << "\n";
  return 0;
}

}  // namespace

void add_why(CLI::App& app, Run& run) {
  auto options = std::make_shared<WhyOptions>();
  CLI::App* command = app.add_subcommand("why", "Say why a job's batches wait; silence where all run");
  command->add_option("JOB", options->job, "as submit printed it")->required();
  add_coordinator_option(*command, options->coordinator);
  command->callback([options, &run] { run = [options] { return why(*options); }; });
}

}  // namespace gleaner::cli

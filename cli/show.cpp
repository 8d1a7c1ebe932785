// `gleaner show`: one job as it stands.

#include <CLI/CLI.hpp>
#include <iostream>
#include <memory>

#include "cli/client.h"
#include "cli/commands.h"
#include "cli/progress.h"
#include "cli/status_words.h"
#include "coordinator/gateway/status_json.h"

namespace gleaner::cli {

namespace {

struct ShowOptions {
  std::string coordinator, job;
  bool json = false;
};

int show(const ShowOptions& options) {
  coordinator::JobStatus status = Client(options.coordinator).show(options.job);
  if (options.json) {
    std::cout << gateway::dump(gateway::job_json(status)) << "\n";
    return 0;
  }
  std::cout << job_line(status) << "\n";
  for (const auto& stage : status.stages) {
    std::cout << "  stage " << stage.name << " (" << stage.kind << "): " << stage.items_done << " of " << stage.items
              << " items";
    if (stage.items_per_second > 0) std::cout << ", " << format_rate(stage.items_per_second);
    if (stage.seconds_left > 0) std::cout << ", " << format_duration(stage.seconds_left) << " left";
    std::cout << "\n";
  }
  return 0;
}

}  // namespace

void add_show(CLI::App& app, Run& run) {
  auto options = std::make_shared<ShowOptions>();
  CLI::App* command = app.add_subcommand("show", "Show a job and its stages");
  command->add_option("JOB", options->job, "as submit printed it")->required();
  command->add_flag("--json", options->json, "as JSON");
  add_coordinator_option(*command, options->coordinator);
  command->callback([options, &run] { run = [options] { return show(*options); }; });
}

}  // namespace gleaner::cli

// `gleaner list`: all jobs, oldest first.

#include <CLI/CLI.hpp>
#include <iostream>
#include <memory>

#include "cli/client.h"
#include "cli/commands.h"
#include "cli/status_words.h"
#include "coordinator/gateway/status_json.h"

namespace gleaner::cli {

namespace {

struct ListOptions {
  std::string coordinator;
  bool json = false, csv = false;
};

int list(const ListOptions& options) {
  auto jobs = Client(options.coordinator).list();
  if (options.json) {
    nlohmann::json all = nlohmann::json::array();
    for (const auto& status : jobs) all.push_back(gateway::job_json(status));
    std::cout << gateway::dump(all) << "\n";
  } else if (options.csv) {
    std::cout << job_csv(jobs);
  } else {
    for (const auto& status : jobs) std::cout << job_line(status) << "\n";
  }
  return 0;
}

}  // namespace

void add_list(CLI::App& app, Run& run) {
  auto options = std::make_shared<ListOptions>();
  CLI::App* command = app.add_subcommand("list", "List the jobs");
  CLI::Option* json = command->add_flag("--json", options->json, "as JSON");
  command->add_flag("--csv", options->csv, "as CSV: what each job took, for accounting")->excludes(json);
  add_coordinator_option(*command, options->coordinator);
  command->callback([options, &run] { run = [options] { return list(*options); }; });
}

}  // namespace gleaner::cli

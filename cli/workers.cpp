// `gleaner workers`: who is connected, with what, and how fast.

#include <CLI/CLI.hpp>
#include <iostream>
#include <memory>

#include "cli/client.h"
#include "cli/commands.h"
#include "cli/progress.h"
#include "coordinator/gateway/status_json.h"

namespace gleaner::cli {

namespace {

struct WorkersOptions {
  std::string coordinator;
  bool json = false;
};

int workers(const WorkersOptions& options) {
  auto all = Client(options.coordinator).workers();
  if (options.json) {
    nlohmann::json out = nlohmann::json::array();
    for (const auto& status : all) out.push_back(gateway::worker_json(status));
    std::cout << gateway::dump(out) << "\n";
    return 0;
  }
  for (const auto& status : all) {
    std::cout << status.id << "  " << status.device.name << "  " << status.device.tracer << "  " << status.leases
              << " batches" << (status.draining ? "  draining" : "");
    for (const auto& [kind, rate] : status.items_per_second) std::cout << "  " << kind << " " << format_rate(rate);
    if (!status.aside.empty()) std::cout << "  put aside: " << status.aside;
    std::cout << "\n";
  }
  return 0;
}

}  // namespace

void add_workers(CLI::App& app, Run& run) {
  auto options = std::make_shared<WorkersOptions>();
  CLI::App* command = app.add_subcommand("workers", "List the workers that are connected");
  command->add_flag("--json", options->json, "as JSON");
  add_coordinator_option(*command, options->coordinator);
  command->callback([options, &run] { run = [options] { return workers(*options); }; });
}

}  // namespace gleaner::cli

// `gleaner cancel`: ends a job that is not wanted any more.

#include <CLI/CLI.hpp>
#include <iostream>
#include <memory>

#include "cli/client.h"
#include "cli/commands.h"
#include "scene/model/error.h"

namespace gleaner::cli {

namespace {

struct CancelOptions {
  std::string coordinator, job;
};

int cancel(const CancelOptions& options) {
  coordinator::JobStatus status = Client(options.coordinator).cancel(options.job);
  using coordinator::JobState;
  if (status.state == JobState::done || status.state == JobState::failed)
    throw Error::failed("job " + status.id + " is " + job_state_name(status.state) + " already");
  return 0;
}

}  // namespace

void add_cancel(CLI::App& app, Run& run) {
  auto options = std::make_shared<CancelOptions>();
  CLI::App* command = app.add_subcommand("cancel", "Cancel a job");
  command->add_option("JOB", options->job, "as submit printed it")->required();
  add_coordinator_option(*command, options->coordinator);
  command->callback([options, &run] { run = [options] { return cancel(*options); }; });
}

}  // namespace gleaner::cli

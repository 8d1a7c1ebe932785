// `gleaner events`: what happens on a farm, as lines of JSON.

#include <CLI/CLI.hpp>
#include <iostream>
#include <memory>

#include "cli/call_again.h"
#include "cli/client.h"
#include "cli/commands.h"
#include "coordinator/gateway/status_json.h"
#include "scene/model/error.h"
#include "scene/model/names.h"

namespace gleaner::cli {

namespace {

struct EventsOptions {
  std::string coordinator, job;
  std::uint64_t after = 0;
  double give_up_seconds = 600;
};

// Until the job has ended, or for ever.
int events(const EventsOptions& options) {
  std::uint64_t seen = options.after;
  CallAgain call_again(options.give_up_seconds, [](const std::string& words) {
    std::cerr << "gleaner: " << printable_lines(words) << std::endl;
  });
  Client client(options.coordinator);
  for (;;) {
    try {
      client.events(seen, options.job, [&](const coordinator::FarmEvent& event) {
        call_again.answered();
        seen = event.number;
        std::cout << gateway::dump(gateway::event_json(event)) << std::endl;
        if (!std::cout) throw Error::failed("standard output: cannot write");
      });
      return 0;
    } catch (const Error& error) {
      call_again.lost(error, "");
    }
  }
}

}  // namespace

void add_events(CLI::App& app, Run& run) {
  auto options = std::make_shared<EventsOptions>();
  CLI::App* command =
      app.add_subcommand("events", "Tell what happens to jobs, frames and workers: a line of JSON each");
  command->add_option("JOB", options->job, "its events alone, to its end (default: all, until you stop it)");
  command->add_option(
      "--after", options->after,
      "the number of the last event that was seen: those behind it are told first (default: from now on)");
  add_give_up_option(*command, options->give_up_seconds);
  add_coordinator_option(*command, options->coordinator);
  command->callback([options, &run] { run = [options] { return events(*options); }; });
}

}  // namespace gleaner::cli

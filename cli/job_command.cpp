#include "cli/job_command.h"

#include <CLI/CLI.hpp>
#include <memory>

#include "scene/model/error.h"

namespace gleaner::cli {

void add_job_command(CLI::App& app, Run& run, const std::string& name, const std::string& help,
                     const std::function<void(Client&, const std::string&)>& what) {
  struct Words {
    std::string coordinator, job;
  };
  auto words = std::make_shared<Words>();
  CLI::App* command = app.add_subcommand(name, help);
  command->add_option("JOB", words->job, "as submit printed it")->required();
  add_coordinator_option(*command, words->coordinator);
  command->callback([words, what, &run] {
    run = [words, what] {
      Client client(words->coordinator);
      what(client, words->job);
      return 0;
    };
  });
}

void require_not_ended(const coordinator::JobStatus& status) {
  if (ended(status.state)) throw Error::failed("job " + status.id + " is " + job_state_name(status.state) + " already");
}

}  // namespace gleaner::cli

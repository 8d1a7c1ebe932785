// `gleaner pause`: nothing more of a job is computed until it is resumed.

#include "cli/job_command.h"

namespace gleaner::cli {

void add_pause(CLI::App& app, Run& run) {
  add_job_command(app, run, "pause", "Pause a job: others run meanwhile, what was computed stays",
                  [](Client& client, const std::string& job) { require_not_ended(client.pause(job, true)); });
}

}  // namespace gleaner::cli

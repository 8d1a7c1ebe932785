// `gleaner resume`: a paused job goes on.

#include "cli/job_command.h"

namespace gleaner::cli {

void add_resume(CLI::App& app, Run& run) {
  add_job_command(app, run, "resume", "Let a paused job go on",
                  [](Client& client, const std::string& job) { require_not_ended(client.pause(job, false)); });
}

}  // namespace gleaner::cli

// `gleaner cancel`: ends a job that is not wanted any more.

#include "cli/job_command.h"

namespace gleaner::cli {

void add_cancel(CLI::App& app, Run& run) {
  add_job_command(app, run, "cancel", "Cancel a job", [](Client& client, const std::string& job) {
    const coordinator::JobStatus status = client.cancel(job);
    if (status.state != coordinator::JobState::cancelled) require_not_ended(status);
  });
}

}  // namespace gleaner::cli

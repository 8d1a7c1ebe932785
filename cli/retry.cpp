// `gleaner retry`: the frames of a job that were not written, once more.

#include "cli/job_command.h"

namespace gleaner::cli {

void add_retry(CLI::App& app, Run& run) {
  add_job_command(app, run, "retry", "Render what a job that failed or was cancelled has not written",
                  [](Client& client, const std::string& job) { client.retry(job); });
}

}  // namespace gleaner::cli

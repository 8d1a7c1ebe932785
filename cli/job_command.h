#pragma once
// Commands that do one thing to a job: `gleaner NAME JOB`.

#include <functional>
#include <string>

#include "cli/client.h"
#include "cli/commands.h"

namespace gleaner::cli {

void add_job_command(CLI::App& app, Run& run, const std::string& name, const std::string& help,
                     const std::function<void(Client&, const std::string& job)>& what);
// Throws Error::failed where the job has ended, and what was asked of it is too late.
void require_not_ended(const coordinator::JobStatus& status);

}  // namespace gleaner::cli

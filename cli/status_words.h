#pragma once
// Jobs as text, for the commands that list, show and watch them. As JSON: coordinator/gateway/status_json.h.

#include <string>
#include <vector>

#include "coordinator/jobs/job.h"

namespace gleaner::cli {

// A line of CSV (RFC 4180) a job, for accounting; the first line names the columns.
std::string job_csv(const std::vector<coordinator::JobStatus>& jobs);
std::string job_line(const coordinator::JobStatus& status);
std::string written_frames(const coordinator::JobStatus& status);  // "1-3, 5"
// Throws Error::failed where the job failed or was cancelled.
void require_done(const coordinator::JobStatus& status);

}  // namespace gleaner::cli

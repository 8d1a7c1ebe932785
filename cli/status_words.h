#pragma once
// Jobs and workers as text and as JSON, for the commands that list, show and watch them.

#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "coordinator/jobs/event_log.h"
#include "coordinator/jobs/job.h"

namespace gleaner::cli {

nlohmann::json job_json(const coordinator::JobStatus& status);
nlohmann::json worker_json(const coordinator::WorkerStatus& status);
nlohmann::json event_json(const coordinator::FarmEvent& event);
std::string dump(const nlohmann::json& value);  // one line; bytes that are not UTF-8 are replaced
// A line of CSV (RFC 4180) a job, for accounting; the first line names the columns.
std::string job_csv(const std::vector<coordinator::JobStatus>& jobs);
std::string job_line(const coordinator::JobStatus& status);
std::string written_frames(const coordinator::JobStatus& status);  // "1-3, 5"
// Throws Error::failed where the job failed or was cancelled.
void require_done(const coordinator::JobStatus& status);

}  // namespace gleaner::cli

#pragma once
// Jobs, workers and events as JSON: what commands print with --json, and what the coordinator's page is made of.

#include <nlohmann/json.hpp>
#include <string>

#include "coordinator/jobs/event_log.h"
#include "coordinator/jobs/job.h"
#include "coordinator/jobs/overview.h"

namespace gleaner::gateway {

nlohmann::json job_json(const coordinator::JobStatus& status);
nlohmann::json worker_json(const coordinator::WorkerStatus& status);
nlohmann::json event_json(const coordinator::FarmEvent& event);
nlohmann::json overview_json(const coordinator::FarmOverview& overview);  // long messages are cut
std::string dump(const nlohmann::json& value);  // one line; bytes that are not UTF-8 are replaced

}  // namespace gleaner::gateway

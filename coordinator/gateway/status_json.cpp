#include "coordinator/gateway/status_json.h"

#include "gleaner/version.h"

namespace gleaner::gateway {

using namespace gleaner::coordinator;
using nlohmann::json;

json job_json(const JobStatus& status) {
  json stages = json::array();
  for (const auto& stage : status.stages) {
    json entry = {{"name", stage.name},
                  {"kind", stage.kind},
                  {"frame", stage.frame},
                  {"items", stage.items},
                  {"items_done", stage.items_done},
                  {"items_per_second", stage.items_per_second}};
    if (stage.seconds_left >= 0) entry["seconds_left"] = stage.seconds_left;
    stages.push_back(std::move(entry));
  }
  json written = json::array();
  for (const auto& [first, last] : status.written) written.push_back({first, last});
  json out = {{"job", status.id},
              {"name", status.name},
              {"owner", status.owner},
              {"priority", status.priority},
              {"paused", status.paused},
              {"after", status.after},
              {"worker_seconds", status.worker_seconds},
              {"rays", status.rays},
              {"state", job_state_name(status.state)},
              {"scene", status.scene_name},
              {"method", status.method},
              {"size", {status.width, status.height}},
              {"frames", status.frames},
              {"frames_done", status.frames_done},
              {"frames_failed", status.frames_failed},
              {"written", std::move(written)},
              {"running", status.running},
              {"stages", std::move(stages)},
              {"progress", status.progress},
              {"frame_progress", status.frame_progress},
              {"seconds", status.seconds},
              {"submitted_unix_seconds", status.submitted_unix_seconds},
              {"preview_available", status.preview_available}};
  if (status.seconds_left >= 0) out["seconds_left"] = status.seconds_left;
  if (status.frame_seconds_left >= 0) out["frame_seconds_left"] = status.frame_seconds_left;
  if (!status.message.empty()) out["message"] = status.message;
  return out;
}

json worker_json(const WorkerStatus& status) {
  return {{"worker", status.id},
          {"address", status.address},
          {"device", status.device.name},
          {"platform", status.device.platform},
          {"tracer", status.device.tracer},
          {"denoiser", status.device.denoiser},
          {"cpu", status.device.cpu},
          {"threads", status.device.threads},
          {"memory_bytes", status.device.memory_bytes},
          {"leases", status.leases},
          {"draining", status.draining},
          {"aside", status.aside},
          {"connected_seconds", status.connected_seconds},
          {"silent_seconds", status.silent_seconds},
          {"items_per_second", status.items_per_second}};
}

json event_json(const FarmEvent& event) {
  json out = {
      {"number", event.number}, {"unix_seconds", event.unix_seconds}, {"kind", event.kind}, {"what", event.what}};
  if (!event.job.empty()) out["job"] = event.job;
  if (event.frame > 0) out["frame"] = event.frame;
  if (!event.worker.empty()) out["worker"] = event.worker;
  if (!event.message.empty()) out["message"] = event.message;
  return out;
}

namespace {

constexpr std::size_t most_message_bytes = 2000;  // on a page; a compiler says more, which `gleaner show` tells

std::string cut(const std::string& message) {
  return message.size() > most_message_bytes ? message.substr(0, most_message_bytes) + " ..." : message;
}

json shown_worker_json(const FarmOverview::ShownWorker& worker) {
  json out = worker_json(worker.status);
  if (const auto& batch = worker.batch)
    out["batch"] = {{"job", batch->job},        {"stage", batch->stage}, {"kind", batch->kind},
                    {"frame", batch->frame},    {"first", batch->first}, {"items", batch->items},
                    {"seconds", batch->seconds}};
  if (const auto& last = worker.last)
    out["last_batch"] = {
        {"stage", last->stage}, {"kind", last->kind}, {"items", last->items}, {"seconds", last->seconds}};
  return out;
}

json shown_job_json(const FarmOverview::ShownJob& job) {
  json out = job_json(job.status);
  if (!job.status.message.empty()) out["message"] = cut(job.status.message);
  if (const auto& error = job.error)
    out["error"] = {{"frame", error->frame}, {"relative", error->relative}, {"denoised", error->denoised}};
  return out;
}

}  // namespace

json overview_json(const FarmOverview& overview) {
  json workers = json::array(), gone = json::array(), jobs = json::array(), events = json::array();
  for (const auto& worker : overview.workers) workers.push_back(shown_worker_json(worker));
  for (const GoneWorker& worker : overview.gone)
    gone.push_back({{"worker", worker.name},
                    {"device", worker.device},
                    {"unix_seconds", worker.unix_seconds},
                    {"lost", worker.lost},
                    {"why", cut(worker.why)}});
  for (const auto& job : overview.jobs) jobs.push_back(shown_job_json(job));
  for (FarmEvent event : overview.events) {
    event.message = cut(event.message);
    events.push_back(event_json(event));
  }
  json jobs_out = {{"shown", std::move(jobs)}, {"paused", overview.paused}};
  for (const JobState state :
       {JobState::queued, JobState::running, JobState::done, JobState::failed, JobState::cancelled}) {
    const auto count = overview.jobs_in.find(state);
    jobs_out[job_state_name(state)] = count == overview.jobs_in.end() ? 0 : count->second;
  }
  return {{"version", version},
          {"unix_seconds", overview.unix_seconds},
          {"totals",
           {{"frames_written", overview.totals.frames_written},
            {"items_accepted", overview.totals.items_accepted},
            {"batches_accepted", overview.totals.batches_accepted},
            {"batches_failed", overview.totals.batches_failed},
            {"batches_expired", overview.totals.batches_expired},
            {"liars_found", overview.totals.liars_found}}},
          {"workers",
           {{"connected", overview.workers_connected},
            {"draining", overview.draining},
            {"aside", overview.aside},
            {"shown", std::move(workers)},
            {"gone", std::move(gone)}}},
          {"jobs", std::move(jobs_out)},
          {"events", std::move(events)}};
}

std::string dump(const json& value) { return value.dump(-1, ' ', false, json::error_handler_t::replace); }

}  // namespace gleaner::gateway

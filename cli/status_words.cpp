#include "cli/status_words.h"

#include <fmt/format.h>

#include <cmath>
#include <ctime>

#include "cli/progress.h"
#include "scene/model/error.h"

namespace gleaner::cli {

using coordinator::JobState;
using coordinator::JobStatus;
using coordinator::WorkerStatus;
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

json event_json(const coordinator::FarmEvent& event) {
  json out = {
      {"number", event.number}, {"unix_seconds", event.unix_seconds}, {"kind", event.kind}, {"what", event.what}};
  if (!event.job.empty()) out["job"] = event.job;
  if (event.frame > 0) out["frame"] = event.frame;
  if (!event.worker.empty()) out["worker"] = event.worker;
  if (!event.message.empty()) out["message"] = event.message;
  return out;
}

std::string dump(const json& value) { return value.dump(-1, ' ', false, json::error_handler_t::replace); }

namespace {

std::string csv_field(const std::string& text) {
  std::string quoted = "\"";
  for (const char c : text) quoted += c == '"' ? std::string("\"\"") : std::string(1, c);
  return quoted + "\"";
}

std::string utc(double unix_seconds) {
  const auto seconds = static_cast<std::time_t>(unix_seconds);
  std::tm parts{};
  char text[32];
  if (!::gmtime_r(&seconds, &parts) || std::strftime(text, sizeof text, "%Y-%m-%dT%H:%M:%SZ", &parts) == 0) return {};
  return text;
}

}  // namespace

std::string job_csv(const std::vector<JobStatus>& jobs) {
  std::string lines =
      "job,name,state,priority,scene,method,width,height,frames,frames_done,frames_failed,submitted,seconds,"
      "worker_seconds,rays,owner\r\n";
  for (const JobStatus& job : jobs)
    lines += fmt::format("{},{},{},{},{},{},{},{},{},{},{},{},{:.3f},{:.3f},{},{}\r\n", job.id, csv_field(job.name),
                         job_state_name(job.state), job.priority, csv_field(job.scene_name), job.method, job.width,
                         job.height, job.frames, job.frames_done, job.frames_failed, utc(job.submitted_unix_seconds),
                         job.seconds, job.worker_seconds, job.rays, csv_field(job.owner));
  return lines;
}

std::string job_line(const JobStatus& status) {
  std::string state = status.paused && !ended(status.state) ? "paused" : job_state_name(status.state);
  if (status.state == JobState::running) state += fmt::format(" {:.0f} %", std::floor(100 * status.progress));
  std::string line = fmt::format("{}  {}  {}  {}  {}x{}  {}", status.id, state, status.scene_name, status.method,
                                 status.width, status.height, format_duration(status.seconds));
  if (!status.name.empty()) line += fmt::format("  \"{}\"", status.name);
  if (!status.message.empty()) line += fmt::format("  {}", status.message);
  return line;
}

std::string written_frames(const JobStatus& status) {
  std::string words;
  for (const auto& [first, last] : status.written) {
    if (!words.empty()) words += ", ";
    words += last == first ? fmt::format("{}", first) : fmt::format("{}-{}", first, last);
  }
  if (status.frame_step > 1 && !words.empty()) words += fmt::format(" (every {}th)", status.frame_step);
  return words;
}

void require_done(const JobStatus& status) {
  if (status.state == JobState::failed) throw Error::failed("job " + status.id + " failed: " + status.message);
  if (status.state == JobState::cancelled) throw Error::failed("job " + status.id + " was cancelled");
}

}  // namespace gleaner::cli

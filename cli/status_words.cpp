#include "cli/status_words.h"

#include <fmt/format.h>

#include <cmath>
#include <ctime>

#include "cli/progress.h"
#include "scene/model/error.h"

namespace gleaner::cli {

using coordinator::JobState;
using coordinator::JobStatus;

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

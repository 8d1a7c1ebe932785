#include "coordinator/jobs/frame.h"

#include <algorithm>

namespace gleaner::coordinator {

namespace {
constexpr Seconds rate_window = 5;  // throughput that people see is that of so long
}

const char* job_state_name(JobState state) {
  switch (state) {
    case JobState::queued:
      return "queued";
    case JobState::running:
      return "running";
    case JobState::done:
      return "done";
    case JobState::failed:
      return "failed";
    case JobState::cancelled:
      return "cancelled";
  }
  return "unknown";
}

void remember_progress(RunningStage& stage, Seconds now) {
  stage.history.emplace_back(now, stage.items_done);
  while (stage.history.size() > 2 && stage.history.front().first < now - rate_window) stage.history.pop_front();
}

StageStatus status_of(const RunningStage& stage, Seconds now) {
  StageStatus status{
      .name = stage.spec.name, .kind = stage.spec.kind, .items = stage.items, .items_done = stage.items_done};
  if (stage.complete) {
    double seconds = stage.last_result - stage.first_lease;
    status.items_per_second = seconds > 0 ? static_cast<double>(stage.items) / seconds : 0;
    status.seconds_left = 0;
  } else if (!stage.history.empty()) {
    const auto& [since, before] = stage.history.front();
    double seconds = now - since;
    if (seconds > 0) status.items_per_second = static_cast<double>(stage.items_done - before) / seconds;
    if (status.items_per_second > 0)
      status.seconds_left = static_cast<double>(stage.items - stage.items_done) / status.items_per_second;
  }
  return status;
}

namespace {

void add_progress(const Job& job, Seconds now, JobStatus& status) {
  status.frame_progress = job.progress.part();
  status.frame_seconds_left = job.progress.seconds_left();
  if (const double limit = job.request.time_limit; limit > 0) {
    // What the limit ends sooner is over by then.
    const Seconds elapsed = now - job.frame_begun, left = std::max(0.0, limit - elapsed);
    if (status.frame_seconds_left < 0 || status.frame_seconds_left > left) {
      status.frame_seconds_left = left;
      status.frame_progress = std::max(status.frame_progress, std::min(1.0, elapsed / limit));
    }
  }
  const double frames = status.frames, done = status.frames_done;
  status.progress = std::min(1.0, (done + status.frame_progress) / frames);
  status.seconds_left = status.frame_seconds_left;
  // Where nothing moves, one frame serves for all.
  const bool still = job.request.cameras.empty() && job.request.scenes.size() <= 1;
  const double to_come = still ? 0 : std::max(0.0, frames - done - 1);
  if (status.seconds_left < 0 || to_come == 0) return;
  const Seconds of_a_frame =
      done > 0 ? (job.frame_begun - job.started) / done : now - job.frame_begun + status.frame_seconds_left;
  status.seconds_left += to_come * of_a_frame;
}

}  // namespace

JobStatus status_of(const Job& job, Seconds now) {
  JobStatus status;
  status.id = job.id;
  status.state = job.state;
  status.scene_name = job.request.scene_name;
  status.method = job.request.settings.method;
  status.width = job.request.settings.width;
  status.height = job.request.settings.height;
  status.frames = static_cast<std::uint32_t>(frames_of(job.request));
  status.frames_done = job.frames_done;
  status.stages = job.last_stages;
  for (const auto& stage : job.stages) status.stages.push_back(status_of(*stage, now));
  status.seconds = (ended(job.state) ? job.ended : now) - job.accepted;
  status.submitted_unix_seconds = job.submitted_unix_seconds;
  status.message = job.message;
  status.exposure_stops = job.request.exposure_stops;
  status.preview_available = job.state == JobState::done;
  for (const StageStatus& stage : status.stages)
    status.preview_available = status.preview_available || stage.items_done > 0;
  status.version = job.version;
  if (job.state == JobState::running) add_progress(job, now, status);
  if (job.state == JobState::done) status.progress = status.frame_progress = 1;
  return status;
}

}  // namespace gleaner::coordinator

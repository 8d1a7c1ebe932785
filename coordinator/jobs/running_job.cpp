#include "coordinator/jobs/running_job.h"

#include <algorithm>

namespace gleaner::coordinator {

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

void update_progress(Job& job, Seconds now) {
  double done = static_cast<double>(job.frames_over());
  for (const auto& [place, frame] : job.frames) done += frame->progress.part() * static_cast<double>(frame->left);
  job.progress.update(now, done, static_cast<double>(frames_of(job.request)) - done);
}

namespace {

constexpr std::size_t most_brief_stages = 8;

void add_progress(const Job& job, Seconds now, JobStatus& status) {
  status.progress = job.progress.part();
  status.seconds_left = job.progress.seconds_left();
  if (job.frames.empty()) return;
  const Frame& first = *job.frames.begin()->second;
  status.frame_progress = first.progress.part();
  status.frame_seconds_left = first.progress.seconds_left();
  const double limit = job.request.time_limit, frames = static_cast<double>(frames_of(job.request));
  if (limit > 0) {
    // What the limit ends sooner is over by then.
    const Seconds elapsed = now - first.begun, left = std::max(0.0, limit - elapsed);
    if (status.frame_seconds_left < 0 || status.frame_seconds_left > left) {
      status.frame_seconds_left = left;
      status.frame_progress = std::max(status.frame_progress, std::min(1.0, elapsed / limit));
    }
    const double over = static_cast<double>(job.frames_over());
    status.progress = std::max(
        status.progress, std::min(1.0, (over + status.frame_progress * static_cast<double>(first.left)) / frames));
    // Later frames end in time as well.
    const double later = frames - over - static_cast<double>(first.left);
    const Seconds most = status.frame_seconds_left + later * limit;
    if (status.seconds_left < 0 || status.seconds_left > most) status.seconds_left = most;
  }
  // One frame, or one picture, is all that there is to come.
  if (job.frames.size() == 1 && first.place + first.left == frames_of(job.request))
    status.seconds_left = status.frame_seconds_left;
}

void add_frames(const Job& job, bool brief, JobStatus& status) {
  const auto number = [&](std::uint64_t place) { return frame_at(job.request, place); };
  for (const auto& [place, frame] : job.frames) status.running.push_back(number(frame->place));
  status.frames = static_cast<std::uint32_t>(frames_of(job.request));
  status.frame_step = job.request.numbers.empty() ? job.request.frame_step : 1;
  status.frames_done = static_cast<std::uint32_t>(job.written.count());
  status.frames_failed = static_cast<std::uint32_t>(job.failed.count());
  if (brief) return;
  for (const auto& [first, last] : job.written.ranges()) {
    status.written.emplace_back(number(first), number(last));
    if (job.request.numbers.empty()) continue;
    // Numbers that were listed are told as ranges of neighbours.
    status.written.back().second = number(first);
    for (std::uint64_t place = first + 1; place <= last; ++place) {
      if (number(place) == number(place - 1) + 1)
        status.written.back().second = number(place);
      else
        status.written.emplace_back(number(place), number(place));
    }
  }
}

void add_stages(const Job& job, Seconds now, bool brief, JobStatus& status) {
  if (job.frames.empty()) status.stages = job.last_stages;
  for (const auto& [place, frame] : job.frames)
    for (const auto& stage : frame->stages) {
      status.preview_available = status.preview_available || stage->items_done > 0;
      if (brief && (stage->complete || status.stages.size() == most_brief_stages)) continue;
      status.stages.push_back(status_of(*stage, now));
    }
  for (const StageStatus& stage : status.stages)
    status.preview_available = status.preview_available || stage.items_done > 0;
  if (brief && job.frames.empty()) status.stages.clear();
}

}  // namespace

JobStatus status_of(const Job& job, Seconds now, bool brief) {
  JobStatus status;
  status.id = job.id;
  status.owner = job.request.owner;
  status.name = job.request.name;
  status.paused = job.paused;
  status.priority = job.request.priority;
  if (!brief) status.after = job.request.after;
  status.worker_seconds = job.worker_seconds;
  status.rays = job.rays;
  status.state = job.state;
  status.scene_name = job.request.scene_name;
  status.method = job.request.settings.method;
  status.width = job.request.settings.width;
  status.height = job.request.settings.height;
  add_frames(job, brief, status);
  status.preview_available = job.state == JobState::done;
  add_stages(job, now, brief, status);
  status.seconds = (ended(job.state) ? job.ended : now) - job.accepted;
  status.submitted_unix_seconds = job.submitted_unix_seconds;
  status.message = job.message;
  status.exposure_stops = job.request.exposure_stops;
  status.version = job.version;
  if (job.state == JobState::running) add_progress(job, now, status);
  if (job.state == JobState::done) status.progress = status.frame_progress = 1;
  return status;
}

}  // namespace gleaner::coordinator

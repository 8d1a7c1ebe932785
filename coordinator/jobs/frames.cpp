// Frames of a job side by side. A job's first frame begins with the job; a further one begins while workers idle that
// the frames which run cannot feed, as far as memory goes. Earlier frames come first: a later one gets what they leave.

#include <algorithm>
#include <cstring>
#include <iterator>
#include <limits>
#include <new>
#include <system_error>
#include <utility>

#include "coordinator/jobs/engine.h"
#include "coordinator/journal/journal_writer.h"
#include "scene/model/error.h"

namespace gleaner::coordinator {

namespace {

// For which a worker idles before a further frame is begun. Between two stages of a frame it does so for less.
constexpr Seconds idle_before_frame = 0.02;

bool same_picture(const JobRequest& request, std::uint64_t a, std::uint64_t b) {
  if (request.scenes.size() > 1 && blobs_of(request.scenes[a]) != blobs_of(request.scenes[b])) return false;
  return request.cameras.empty() || std::memcmp(&request.cameras[a], &request.cameras[b], sizeof(scene::Camera)) == 0;
}

}  // namespace

FrameSettings settings_of(const JobRequest& request, std::uint64_t place) {
  FrameSettings settings = request.settings;
  if (!request.cameras.empty()) settings.camera = request.cameras[place];
  settings.limited = request.time_limit > 0;
  return settings;
}

unsigned rank_of(const Frame& frame) {
  const auto& frames = frame.job->frames;
  return static_cast<unsigned>(std::distance(
      frames.begin(),
      std::find_if(frames.begin(), frames.end(), [&](const auto& f) { return f.second.get() == &frame; })));
}

bool Farm::Impl::begin_frame(const std::shared_ptr<Job>& job) {
  const std::uint64_t frames = frames_of(job->request);
  const auto over = [&](std::uint64_t place) { return job->written.contains(place) || job->failed.contains(place); };
  while (job->next < frames && over(job->next)) ++job->next;
  if (job->next == frames) return false;
  auto frame = std::make_shared<Frame>();
  frame->job = job;
  frame->place = job->next++;
  while (job->next < frames && !over(job->next) && same_picture(job->request, frame->place, job->next)) {
    ++job->next;
    ++frame->left;
  }
  frame->scene = scene_of(job->request, frame->place);
  frame->settings = settings_of(job->request, frame->place);
  frame->memory = job->memory;
  memory_taken += frame->memory;
  last_frame_begun = now();
  // The wait in the queue counts for the first one.
  const bool first = job->frames.empty() && job->frames_over() == 0;
  frame->begun = last_frame_begun;
  frame->waited_from = first ? job->accepted : frame->begun;
  frame->progress = FrameProgress(last_frame_begun);
  job->frames[frame->place] = frame;
  try {
    threads.emplace(frame.get(), settings.start_thread([self = shared_from_this(), frame] { run(self, frame); }));
  } catch (const std::system_error& error) {
    if (!std::exchange(said_no_thread, true))
      settings.log("job " + job->id + ": no thread for a frame (" + error.what() + "); it waits");
    memory_taken -= frame->memory;
    job->frames.erase(frame->place);
    job->next = frame->place;
    return false;
  }
  said_no_thread = false;
  tell({.kind = "frame",
        .what = "started",
        .job = job->id,
        .worker = {},
        .frame = frame_at(job->request, frame->place),
        .message = {}});
  return true;
}

void Farm::Impl::wait_again(const std::shared_ptr<Job>& job) {
  std::erase(running, job);
  job->state = JobState::queued;
  put_in_queue(job);
  changed(*job);
}

bool Farm::Impl::may_begin_another(const Job& job) const {
  if (job.cancel || job.paused || job.frames.empty() || job.next >= frames_of(job.request)) return false;
  // A frame with a time limit has the farm for that time.
  if (job.request.time_limit > 0) return false;
  if (job.frames.size() >= std::min<std::size_t>(settings.frames_at_once, workers.size())) return false;
  // Memory for which a job waits is left to it.
  if (const auto waiting = next_queued(); waiting && active() < settings.active_jobs && !has_memory_for(*waiting))
    return false;
  return has_memory_for(job);
}

std::shared_ptr<Job> Farm::Impl::job_for_another_frame() const {
  std::shared_ptr<Job> best;
  for (const auto& job : running) {
    // Those that are not under way yet will have work.
    for (const auto& [place, frame] : job->frames)
      if (!frame->posted) return nullptr;
    if (may_begin_another(*job) && (!best || job->frames.size() < best->frames.size())) best = job;
  }
  return best;
}

bool Farm::Impl::further_frame_comes() const {
  for (const auto& job : running) {
    if (job->frames.size() > 1 && !job->frames.rbegin()->second->posted) return true;
    if (may_begin_another(*job)) return true;
  }
  return false;
}

void Farm::Impl::note_idle(Worker& worker) {
  if (worker.draining || !worker.leases.empty()) {
    worker.idle_since = -1;
    return;
  }
  if (worker.idle_since < 0) worker.idle_since = now();
  if (!job_for_another_frame()) return;
  timer_rearm = true;
  timer_wakes.notify_all();
}

std::optional<Seconds> Farm::Impl::next_frame_due() const {
  if (stopping || !job_for_another_frame()) return std::nullopt;
  Seconds idle = std::numeric_limits<Seconds>::infinity();
  for (const auto& [id, worker] : workers)
    if (worker.idle_since >= 0 && !worker.draining && !scheduler.quarantined_until(id))
      idle = std::min(idle, worker.idle_since);
  if (idle == std::numeric_limits<Seconds>::infinity()) return std::nullopt;
  return std::max(idle, last_frame_begun) + idle_before_frame;
}

void Farm::Impl::begin_another_frame() {
  if (const auto due = next_frame_due(); !due || *due > now()) return;
  begin_frame(job_for_another_frame());
}

void Farm::Impl::rank_frames(Job& job) {
  unsigned rank = 0;
  for (const auto& [place, frame] : job.frames) {
    for (const auto& stage : frame->stages)
      if (!stage->delivered && !stage->computes_again) scheduler.set_rank(stage->id, rank);
    ++rank;
  }
}

bool Farm::Impl::frame_over(Frame& frame, const std::string& failure) {
  Job& job = *frame.job;
  const std::uint64_t place = frame.place;
  forget_records(frame, failure);
  if (failure.empty()) {
    job.written.insert(place);
    ++totals.frames_written;
  } else {
    job.failed.insert(place);
    if (job.failures.size() < most_failures) job.failures.emplace_back(place, failure);
    if (frames_of(job.request) > 1)
      settings.log("job " + job.id + ": frame " + std::to_string(frame_at(job.request, place)) + " failed: " + failure);
  }
  tell({.kind = "frame",
        .what = failure.empty() ? "written" : "failed",
        .job = job.id,
        .worker = {},
        .frame = frame_at(job.request, place),
        .message = failure});
  frame.held.clear();
  frame.remembered.clear();
  for (const WorkerId maker : std::exchange(frame.makers, {})) ++job.frames_with[maker];
  frame.begun = frame.waited_from = now();
  --frame.left;
  if (frame.left > 0) ++frame.place;
  update_progress(job, frame.begun);
  // What it has cost so far; who cancelled it was told that it ends so.
  journal_changed(job, job.cancel && !stopping ? JobState::cancelled : job.state);
  changed(job);
  return frame.left > 0;
}

std::string Farm::Impl::failures_of(const Job& job) const {
  const std::uint64_t frames = frames_of(job.request);
  if (frames == 1 && !job.failures.empty()) return job.failures.front().second;
  std::string words = std::to_string(job.failed.count()) + " of " + std::to_string(frames) + " frames failed";
  const char* separator = ": ";
  for (const auto& [place, why] : job.failures) {
    words += std::exchange(separator, "; ") + ("frame " + std::to_string(frame_at(job.request, place))) + ": " + why;
  }
  if (job.failed.count() > job.failures.size())
    words += "; and " + std::to_string(job.failed.count() - job.failures.size()) + " more";
  return words;
}

void Farm::Impl::run(std::shared_ptr<Impl> self, std::shared_ptr<Frame> frame) {
  self->join_ended_threads();  // of the frames before: until then their stacks stay
  std::string failure;
  try {
    self->render_and_write(frame);
  } catch (const Cancelled&) {
  } catch (const std::bad_alloc&) {
    failure = "the coordinator is out of memory";
  } catch (const std::exception& error) {
    failure = error.what();
  } catch (...) {
    failure = "the plan threw what is no std::exception";
  }
  std::unique_ptr<Plan> plan;
  {
    std::lock_guard plan_lock(frame->plan_mutex);
    plan = std::move(frame->plan);
  }
  plan.reset();
  JobRemains remains;
  std::shared_ptr<const scene::Scene> base;  // destroyed where the mutex is not held
  std::lock_guard lock(self->mutex);
  remains = self->frame_ended(frame, failure);
  if (ended(frame->job->state)) {
    std::lock_guard base_lock(frame->job->base_mutex);
    base = std::exchange(frame->job->base, nullptr);
    frame->job->base_blob.clear();
  }
  auto own = self->threads.find(frame.get());
  if (own != self->threads.end()) {
    self->ended_threads.push_back(std::move(own->second));
    self->threads.erase(own);
  }
  self->thread_ended.notify_all();
}

JobRemains Farm::Impl::frame_ended(const std::shared_ptr<Frame>& frame, const std::string& failure) {
  const std::shared_ptr<Job> job = frame->job;
  memory_taken -= frame->memory;
  // One that was cancelled while a plan computed has ended before, and its frames were taken back then.
  if (ended(job->state)) {
    start_queued();
    return {};
  }
  JobRemains remains = withdraw(*frame);
  job->last_stages.clear();
  for (const auto& stage : frame->stages) job->last_stages.push_back(status_of(*stage, now()));
  if (!failure.empty() && !job->cancel)
    while (frame_over(*frame, failure)) {
    }
  std::move(frame->stages.begin(), frame->stages.end(), std::back_inserter(remains.stages));
  frame->stages.clear();
  std::erase_if(job->frames, [&](const auto& entry) { return entry.second == frame; });
  rank_frames(*job);
  const bool others = !job->frames.empty();
  if (others) start_queued();  // a job that waited for this memory comes before a further frame
  const bool stops = job->cancel || stopping || (others && !may_begin_another(*job));
  const bool goes_on = !stops && !job->paused && begin_frame(job);
  if (!goes_on && !others && !stops && job->frames_over() < frames_of(job->request)) {
    wait_again(job);
  } else if (!goes_on && !others) {
    JobState state = JobState::done;
    std::string message;
    // Who cancelled while the last frame was written was told that the job ends so.
    if (job->cancel || stopping) {
      state = JobState::cancelled;
    } else if (job->failed.count() > 0) {
      state = JobState::failed;
      message = failures_of(*job);
    } else {
      for (const std::string& warning : job->warnings) message += (message.empty() ? "" : "; ") + warning;
    }
    remains.frames.push_back(end_job(*job, state, message));
  }
  start_queued();
  return remains;
}

}  // namespace gleaner::coordinator

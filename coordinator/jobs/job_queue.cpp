// Jobs from submission to their end: who runs next, and what remains of one that ended.

#include <algorithm>
#include <chrono>
#include <new>

#include "coordinator/jobs/engine.h"
#include "coordinator/jobs/job_id.h"
#include "coordinator/plan/way_points.h"
#include "scene/model/error.h"

namespace gleaner::coordinator {

void Farm::Impl::changed(Job& job) {
  ++job.version;
  job_changed.notify_all();
}

std::shared_ptr<Job> Farm::Impl::find(const std::string& id) const {
  auto found = jobs.find(id);
  return found == jobs.end() ? nullptr : found->second;
}

void Farm::Impl::start_queued() {
  std::size_t running = 0;
  for (const auto& id : order) running += jobs[id]->state == JobState::running;
  for (const auto& id : order) {
    if (running >= settings.active_jobs || stopping) return;
    auto job = jobs[id];
    if (job->state != JobState::queued) continue;
    job->state = JobState::running;
    changed(*job);
    ++running;
    job->thread = std::thread([this, job] { run(job); });
  }
}

void Farm::Impl::join_ended_threads() {
  std::vector<std::thread> threads;
  {
    std::lock_guard lock(mutex);
    for (auto& [id, job] : jobs)
      if (job->thread_ended && job->thread.joinable()) threads.push_back(std::move(job->thread));
  }
  for (std::thread& thread : threads) thread.join();
}

void Farm::Impl::run(const std::shared_ptr<Job>& job) {
  JobState state = JobState::done;
  std::string message;
  try {
    run_frames(job);
  } catch (const Cancelled&) {
    state = JobState::cancelled;
  } catch (const std::bad_alloc&) {
    state = JobState::failed;
    message = "the coordinator is out of memory";
  } catch (const std::exception& error) {
    state = JobState::failed;
    message = error.what();
  }
  end_frame(*job);
  {
    // The plan goes while nobody looks at it, and not under the farm's mutex: its records may be large.
    std::lock_guard plan_lock(job->plan_mutex);
    job->plan.reset();
  }
  std::lock_guard lock(mutex);
  // Who cancelled while the last frame was written was told that the job ends so.
  if (state == JobState::done && job->cancel) state = JobState::cancelled;
  job->state = state;
  job->message = message;
  job->ended = now();
  settings.log("job " + job->id + " " + job_state_name(state) + (message.empty() ? "" : ": " + message));
  changed(*job);
  job->thread_ended = true;
  start_queued();
}

std::string Farm::submit(const JobRequest& request) {
  if (request.last_frame < request.first_frame || request.last_frame - request.first_frame >= 100000)
    throw Error::usage("frames " + std::to_string(request.first_frame) + "-" + std::to_string(request.last_frame) +
                       ": expected first <= last, and at most 100000 frames");
  if (!request.cameras.empty() && request.cameras.size() != request.last_frame - request.first_frame + 1)
    throw Error::usage("cameras: expected one for each of " +
                       std::to_string(request.last_frame - request.first_frame + 1) + " frames, found " +
                       std::to_string(request.cameras.size()));
  for (const std::string& id : {request.scene_blob, request.bvh_blob})
    if (!id.empty() && !impl_->blobs.has(id)) throw Error::bad_input("blob " + id, "", "to be uploaded first");
  auto job = std::make_shared<Job>();
  job->request = request;
  job->request.scene.blob = request.scene_blob;
  if (!request.cameras.empty()) job->request.settings.way = way_of(request.cameras);
  job->plan = impl_->settings.plan(settings_of(job->request, request.first_frame), job->request.scene);
  job->submitted_unix_seconds =
      std::chrono::duration<double>(std::chrono::system_clock::now().time_since_epoch()).count();
  impl_->join_ended_threads();
  std::lock_guard lock(impl_->mutex);
  do job->id = new_job_id();
  while (impl_->jobs.count(job->id));
  job->accepted = impl_->now();
  impl_->jobs[job->id] = job;
  impl_->order.push_back(job->id);
  impl_->settings.log("job " + job->id + " accepted: " + request.scene_name + ", " + request.settings.method + ", " +
                      std::to_string(request.settings.width) + "x" + std::to_string(request.settings.height));
  impl_->start_queued();
  return job->id;
}

std::optional<JobStatus> Farm::cancel(const std::string& id) {
  std::lock_guard lock(impl_->mutex);
  auto job = impl_->find(id);
  if (!job) return std::nullopt;
  if (job->state == JobState::queued) {
    job->state = JobState::cancelled;
    job->ended = impl_->now();
    impl_->changed(*job);
  } else if (job->state == JobState::running) {
    job->cancel = true;
    job->events.notify_all();
    impl_->changed(*job);
  }
  return status_of(*job, impl_->now());
}

}  // namespace gleaner::coordinator

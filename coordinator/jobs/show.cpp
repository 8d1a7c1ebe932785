// A frame for someone who waits for it, or a picture to be denoised: a job that is in no list, before all others.

#include <algorithm>
#include <utility>

#include "coordinator/jobs/engine.h"
#include "coordinator/jobs/job_id.h"
#include "scene/model/error.h"

namespace gleaner::coordinator {

std::optional<Farm::Picture> Farm::show(const JobRequest& request, const SceneSummary& shown,
                                        const std::stop_token& stop, bool behind) {
  return impl_->show(*this, request, {.shown = shown, .behind = behind}, stop);
}

bool Farm::can_denoise() const {
  std::lock_guard lock(impl_->mutex);
  return impl_->denoisers().able > 0;
}

Farm::Impl::Denoisers Farm::Impl::denoisers() const {
  Denoisers found;
  for (const auto& [id, worker] : workers) {
    if (worker.draining) continue;
    ++found.working;
    if (!worker.hello.device.denoiser.empty()) ++found.able;
  }
  return found;
}

std::optional<Farm::Picture> Farm::denoise(const std::string& id, Film film, const std::stop_token& stop) {
  JobRequest request;
  {
    std::lock_guard lock(impl_->mutex);
    const std::shared_ptr<Job> job = impl_->find(id);
    if (!job || ended(job->state)) return std::nullopt;
    request.scene_name = job->request.scene_name;
    request.scenes = {job->request.scenes.front()};
    request.settings = job->request.settings;
  }
  request.settings.width = film.width;
  request.settings.height = film.height;
  request.settings.spp = std::max(2u, request.settings.spp);  // as a frame's own denoising would need
  request.settings.target_error = 0;
  request.settings.trajectory.clear();
  request.settings.denoise = Denoise::fast;
  const SceneSummary shown = request.scenes.front().summary;
  return impl_->show(*this, request, {.shown = shown, .given = std::move(film)}, stop);
}

std::optional<Farm::Picture> Farm::Impl::show(Farm& farm, JobRequest request, Job::Showing showing,
                                              const std::stop_token& stop) {
  request.priority = most_priority - (showing.behind ? 1 : 0);
  request.settings.only_picture = request.settings.denoise == Denoise::off;
  const std::shared_ptr<Job> job = accept(request);
  job->showing = std::make_unique<Job::Showing>(std::move(showing));
  join_ended_threads();
  {
    std::lock_guard lock(mutex);
    if (!has_memory_for(*job)) throw Error::failed("a frame to be shown: jobs that run have the memory");
    do job->id = new_job_id();
    while (jobs.contains(job->id));
    job->accepted = job->started = now();
    job->state = JobState::running;
    job->progress = FrameProgress(job->started);
    jobs[job->id] = job;
    order.push_back(job);
    running.push_back(job);
    if (!begin_frame(job)) {
      end_job(*job, JobState::failed, "no thread for it");
      throw Error::failed("a frame to be shown: no thread for it");
    }
  }
  const std::stop_callback cancelled(stop, [&] { farm.cancel(job->id); });
  std::unique_lock lock(mutex);
  job_changed.wait(lock, [&] { return ended(job->state) || stopping; });
  if (job->state == JobState::failed) throw Error::failed(job->message);
  if (job->state != JobState::done || !job->showing->film) return std::nullopt;
  return Picture{std::move(*job->showing->film), std::move(job->showing->report)};
}

void Farm::Impl::give_picture(Frame& frame, Film film) {
  std::lock_guard lock(mutex);
  if (frame.job->cancel) throw Cancelled{};
  frame.report.seconds = now() - frame.waited_from;
  frame.job->showing->film = std::move(film);
  frame.job->showing->report = frame.report;
}

}  // namespace gleaner::coordinator

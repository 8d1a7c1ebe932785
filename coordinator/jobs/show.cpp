// A frame for someone who waits for it: a job that is in no list, before all others.

#include <utility>

#include "coordinator/jobs/engine.h"
#include "coordinator/jobs/job_id.h"
#include "scene/model/error.h"

namespace gleaner::coordinator {

std::optional<Farm::Picture> Farm::show(const JobRequest& asked, const SceneSummary& shown,
                                        const std::stop_token& stop) {
  JobRequest request = asked;
  request.priority = most_priority;
  const std::shared_ptr<Job> job = impl_->accept(request);
  job->showing = std::make_unique<Job::Showing>(Job::Showing{.shown = shown, .film = std::nullopt});
  impl_->join_ended_threads();
  {
    std::lock_guard lock(impl_->mutex);
    if (!impl_->has_memory_for(*job)) throw Error::failed("a frame to be shown: jobs that run have the memory");
    do job->id = new_job_id();
    while (impl_->jobs.contains(job->id));
    job->accepted = job->started = impl_->now();
    job->state = JobState::running;
    job->progress = FrameProgress(job->started);
    impl_->jobs[job->id] = job;
    impl_->order.push_back(job);
    impl_->running.push_back(job);
    if (!impl_->begin_frame(job)) {
      impl_->end_job(*job, JobState::failed, "no thread for it");
      throw Error::failed("a frame to be shown: no thread for it");
    }
  }
  const std::stop_callback cancelled(stop, [&] { cancel(job->id); });
  std::unique_lock lock(impl_->mutex);
  impl_->job_changed.wait(lock, [&] { return ended(job->state) || impl_->stopping; });
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

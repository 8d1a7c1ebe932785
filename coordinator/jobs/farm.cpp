#include "coordinator/jobs/farm.h"

#include <chrono>
#include <utility>

#include "coordinator/jobs/engine.h"

namespace gleaner::coordinator {

namespace fs = std::filesystem;

namespace {

Seconds steady_seconds() {
  return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count();
}

}  // namespace

Farm::Impl::Impl(FarmSettings farm_settings, BlobStore& store)
    : settings(std::move(farm_settings)), blobs(store), scheduler(settings.scheduler) {
  if (!settings.clock) settings.clock = steady_seconds;
  if (!settings.plan)
    settings.plan = [](const FrameSettings& frame, const SceneSummary& scene) { return make_plan(frame, scene); };
  if (!settings.log) settings.log = [](const std::string&) {};
  timer = std::thread([this] { watch_clock(); });
}

Farm::Farm(FarmSettings settings, BlobStore& blobs) : impl_(std::make_unique<Impl>(std::move(settings), blobs)) {}

Farm::~Farm() {
  std::vector<std::shared_ptr<Job>> all;
  {
    std::lock_guard lock(impl_->mutex);
    impl_->stopping = true;
    for (auto& [id, job] : impl_->jobs) {
      job->cancel = true;
      job->events.notify_all();
      all.push_back(job);
    }
    impl_->timer_wakes.notify_all();
    impl_->timer_stops.notify_all();
    impl_->job_changed.notify_all();
  }
  for (auto& job : all)
    if (job->thread.joinable()) job->thread.join();
  impl_->timer.join();
}

std::optional<JobStatus> Farm::status(const std::string& id) const {
  std::lock_guard lock(impl_->mutex);
  auto job = impl_->find(id);
  if (!job) return std::nullopt;
  return status_of(*job, impl_->now());
}

std::vector<JobStatus> Farm::list() const {
  std::lock_guard lock(impl_->mutex);
  std::vector<JobStatus> all;
  for (const auto& id : impl_->order) all.push_back(status_of(*impl_->jobs.at(id), impl_->now()));
  return all;
}

std::optional<JobStatus> Farm::wait(const std::string& id, std::uint64_t seen, Seconds timeout) const {
  std::unique_lock lock(impl_->mutex);
  auto job = impl_->find(id);
  if (!job) return std::nullopt;
  impl_->job_changed.wait_for(lock, std::chrono::duration<double>(timeout),
                              [&] { return job->version > seen || ended(job->state) || impl_->stopping; });
  return status_of(*job, impl_->now());
}

std::optional<Film> Farm::preview(const std::string& id) {
  std::shared_ptr<Job> job;
  {
    std::lock_guard lock(impl_->mutex);
    job = impl_->find(id);
  }
  if (!job) return std::nullopt;
  std::lock_guard plan_lock(job->plan_mutex);
  if (!job->plan || !job->drawn) return std::nullopt;
  return job->plan->preview_film();
}

std::optional<std::vector<std::string>> Farm::why(const std::string& id) const {
  std::lock_guard lock(impl_->mutex);
  auto job = impl_->find(id);
  if (!job) return std::nullopt;
  std::vector<std::string> reasons;
  if (job->state == JobState::queued)
    reasons.push_back("the job waits until one of the " + std::to_string(impl_->settings.active_jobs) +
                      " that run has ended");
  if (job->state == JobState::running && impl_->workers.empty()) reasons.push_back("no worker is connected");
  for (const auto& stage : job->stages) {
    if (stage->delivered || !impl_->active_stages.count(stage->id)) continue;
    std::string reason = impl_->scheduler.why_waiting(stage->id, impl_->now());
    if (!reason.empty()) reasons.push_back("stage " + stage->spec.name + ": " + reason);
    if (!stage->last_failure.empty()) reasons.push_back("last failure: " + stage->last_failure);
  }
  return reasons;
}

std::vector<fs::path> Farm::files(const std::string& id) const {
  std::lock_guard lock(impl_->mutex);
  auto job = impl_->find(id);
  return job ? job->files : std::vector<fs::path>{};
}

}  // namespace gleaner::coordinator

#include "coordinator/jobs/farm.h"

#include <algorithm>
#include <chrono>
#include <mutex>
#include <thread>
#include <utility>

#include "coordinator/jobs/engine.h"

namespace gleaner::coordinator {

namespace fs = std::filesystem;

namespace {

constexpr Seconds usual_grace = 5;  // for a plan's call that runs when the farm ends
// A plan that takes records in gives way to a preview soon; one that computes may not.
constexpr int preview_tries = 25;
constexpr std::chrono::milliseconds preview_pause{2};

Seconds steady_seconds() {
  return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count();
}

}  // namespace

Farm::Impl::Impl(FarmSettings farm_settings, BlobStore& store)
    : settings(std::move(farm_settings)), blobs(store), scheduler(settings.scheduler) {
  if (!settings.clock) settings.clock = steady_seconds;
  if (!settings.check && settings.plan)
    settings.check = [](const FrameSettings&, const SceneSummary&) { return std::uint64_t{0}; };
  if (!settings.check)
    settings.check = [](const FrameSettings& frame, const SceneSummary& scene) {
      check_settings(frame, scene);
      return predicted_memory(frame, scene);
    };
  if (!settings.plan)
    settings.plan = [](const FrameSettings& frame, const SceneSummary& scene) { return make_plan(frame, scene); };
  if (!settings.start_thread)
    settings.start_thread = [](std::function<void()> what) { return std::thread(std::move(what)); };
  if (!settings.log) settings.log = [](const std::string&) {};
  timer = std::thread([this] { watch_clock(); });
}

Farm::Farm(FarmSettings settings, BlobStore& blobs) : impl_(std::make_shared<Impl>(std::move(settings), blobs)) {
  try {
    impl_->restore();
  } catch (...) {
    {
      std::lock_guard lock(impl_->mutex);
      impl_->stopping = true;
    }
    impl_->timer_wakes.notify_all();
    impl_->timer.join();
    throw;
  }
}

Farm::~Farm() {
  if (!end(usual_grace)) {
    std::lock_guard lock(impl_->mutex);
    for (auto& [frame, thread] : impl_->threads) thread.detach();
    impl_->threads.clear();
  }
  impl_->join_ended_threads();
  impl_->timer.join();
}

bool Farm::end(Seconds grace) {
  std::vector<JobRemains> remains;  // destroyed last
  std::unique_lock lock(impl_->mutex);
  impl_->stopping = true;
  for (const auto& job : impl_->order) {
    if (ended(job->state)) continue;
    if (impl_->stop_frames(*job) && job->state == JobState::running)
      remains.push_back(impl_->end_job(*job, JobState::cancelled, ""));
  }
  impl_->timer_wakes.notify_all();
  impl_->job_changed.notify_all();
  impl_->event_told.notify_all();
  impl_->records_ready.notify_all();
  const Seconds begun = steady_seconds();
  while (!impl_->threads.empty()) {
    const bool all_compute = std::all_of(impl_->threads.begin(), impl_->threads.end(),
                                         [](const auto& entry) { return entry.first->computing; });
    if (all_compute && steady_seconds() - begun >= grace) return false;
    impl_->thread_ended.wait_for(lock, std::chrono::milliseconds(20));
  }
  return true;
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
  for (const auto& job : impl_->order)
    if (!job->showing) all.push_back(status_of(*job, impl_->now()));
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

void Farm::Impl::tell(FarmEvent event) {
  // Frames that are shown come many a second, and are nobody else's.
  if (const auto job = find(event.job); job && job->showing) return;
  event_log.add(std::move(event));
  event_told.notify_all();
}

void Farm::Impl::tell_job(const Job& job, const std::string& what, const std::string& message) {
  tell({.kind = "job", .what = what, .job = job.id, .worker = {}, .message = message});
}

void Farm::Impl::tell_worker(const Worker& worker, const std::string& what, const std::string& message) {
  tell({.kind = "worker", .what = what, .job = {}, .worker = worker.name, .message = message});
}

std::vector<FarmEvent> Farm::events(std::uint64_t after, const std::string& job, Seconds timeout) const {
  std::unique_lock lock(impl_->mutex);
  impl_->event_told.wait_for(lock, std::chrono::duration<double>(timeout),
                             [&] { return impl_->event_log.last() > after || impl_->stopping; });
  return impl_->event_log.after(after, job);
}

std::uint64_t Farm::last_event() const {
  std::lock_guard lock(impl_->mutex);
  return impl_->event_log.last();
}

std::optional<Film> Farm::preview(const std::string& id, bool guides) {
  std::shared_ptr<Job> job;
  {
    std::lock_guard lock(impl_->mutex);
    job = impl_->find(id);
  }
  if (!job) return std::nullopt;
  std::vector<std::shared_ptr<Frame>> frames;
  {
    std::lock_guard lock(impl_->mutex);
    for (const auto& [place, frame] : job->frames) frames.push_back(frame);
  }
  for (int tried = 0; tried < preview_tries; ++tried) {
    if (tried > 0) std::this_thread::sleep_for(preview_pause);
    bool all_seen = true;
    for (const auto& frame : frames) {
      const std::unique_lock plan_lock(frame->plan_mutex, std::try_to_lock);
      all_seen = all_seen && plan_lock;
      if (plan_lock && frame->plan && frame->drawn) return frame->plan->preview_film(guides);
    }
    if (all_seen) break;
  }
  return std::nullopt;
}

std::optional<std::vector<std::string>> Farm::why(const std::string& id) const {
  std::lock_guard lock(impl_->mutex);
  auto job = impl_->find(id);
  if (!job) return std::nullopt;
  std::vector<std::string> reasons;
  if (job->state == JobState::queued) reasons.push_back(impl_->why_queued(*job));
  if (job->state == JobState::running && job->paused) return std::vector{impl_->why_queued(*job)};
  if (job->state == JobState::running && impl_->workers.empty()) reasons.push_back("no worker is connected");
  // Of a stage of another job, the job too.
  const Scheduler::Names names{[&](WorkerId worker) { return impl_->name_of(worker); },
                               [&](StageId stage) {
                                 const auto found = impl_->active_stages.find(stage);
                                 if (found == impl_->active_stages.end()) return std::string("that ends");
                                 const Job& of = *found->second->frame->job;
                                 return found->second->spec.name + (&of == job.get() ? "" : " of job " + of.id);
                               }};
  std::size_t compared = 0;
  for (const auto& [place, frame] : job->frames) {
    compared += frame->rechecks.size();
    const std::string which =
        job->frames.size() > 1 ? "frame " + std::to_string(frame_at(job->request, frame->place)) + ", " : "";
    if (!frame->full_disk.empty()) reasons.push_back(which + "it is whole, and waits for room: " + frame->full_disk);
    for (const auto& stage : frame->stages) {
      if (stage->delivered || !impl_->active_stages.count(stage->id)) continue;
      std::string reason = impl_->scheduler.why_waiting(stage->id, impl_->now(), names);
      if (!reason.empty()) reasons.push_back(which + "stage " + stage->spec.name + ": " + reason);
      if (!stage->last_failure.empty()) reasons.push_back("last failure: " + stage->last_failure);
    }
  }
  if (compared > 0)
    reasons.push_back(std::to_string(compared) + " batches are computed a second time, to compare workers");
  if (job->state == JobState::running)
    for (const auto& [worker_id, worker] : impl_->workers)
      if (!worker.aside.empty()) reasons.push_back("worker " + worker.name + " is put aside: " + worker.aside);
  return reasons;
}

std::vector<fs::path> Farm::files(const std::string& id) const {
  std::vector<std::uint32_t> frames;
  {
    std::lock_guard lock(impl_->mutex);
    auto job = impl_->find(id);
    if (!job) return {};
    for (const auto& [first, last] : job->written.ranges())
      for (std::uint64_t place = first; place <= last; ++place) frames.push_back(frame_at(job->request, place));
  }
  std::vector<fs::path> files;
  for (const std::uint32_t frame : frames) {
    const FramePaths paths = impl_->settings.paths(id, frame);
    for (const fs::path& path : {paths.exr, paths.png, paths.report})
      if (!path.empty()) files.push_back(path);
  }
  return files;
}

}  // namespace gleaner::coordinator

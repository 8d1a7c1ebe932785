// Jobs from submission to their end: who runs next, and what remains of one that ended.

#include <algorithm>
#include <cstdlib>
#include <functional>
#include <iterator>
#include <utility>

#include "coordinator/blobs/sha256.h"
#include "coordinator/jobs/engine.h"
#include "coordinator/jobs/job_id.h"
#include "coordinator/jobs/request_codec.h"
#include "coordinator/journal/journal_writer.h"
#include "coordinator/plan/trajectory.h"
#include "scene/model/error.h"

namespace gleaner::coordinator {

namespace {

// Over which a job's rate is taken: frames are uneven.
constexpr Seconds job_rate_window = 60;

// Tells requests apart: all that was asked, the ids of scenes included.
std::string content_of(JobRequest request) {
  request.owner.clear();  // whoever asks
  Bytes bytes = encode_request(request);
  const Bytes frames = encode_frames(request);
  bytes.insert(bytes.end(), frames.begin(), frames.end());
  return sha256_hex(bytes);
}

std::string gibibytes(std::uint64_t bytes) {
  char text[32];
  std::snprintf(text, sizeof text, "%.2f GiB", static_cast<double>(bytes) / (std::uint64_t{1} << 30));
  return text;
}

}  // namespace

void Farm::Impl::changed(Job& job) {
  ++job.version;
  job_changed.notify_all();
}

std::shared_ptr<Job> Farm::Impl::find(const std::string& id) const {
  auto found = jobs.find(id);
  return found == jobs.end() ? nullptr : found->second;
}

// A frame of a scene that moves holds its base and, while it is summarized, a posed copy.
std::uint64_t Farm::Impl::posing_memory(const JobRequest& request) {
  std::set<std::string> bases;  // one, as a rule, of as many frames as there may be
  for (const FrameScene& scene : request.scenes)
    if (!scene.state_blob.empty()) bases.insert(scene.scene_blob);
  std::uint64_t largest = 0;
  for (const std::string& id : bases)
    if (const auto base = blobs.source(id)) largest = std::max(largest, base->bytes());
  return 2 * largest;
}

std::shared_ptr<Job> Farm::Impl::accept(const JobRequest& request) {
  const std::string frames = std::to_string(request.first_frame) + "-" + std::to_string(request.last_frame);
  if (request.frame_step == 0 || request.last_frame < request.first_frame || frames_of(request) > most_frames)
    throw Error::usage("frames " + frames + ": expected first <= last, and at most " + std::to_string(most_frames) +
                       " frames");
  if (std::adjacent_find(request.numbers.begin(), request.numbers.end(), std::greater_equal<>()) !=
      request.numbers.end())
    throw Error::usage("frame numbers: expected each to be larger than the one before");
  if (std::abs(request.priority) > most_priority)
    throw Error::usage("priority: expected -1000 to 1000, found " + std::to_string(request.priority));
  if (!request.cameras.empty() && request.cameras.size() != frames_of(request))
    throw Error::usage("cameras: expected one for each of " + std::to_string(frames_of(request)) + " frames, found " +
                       std::to_string(request.cameras.size()));
  if (request.scenes.size() != 1 && request.scenes.size() != frames_of(request))
    throw Error::usage("scenes: expected one, or one for each of " + std::to_string(frames_of(request)) +
                       " frames, found " + std::to_string(request.scenes.size()));
  for (const FrameScene& scene : request.scenes)
    for (const std::string& id : {scene.scene_blob, scene.bvh_blob, scene.state_blob})
      if (!id.empty() && !blobs.has(id) && !blobs.source(id))  // lent ones are there as well
        throw Error::bad_input("blob " + id, "", "to be uploaded first");
  auto job = std::make_shared<Job>();
  job->request = request;
  std::vector<FrameScene>& scenes = job->request.scenes;
  for (FrameScene& scene : scenes) scene.summary.lineage = scene.scene_blob;
  if (std::all_of(scenes.begin(), scenes.end(),
                  [&](const FrameScene& scene) { return blobs_of(scene) == blobs_of(scenes.front()); }))
    scenes.resize(1);
  // What a trajectory's frames share is made for one scene.
  if (!request.cameras.empty() && scenes.size() == 1) job->request.settings.trajectory = trajectory_of(request.cameras);
  job->memory = settings.check(settings_of(job->request, 0), request.scenes.front().summary) + posing_memory(request);
  if (job->memory > settings.memory_bytes)
    throw Error::usage("a frame of " + std::to_string(request.settings.width) + "x" +
                       std::to_string(request.settings.height) + " pixels by " + request.settings.method + " needs " +
                       gibibytes(job->memory) + " of the coordinator's memory, of which it may take " +
                       gibibytes(settings.memory_bytes));
  job->submitted_unix_seconds = unix_now();
  return job;
}

bool Farm::Impl::has_memory_for(const Job& job) const {
  return job.memory <= settings.memory_bytes - std::min(settings.memory_bytes, memory_taken);
}

void Farm::Impl::put_in_queue(const std::shared_ptr<Job>& job) {
  const auto behind = std::find_if(queue.begin(), queue.end(),
                                   [&](const auto& other) { return other->request.priority < job->request.priority; });
  queue.insert(behind, job);
}

std::shared_ptr<Job> Farm::Impl::awaited(const Job& job) const {
  for (const std::string& id : job.request.after)
    if (auto other = find(id); other && other->state != JobState::done) return other;
  return nullptr;
}

bool Farm::Impl::is_awaited(const std::string& id) const {
  return std::any_of(queue.begin(), queue.end(), [&](const auto& job) {
    return std::find(job->request.after.begin(), job->request.after.end(), id) != job->request.after.end();
  });
}

std::shared_ptr<Job> Farm::Impl::next_queued() const {
  const auto next =
      std::find_if(queue.begin(), queue.end(), [&](const auto& job) { return !job->paused && !awaited(*job); });
  return next == queue.end() ? nullptr : *next;
}

std::size_t Farm::Impl::active() const {
  return static_cast<std::size_t>(
      std::count_if(running.begin(), running.end(), [](const auto& job) { return !job->paused && !job->showing; }));
}

void Farm::Impl::start_queued() {
  while (active() < settings.active_jobs && !stopping) {
    const std::shared_ptr<Job> job = next_queued();
    // The first in the queue is not overtaken, or a large one would wait for ever.
    if (!job || !has_memory_for(*job)) return;
    std::erase(queue, job);
    running.push_back(job);
    job->state = JobState::running;
    if (job->frames_over() == 0 && job->started == 0) tell_job(*job, "started");
    job->started = now();
    job->progress = FrameProgress(job->started, static_cast<double>(job->frames_over()), job_rate_window);
    update_progress(*job, job->started);
    changed(*job);
    if (begin_frame(job)) continue;
    if (job->frames_over() < frames_of(job->request)) {
      wait_again(job);
      return;
    }
    // The coordinator before this one died when all frames were over.
    const bool failed = job->failed.count() > 0;
    end_job(*job, failed ? JobState::failed : JobState::done, failed ? failures_of(*job) : "");
  }
}

std::string Farm::Impl::why_queued(const Job& job) const {
  if (job.paused) return "the job is paused: `gleaner resume " + job.id + "`";
  if (const auto other = awaited(job)) {
    if (!ended(other->state)) return "it waits until job " + other->id + " is done";
    return "it waits until job " + other->id + " is done, which " +
           (other->state == JobState::failed ? "failed" : "was cancelled") + ": `gleaner retry " + other->id +
           "` renders what is missing";
  }
  if (next_queued().get() == &job && active() < settings.active_jobs && !has_memory_for(job))
    return "the job waits for memory: it needs " + gibibytes(job.memory) + ", and of the " +
           gibibytes(settings.memory_bytes) + " that there may be, jobs that run have " + gibibytes(memory_taken);
  return "the job waits until one of the " + std::to_string(settings.active_jobs) + " that run has ended";
}

JobRemains Farm::Impl::end_job(Job& job, JobState state, const std::string& message) {
  JobRemains remains;
  for (const auto& [place, frame] : std::exchange(job.frames, {})) {
    for (const auto& stage : frame->stages) job.last_stages.push_back(status_of(*stage, now()));
    JobRemains of_frame = withdraw(*frame);
    std::move(frame->stages.begin(), frame->stages.end(), std::back_inserter(of_frame.stages));
    frame->stages.clear();
    remains.frames.push_back(std::move(of_frame));
  }
  std::erase_if(running, [&](const auto& other) { return other.get() == &job; });
  job.state = state;
  job.message = message;
  job.ended = now();
  remains.cameras = std::exchange(job.request.cameras, {});
  remains.scenes = std::exchange(job.request.scenes, {});
  job.request.settings.trajectory = {};
  // What a farm that ends stops goes on with the next one.
  if (!stopping || state != JobState::cancelled) {
    journal_changed(job, state);
    forget_records(job);
    tell_job(job, job_state_name(state), message);
  }
  changed(job);
  if (job.showing) {
    std::erase_if(order, [&](const auto& other) { return other.get() == &job; });
    jobs.erase(job.id);
  } else {
    settings.log("job " + job.id + " " + job_state_name(state) + (message.empty() ? "" : ": " + message));
    ended_jobs.push_back(jobs.at(job.id));
    forget_ended();
  }
  start_queued();
  return remains;
}

bool Farm::Impl::stop_frames(Job& job) {
  job.cancel = true;
  bool computes = false;
  for (const auto& [place, frame] : job.frames) {
    frame->events.notify_all();
    computes = computes || frame->computing;
  }
  return computes;
}

void Farm::Impl::forget_ended() {
  while (!ended_jobs.empty() &&
         (ended_jobs.size() > settings.ended_jobs || now() - ended_jobs.front()->ended > settings.ended_seconds)) {
    if (is_awaited(ended_jobs.front()->id)) return;
    if (settings.journal) settings.journal->forget(ended_jobs.front()->id);
    request_ids.erase(ended_jobs.front()->request.request_id);
    order.remove(ended_jobs.front());
    jobs.erase(ended_jobs.front()->id);
    ended_jobs.pop_front();
  }
}

void Farm::Impl::join_ended_threads() {
  std::vector<std::thread> ended;
  {
    std::lock_guard lock(mutex);
    ended.swap(ended_threads);
  }
  for (std::thread& thread : ended) thread.join();
}

std::shared_ptr<Job> Farm::Impl::submitted_before(const JobRequest& request) const {
  const auto known = request_ids.find(request.request_id);
  if (request.request_id.empty() || known == request_ids.end()) return nullptr;
  const std::shared_ptr<Job> job = find(known->second);
  if (job && job->request.content != request.content)
    throw Error::usage("request id \"" + request.request_id + "\": job " + job->id +
                       " was submitted with it, and is another scene or has other settings");
  return job;
}

void Farm::Impl::check_jobs_of(const std::string& owner) const {
  if (settings.jobs_an_owner == 0 || owner.empty()) return;
  const auto waiting =
      static_cast<std::size_t>(std::count_if(order.begin(), order.end(), [&](const std::shared_ptr<Job>& job) {
        return !ended(job->state) && job->request.owner == owner;
      }));
  if (waiting >= settings.jobs_an_owner)
    throw LimitReached(owner + " has " + std::to_string(waiting) +
                       " jobs that run or wait, which is this coordinator's limit: try again when one has ended");
}

std::string Farm::submit(const JobRequest& submitted) {
  JobRequest request = submitted;
  std::unique_lock<std::mutex> one_at_a_time;
  if (!request.request_id.empty()) {
    one_at_a_time = std::unique_lock(impl_->request_ids_mutex);
    request.content = content_of(request);
    std::lock_guard lock(impl_->mutex);
    if (const auto job = impl_->submitted_before(request)) return job->id;
  }
  std::shared_ptr<Job> job = impl_->accept(request);
  impl_->join_ended_threads();
  std::unique_lock lock(impl_->mutex);
  if (const auto [working, able] = impl_->denoisers();
      request.settings.denoise != Denoise::off && working > 0 && able == 0)
    throw Error::usage("--denoise: none of " + std::to_string(working) +
                       " workers has Open Image Denoise 2: run ./farm denoiser where they are, or set GLEANER_OIDN, "
                       "and start them again");
  for (const std::string& other : request.after)
    if (!impl_->find(other)) throw Error::usage("no job " + other + ", after which it is to begin");
  impl_->check_jobs_of(request.owner);
  do job->id = new_job_id();
  while (impl_->jobs.count(job->id));
  job->accepted = impl_->now();
  lock.unlock();
  impl_->journal_added(*job);
  lock.lock();
  impl_->jobs[job->id] = job;
  if (!request.request_id.empty()) impl_->request_ids[request.request_id] = job->id;
  impl_->order.push_back(job);
  impl_->put_in_queue(job);
  impl_->settings.log("job " + job->id + " accepted: " + request.scene_name + ", " + request.settings.method + ", " +
                      std::to_string(request.settings.width) + "x" + std::to_string(request.settings.height));
  impl_->tell_job(*job, "submitted");
  impl_->forget_ended();
  impl_->start_queued();
  return job->id;
}

std::optional<JobStatus> Farm::pause(const std::string& id, bool paused) {
  std::lock_guard lock(impl_->mutex);
  auto job = impl_->find(id);
  if (!job) return std::nullopt;
  if (ended(job->state) || job->cancel || job->paused == paused) return status_of(*job, impl_->now());
  job->paused = paused;
  if (paused) job->paused_since = impl_->now();
  for (const auto& [place, frame] : job->frames) {
    if (!paused) frame->begun += impl_->now() - job->paused_since;  // its time limit does not run meanwhile
    for (const auto& stage : frame->stages)
      if (!stage->delivered) impl_->settle_pause(*stage);
    frame->events.notify_all();
  }
  impl_->journal_changed(*job, job->state);
  impl_->settings.log("job " + id + (paused ? " paused" : " resumed"));
  impl_->tell_job(*job, paused ? "paused" : "resumed");
  impl_->changed(*job);
  impl_->start_queued();
  return status_of(*job, impl_->now());
}

std::optional<JobStatus> Farm::retry(const std::string& id) {
  std::unique_lock lock(impl_->mutex);
  const std::shared_ptr<Job> old = impl_->find(id);
  if (!old) return std::nullopt;
  if (old->state != JobState::failed && old->state != JobState::cancelled)
    throw Error::usage("job " + id + " is " + job_state_name(old->state) + ": only what failed or was cancelled " +
                       "can be tried again");
  JobRequest request = old->request;
  impl_->check_jobs_of(request.owner);
  lock.unlock();
  decode_frames(impl_->journal_frames(*old), request);
  // A job of its own: a plan of the old one may still compute.
  const std::shared_ptr<Job> job = impl_->accept(request);
  job->id = id;
  job->submitted_unix_seconds = old->submitted_unix_seconds;
  job->accepted = old->accepted;
  job->worker_seconds = old->worker_seconds;
  job->rays = old->rays;
  job->written = old->written;
  impl_->journal_retry(*job);
  lock.lock();
  if (impl_->find(id) != old) throw Error::failed("job " + id + " was tried again or forgotten meanwhile");
  job->version = old->version + 1;
  std::erase(impl_->ended_jobs, old);
  std::replace(impl_->order.begin(), impl_->order.end(), old, job);
  impl_->jobs[id] = job;
  impl_->put_in_queue(job);
  impl_->settings.log("job " + id + " is tried again");
  impl_->tell_job(*job, "retried");
  impl_->changed(*job);
  impl_->start_queued();
  return status_of(*job, impl_->now());
}

std::optional<JobStatus> Farm::cancel(const std::string& id) {
  JobRemains remains;  // destroyed last
  std::lock_guard lock(impl_->mutex);
  auto job = impl_->find(id);
  if (!job) return std::nullopt;
  if (job->state == JobState::queued) {
    std::erase(impl_->queue, job);
    remains = impl_->end_job(*job, JobState::cancelled, "");
  } else if (job->state == JobState::running) {
    impl_->journal_changed(*job, JobState::cancelled);
    // Nobody knows how long a plan computes: the job ends now, and that frame's thread when the plan has returned.
    if (impl_->stop_frames(*job))
      remains = impl_->end_job(*job, JobState::cancelled, "");
    else
      impl_->changed(*job);
  }
  return status_of(*job, impl_->now());
}

}  // namespace gleaner::coordinator

// What the journal is told of jobs, and how they come back from it.

#include <algorithm>
#include <chrono>
#include <utility>

#include "coordinator/jobs/engine.h"
#include "coordinator/jobs/request_codec.h"
#include "coordinator/journal/journal_writer.h"
#include "scene/model/error.h"

namespace gleaner::coordinator {

namespace {

constexpr const char* paused_word = "paused";  // a state of the journal's alone: queued, until it is resumed

double unix_seconds() {
  return std::chrono::duration<double>(std::chrono::system_clock::now().time_since_epoch()).count();
}

JobState state_of(const std::string& word) {
  for (const JobState state : {JobState::done, JobState::failed, JobState::cancelled})
    if (word == job_state_name(state)) return state;
  return JobState::queued;
}

JournalJob entry_of(const Job& job, JobState state, Seconds ended_seconds) {
  return {.id = job.id,
          .state = ended(state) ? job_state_name(state)
                   : job.paused ? paused_word
                                : job_state_name(JobState::queued),
          .message = job.message,
          .submitted = job.submitted_unix_seconds,
          .ended = ended(state) ? job.submitted_unix_seconds + ended_seconds : 0,
          .worker_seconds = job.worker_seconds,
          .rays = job.rays,
          .request = {}};
}

}  // namespace

void Farm::Impl::journal_added(const Job& job) {
  if (!settings.journal) return;
  JournalJob entry = entry_of(job, job.state, 0);
  entry.request = encode_request(job.request);
  settings.journal->add(entry, encode_frames(job.request));
}

void Farm::Impl::journal_changed(const Job& job, JobState state) {
  if (JournalWriter* journal = journal_of(job)) journal->changed(entry_of(job, state, now() - job.accepted));
}

Bytes Farm::Impl::journal_frames(const Job& job) const {
  if (!settings.journal) throw Error::failed("job " + job.id + ": without a journal nothing is known of it any more");
  return settings.journal->frames(job.id);
}

void Farm::Impl::journal_retry(const Job& job) { settings.journal->retry(entry_of(job, JobState::queued, 0)); }

void Farm::Impl::restore() {
  if (!settings.journal) return;
  const std::vector<JournalJob> entries = settings.journal->jobs();
  std::size_t waiting = 0;
  std::set<std::string> kept_records;
  JobRemains remains;  // destroyed last
  std::unique_lock lock(mutex);
  for (const JournalJob& entry : entries) {
    lock.unlock();
    std::string failure;
    const std::shared_ptr<Job> job = restored(entry, failure);
    lock.lock();
    jobs[job->id] = job;
    order.push_back(job);
    if (!job->request.request_id.empty()) request_ids[job->request.request_id] = job->id;
    if (ended(job->state)) {
      ended_jobs.push_back(job);
    } else if (!failure.empty()) {
      remains = end_job(*job, JobState::failed, failure);
    } else {
      ++waiting;
      job->restored = true;
      kept_records.insert(job->id);
      put_in_queue(job);
    }
  }
  std::stable_sort(ended_jobs.begin(), ended_jobs.end(),
                   [](const auto& a, const auto& b) { return a->ended < b->ended; });
  if (!entries.empty())
    settings.log("journal " + settings.journal->name() + ": " + std::to_string(entries.size()) + " jobs, of which " +
                 std::to_string(waiting) + " go on");
  forget_ended();
  lock.unlock();
  drop_left_records(kept_records);
  lock.lock();
  start_queued();
}

std::shared_ptr<Job> Farm::Impl::restored(const JournalJob& entry, std::string& failure) {
  auto job = std::make_shared<Job>();
  const JobState state = state_of(entry.state);
  try {
    JobRequest request = decode_request(entry.request);
    if (ended(state)) {
      job->request = std::move(request);
    } else {
      job->request = request;  // for lists, whatever becomes of the rest
      decode_frames(settings.journal->frames(entry.id), request);
      job = accept(request);
    }
  } catch (const std::exception& error) {
    failure = error.what();
  }
  job->id = entry.id;
  job->state = state;
  job->message = entry.message;
  job->paused = entry.state == paused_word;
  job->worker_seconds = entry.worker_seconds;
  job->rays = entry.rays;
  job->submitted_unix_seconds = entry.submitted;
  for (const JournalFrame& frame : settings.journal->frames_over(entry.id)) {
    // Of a job whose request cannot be read, the single frame is all that is known.
    if (frame.frame >= frames_of(job->request)) continue;
    (frame.failure.empty() ? job->written : job->failed).insert(frame.frame);
    if (!frame.failure.empty() && job->failures.size() < most_failures)
      job->failures.emplace_back(frame.frame, frame.failure);
  }
  job->accepted = now() - std::max(0.0, unix_seconds() - entry.submitted);
  if (ended(state)) job->ended = job->accepted + std::max(0.0, entry.ended - entry.submitted);
  return job;
}

}  // namespace gleaner::coordinator

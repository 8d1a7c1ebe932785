#include "coordinator/journal/journal_writer.h"

#include <algorithm>
#include <chrono>
#include <iterator>
#include <utility>

#include "scene/model/error.h"

namespace gleaner::coordinator {

namespace {

using std::chrono::duration;
using std::chrono::milliseconds;

constexpr milliseconds gather{200};  // ranges that were accepted within it are written together
constexpr milliseconds first_wait{1000}, longest_wait{30000};
// While the journal cannot be written: what is not remembered is computed again after a restart.
constexpr std::size_t most_ranges = 65536;

}  // namespace

JournalWriter::JournalWriter(std::unique_ptr<Journal> journal, std::function<void(const std::string&)> log)
    : journal_(std::move(journal)), name_(journal_->name()), log_(std::move(log)) {
  if (!log_) log_ = [](const std::string&) {};
  thread_ = std::thread([this] { run(); });
}

JournalWriter::~JournalWriter() {
  {
    std::lock_guard lock(mutex_);
    ending_ = true;
  }
  wakes_.notify_all();
  thread_.join();
}

std::uint64_t JournalWriter::begin() {
  std::lock_guard lock(journal_mutex_);
  return journal_->begin();
}

std::vector<JournalJob> JournalWriter::jobs() {
  std::lock_guard lock(journal_mutex_);
  return journal_->jobs();
}

Bytes JournalWriter::frames(const std::string& job) {
  std::lock_guard lock(journal_mutex_);
  return journal_->frames(job);
}

std::vector<JournalFrame> JournalWriter::frames_over(const std::string& job) {
  std::lock_guard lock(journal_mutex_);
  return journal_->frames_over(job);
}

std::vector<JournalRange> JournalWriter::ranges(const std::string& job, std::uint64_t frame) {
  std::lock_guard lock(journal_mutex_);
  return journal_->ranges(job, frame);
}

void JournalWriter::add(const JournalJob& job, const Bytes& frames) {
  std::lock_guard lock(journal_mutex_);
  journal_->add(job, frames);
}

void JournalWriter::retry(const JournalJob& job) {
  if (!flush()) throw Error::failed(trouble());
  JournalChanges changes;
  changes.jobs[job.id] = job;
  changes.retried.insert(job.id);
  std::lock_guard lock(journal_mutex_);
  journal_->write(changes);
}

void JournalWriter::changed(JournalJob job) {
  {
    std::lock_guard lock(mutex_);
    changes_.jobs[job.id] = std::move(job);
    urgent_ = true;
  }
  wakes_.notify_all();
}

void JournalWriter::forget(const std::string& job) {
  std::lock_guard lock(mutex_);
  changes_.jobs.erase(job);
  changes_.forgotten.push_back(job);
  wakes_.notify_all();
}

void JournalWriter::accepted(JournalRange range) {
  std::lock_guard lock(mutex_);
  if (changes_.ranges.size() >= most_ranges) return;
  changes_.ranges.push_back(std::move(range));
  if (changes_.ranges.size() == 1) wakes_.notify_all();
}

void JournalWriter::frame_over(JournalFrame frame, std::function<void()> then) {
  frame_begins_again(frame.job, frame.frame);
  std::lock_guard lock(mutex_);
  changes_.frames_over.push_back(std::move(frame));
  then_.push_back(std::move(then));
  urgent_ = true;
  wakes_.notify_all();
}

void JournalWriter::frame_begins_again(const std::string& job, std::uint64_t frame) {
  std::lock_guard lock(mutex_);
  std::erase_if(changes_.ranges, [&](const JournalRange& range) { return range.job == job && range.frame == frame; });
  changes_.dropped_frames.insert({job, frame});
  wakes_.notify_all();
}

void JournalWriter::job_over(const std::string& job, std::function<void()> then) {
  std::lock_guard lock(mutex_);
  std::erase_if(changes_.ranges, [&](const JournalRange& range) { return range.job == job; });
  changes_.dropped_jobs.insert(job);
  then_.push_back(std::move(then));
  wakes_.notify_all();
}

bool JournalWriter::flush() {
  std::unique_lock lock(mutex_);
  urgent_ = true;
  wakes_.notify_all();
  written_.wait(lock, [&] { return (changes_.empty() && !writing_) || !trouble_.empty(); });
  return trouble_.empty();
}

std::string JournalWriter::trouble() const {
  std::lock_guard lock(mutex_);
  return trouble_;
}

void JournalWriter::run() {
  milliseconds wait = first_wait;
  std::unique_lock lock(mutex_);
  for (;;) {
    wakes_.wait(lock, [&] { return ending_ || !changes_.empty(); });
    if (!trouble_.empty())
      wakes_.wait_for(lock, wait, [&] { return ending_; });
    else
      wakes_.wait_for(lock, gather, [&] { return ending_ || urgent_; });
    if (changes_.empty()) {
      if (ending_) return;
      continue;
    }
    const bool last = ending_;
    JournalChanges changes = std::exchange(changes_, {});
    std::vector<std::function<void()>> then = std::exchange(then_, {});
    urgent_ = false;
    writing_ = true;
    lock.unlock();
    std::string failure;
    try {
      std::lock_guard journal_lock(journal_mutex_);
      journal_->write(changes);
    } catch (const std::exception& error) {
      failure = error.what();
    }
    if (failure.empty())
      for (const auto& call : then) call();
    lock.lock();
    if (failure.empty()) {
      if (!trouble_.empty()) log_("journal " + name_ + ": it is written again");
      wait = first_wait;
    } else {
      if (trouble_ != failure) log_(failure + "; jobs go on, and what happens meanwhile may be lost with this process");
      wait = trouble_.empty() ? first_wait : std::min(2 * wait, longest_wait);
      merge_back(std::move(changes));
      then.insert(then.end(), then_.begin(), then_.end());
      then_ = std::move(then);
    }
    trouble_ = std::move(failure);
    writing_ = false;
    written_.notify_all();
    if (last) return;
  }
}

// Mutex held. What has happened meanwhile is newer.
void JournalWriter::merge_back(JournalChanges&& unwritten) {
  for (auto& [id, job] : unwritten.jobs) changes_.jobs.emplace(id, std::move(job));
  for (const std::string& id : changes_.forgotten) changes_.jobs.erase(id);
  changes_.forgotten.insert(changes_.forgotten.begin(), unwritten.forgotten.begin(), unwritten.forgotten.end());
  changes_.frames_over.insert(changes_.frames_over.begin(), std::make_move_iterator(unwritten.frames_over.begin()),
                              std::make_move_iterator(unwritten.frames_over.end()));
  for (auto& range : unwritten.ranges) {
    if (changes_.ranges.size() < most_ranges && !changes_.dropped_jobs.contains(range.job) &&
        !changes_.dropped_frames.contains({range.job, range.frame}))
      changes_.ranges.push_back(std::move(range));
  }
  changes_.dropped_frames.merge(unwritten.dropped_frames);
  changes_.dropped_jobs.merge(unwritten.dropped_jobs);
}

}  // namespace gleaner::coordinator

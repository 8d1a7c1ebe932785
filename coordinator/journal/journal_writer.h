#pragma once
// Writes a journal beside the farm's work: what changes is gathered and written a few times a second, by a thread of
// its own. While the journal cannot be written, jobs go on; it is tried again, with growing waits.

#include <condition_variable>
#include <functional>
#include <memory>
#include <mutex>
#include <string>
#include <thread>

#include "coordinator/journal/journal.h"

namespace gleaner::coordinator {

class JournalWriter {
 public:
  JournalWriter(std::unique_ptr<Journal> journal, std::function<void(const std::string&)> log);
  ~JournalWriter();  // writes what there is to write, if it can
  JournalWriter(const JournalWriter&) = delete;
  JournalWriter& operator=(const JournalWriter&) = delete;

  std::string name() const { return name_; }
  // These wait for the journal, and throw as its calls do.
  std::uint64_t begin();
  std::vector<JournalJob> jobs();
  Bytes frames(const std::string& job);
  std::vector<JournalFrame> frames_over(const std::string& job);
  std::vector<JournalRange> ranges(const std::string& job, std::uint64_t frame);
  void add(const JournalJob& job, const Bytes& frames);
  void retry(const JournalJob& job);  // what had ended waits again, and its failed frames are forgotten

  // These return at once. What happened to a job later replaces what happened before.
  void changed(JournalJob job);
  void forget(const std::string& job);
  void accepted(JournalRange range);
  // Its ranges are needed no more. Once that is written, `then` is called by the writer's thread.
  void frame_over(JournalFrame frame, std::function<void()> then);
  void frame_begins_again(const std::string& job, std::uint64_t frame);  // its ranges so far are needed no more
  void job_over(const std::string& job, std::function<void()> then);     // as frame_over(), for all its ranges

  // Waits until what has happened so far is written; false: it cannot be, trouble() says why.
  bool flush();
  // Why the last write failed; empty: it did not.
  std::string trouble() const;

 private:
  void run();
  void merge_back(JournalChanges&& unwritten);

  std::unique_ptr<Journal> journal_;
  const std::string name_;
  std::function<void(const std::string&)> log_;
  std::mutex journal_mutex_;  // taken before the other one where both are held

  mutable std::mutex mutex_;  // guards what follows
  std::condition_variable wakes_, written_;
  JournalChanges changes_;
  std::vector<std::function<void()>> then_;
  std::string trouble_;
  bool urgent_ = false;  // what people may ask for after a restart
  bool ending_ = false;
  bool writing_ = false;
  std::thread thread_;
};

}  // namespace gleaner::coordinator

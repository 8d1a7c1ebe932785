// `gleaner watch`: follows a job to its end.

#include "cli/watch.h"

#include <CLI/CLI.hpp>
#include <algorithm>
#include <chrono>
#include <condition_variable>
#include <iostream>
#include <memory>
#include <mutex>
#include <span>
#include <thread>
#include <utility>

#include "cli/call_again.h"
#include "cli/client.h"
#include "cli/commands.h"
#include "cli/progress.h"
#include "cli/status_words.h"
#include "coordinator/gateway/status_json.h"
#include "proto/atomic_file.h"
#include "scene/model/error.h"
#include "scene/model/names.h"

namespace gleaner::cli {

using coordinator::JobStatus;

namespace {

using Clock = std::chrono::steady_clock;

constexpr std::chrono::milliseconds preview_interval{700};  // it must be fresh at least once a second
constexpr std::chrono::seconds tell_interval{1};            // of frames that were written
constexpr std::chrono::seconds stall{5};                    // without an item done, before it is asked why

// Keeps a file up to date with the job's preview, beside the stream of progress.
class PreviewFile {
 public:
  explicit PreviewFile(const WatchOptions& options)
      : client_(options.coordinator),
        job_(options.job),
        path_(options.preview),
        denoise_(options.denoise),
        thread_([this] { refresh(); }) {}

  ~PreviewFile() { stop(); }

  // The last picture: the finished one where there is one. Throws what writing or calling threw.
  void finish() {
    stop();
    if (error_) std::rethrow_exception(error_);
    write();
  }

 private:
  void stop() {
    {
      std::lock_guard lock(mutex_);
      ended_ = true;
    }
    end_.notify_all();
    if (thread_.joinable()) thread_.join();
  }

  void refresh() {
    try {
      std::unique_lock lock(mutex_);
      while (!ended_) {
        lock.unlock();
        try {
          write();
        } catch (const Error& error) {
          // Who watches the job sees it too, says it, and calls again.
          if (error.kind() != ErrorKind::connection) throw;
        }
        lock.lock();
        end_.wait_for(lock, preview_interval, [&] { return ended_; });
      }
    } catch (...) {
      error_ = std::current_exception();
    }
  }

  void write() {
    std::string png = client_.preview(job_, denoise_);
    if (!png.empty() && png != last_) write_atomically(path_, std::as_bytes(std::span(png)));
    last_ = std::move(png);
  }

  Client client_;
  std::string job_, path_;
  const bool denoise_;
  std::string last_;
  std::mutex mutex_;
  std::condition_variable end_;
  bool ended_ = false;
  std::exception_ptr error_;
  std::thread thread_;
};

// Follows the job on standard error, and on standard output where that is JSON.
class Watch {
 public:
  explicit Watch(const WatchOptions& options)
      : options_(options), client_(options.coordinator), progress_(options.quiet || options.json) {
    client_.show(options.job);  // an unknown job is told before any file is made
  }

  // Until the job has ended. A coordinator that goes away is called again until `give_up_seconds` have passed.
  JobStatus follow() {
    CallAgain call_again(options_.give_up_seconds, [this](const std::string& words) { say(words); });
    for (;;) {
      try {
        return client_.watch(options_.job, [&](const JobStatus& status) {
          call_again.answered();
          show(status);
          return true;
        });
      } catch (const Error& error) {
        call_again.lost(error, ", the job may go on without");
      }
    }
  }

  void say(const std::string& words) {
    if (options_.quiet) return;
    progress_.clear();
    std::cerr << "gleaner: " << printable_lines(words) << std::endl;
  }

 private:
  void show(const JobStatus& status) {
    if (options_.json) std::cout << gateway::dump(gateway::job_json(status)) << std::endl;
    progress_.show(status);
    tell_written(status);
    explain(status);
  }

  // Names the frames that can be fetched, where more are to come.
  void tell_written(const JobStatus& status) {
    if (options_.json || ended(status.state) || status.frames_done == told_) return;
    if (told_ > 0 && Clock::now() - told_at_ < tell_interval) return;
    told_ = status.frames_done;
    told_at_ = Clock::now();
    say("written, and can be fetched: frames " + written_frames(status));
  }

  // Says why nothing happens: that no worker is there, or that other jobs come first.
  void explain(const JobStatus& status) {
    std::uint64_t done = status.frames_done + status.frames_failed;
    for (const auto& stage : status.stages) done += stage.items_done;
    if (done != done_ || status.state != state_ || ended(status.state)) {
      done_ = done;
      state_ = status.state;
      still_since_ = Clock::now();
      explained_.clear();
      return;
    }
    if (options_.quiet || Clock::now() - still_since_ < stall) return;
    still_since_ = Clock::now();
    const std::vector<std::string> reasons = client_.why(options_.job);
    if (!reasons.empty() && reasons.front() != std::exchange(explained_, reasons.front()))
      say("job " + options_.job + " waits: " + reasons.front());
  }

  const WatchOptions& options_;
  Client client_;
  ProgressDisplay progress_;
  Clock::time_point still_since_ = Clock::now();
  std::uint64_t done_ = 0;
  std::uint32_t told_ = 0;  // frames that were written when people were told
  Clock::time_point told_at_{};
  coordinator::JobState state_ = coordinator::JobState::queued;
  std::string explained_;
};

}  // namespace

JobStatus follow_job(const WatchOptions& options) {
  Watch watch(options);
  std::unique_ptr<PreviewFile> preview;
  if (!options.preview.empty()) preview = std::make_unique<PreviewFile>(options);
  const JobStatus last = watch.follow();
  if (preview) preview->finish();
  if (options.json || last.state != coordinator::JobState::done) return last;
  if (!last.message.empty()) watch.say("warning: " + last.message);
  watch.say("job " + last.id + " done, " + format_duration(last.seconds));
  return last;
}

void add_watch(CLI::App& app, Run& run) {
  auto options = std::make_shared<WatchOptions>();
  CLI::App* command = app.add_subcommand("watch", "Follow a job to its end: 0 where it is done, 1 where it failed");
  command->add_option("JOB", options->job, "as submit printed it")->required();
  command->add_option("--preview", options->preview, "FILE.png that is kept up to date");
  command->add_flag("--denoise,!--no-denoise", options->denoise, "the preview is denoised, where a worker can")
      ->capture_default_str();
  command->add_flag("--json", options->json, "each change as a line of JSON on standard output");
  command->add_flag("--quiet", options->quiet, "no progress");
  add_give_up_option(*command, options->give_up_seconds);
  add_coordinator_option(*command, options->coordinator);
  command->callback([options, &run] {
    run = [options] {
      require_done(follow_job(*options));
      return 0;
    };
  });
}

}  // namespace gleaner::cli

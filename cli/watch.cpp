// `gleaner watch`: follows a job to its end.

#include <CLI/CLI.hpp>
#include <atomic>
#include <chrono>
#include <condition_variable>
#include <iostream>
#include <memory>
#include <mutex>
#include <span>
#include <thread>

#include "cli/client.h"
#include "cli/commands.h"
#include "cli/progress.h"
#include "cli/status_words.h"
#include "coordinator/film/atomic_file.h"
#include "scene/model/error.h"

namespace gleaner::cli {

using coordinator::JobStatus;

namespace {

constexpr std::chrono::milliseconds preview_interval{700};  // it must be fresh at least once a second

struct WatchOptions {
  std::string coordinator, job, preview;
  bool json = false, quiet = false;
};

// Keeps a file up to date with the job's preview, beside the stream of progress.
class PreviewFile {
 public:
  PreviewFile(const std::string& coordinator, std::string job, std::string path)
      : client_(coordinator), job_(std::move(job)), path_(std::move(path)), thread_([this] { refresh(); }) {}

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
        write();
        lock.lock();
        end_.wait_for(lock, preview_interval, [&] { return ended_; });
      }
    } catch (...) {
      error_ = std::current_exception();
    }
  }

  void write() {
    std::string png = client_.preview(job_);
    if (!png.empty() && png != last_) coordinator::write_atomically(path_, std::as_bytes(std::span(png)));
    last_ = std::move(png);
  }

  Client client_;
  std::string job_, path_, last_;
  std::mutex mutex_;
  std::condition_variable end_;
  bool ended_ = false;
  std::exception_ptr error_;
  std::thread thread_;
};

int watch(const WatchOptions& options) {
  Client client(options.coordinator);
  client.show(options.job);  // an unknown job is told before any file is made
  std::unique_ptr<PreviewFile> preview;
  if (!options.preview.empty())
    preview = std::make_unique<PreviewFile>(options.coordinator, options.job, options.preview);
  ProgressDisplay progress(options.quiet || options.json);
  JobStatus last = client.watch(options.job, [&](const JobStatus& status) {
    if (options.json) std::cout << dump(job_json(status)) << std::endl;
    progress.show(status);
    return true;
  });
  progress.clear();
  if (preview) preview->finish();
  require_done(last);
  if (!options.quiet && !options.json) {
    if (!last.message.empty()) std::cerr << "gleaner: warning: " << last.message << "\n";
    std::cerr << "gleaner: job " << last.id << " done, " << format_duration(last.seconds) << "\n";
  }
  return 0;
}

}  // namespace

void add_watch(CLI::App& app, Run& run) {
  auto options = std::make_shared<WatchOptions>();
  CLI::App* command = app.add_subcommand("watch", "Follow a job to its end: 0 where it is done, 1 where it failed");
  command->add_option("JOB", options->job, "as submit printed it")->required();
  command->add_option("--preview", options->preview, "FILE.png that is kept up to date");
  command->add_flag("--json", options->json, "each change as a line of JSON on standard output");
  command->add_flag("--quiet", options->quiet, "no progress");
  add_coordinator_option(*command, options->coordinator);
  command->callback([options, &run] { run = [options] { return watch(*options); }; });
}

}  // namespace gleaner::cli

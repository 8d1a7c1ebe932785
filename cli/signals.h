#pragma once
// SIGINT and SIGTERM as calls on a thread of their own, where anything may be done.

#include <atomic>
#include <functional>
#include <mutex>
#include <thread>

namespace gleaner::cli {

// Made before any other thread, so that all threads leave the signals to this one. A second Ctrl-C ends the process at
// once; a second SIGTERM does not: batch systems send it to all of a job's processes, and the job's script passes it
// on.
class Signals {
 public:
  Signals();
  ~Signals();
  Signals(const Signals&) = delete;
  Signals& operator=(const Signals&) = delete;
  // Calls `on_signal` (on the signals' thread) when the first signal comes, or now if it came already.
  void watch(std::function<void()> on_signal);
  bool raised() const { return raised_; }

 private:
  void wait();

  std::mutex mutex_;
  std::function<void()> on_signal_;
  std::atomic<bool> raised_{false}, ending_{false};
  std::thread thread_;
};

}  // namespace gleaner::cli

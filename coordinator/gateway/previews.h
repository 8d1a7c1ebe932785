#pragma once
// Pictures of jobs that run, as PNG: denoised where a worker can, since noise is most of what people would see of them.

#include <chrono>
#include <map>
#include <mutex>
#include <string>
#include <thread>
#include <vector>

#include "coordinator/jobs/farm.h"

namespace gleaner::gateway {

class Previews {
 public:
  explicit Previews(coordinator::Farm& farm) : farm_(farm) {}
  // Nobody calls any more.
  ~Previews();
  Previews(const Previews&) = delete;
  Previews& operator=(const Previews&) = delete;

  // The bytes of a PNG; empty: there is nothing to show yet. Never waits for a worker: the first one of a job is as it
  // was sampled, and those after it are the last that was denoised. While a plan computes, the one before is shown
  // again. Without `denoise` it is what was sampled, and always new.
  std::string show(const std::string& job, double exposure_stops, bool denoise);

 private:
  using Clock = std::chrono::steady_clock;
  struct Shown {
    std::string sampled, denoised;  // the last ones
    Clock::time_point due{};        // when to denoise again
    bool busy = false;              // the thread denoises
    std::jthread thread{};
  };

  void forget_ended(std::vector<std::jthread>& ended);                      // mutex held
  void begin(Shown& shown, const std::string& job, double exposure_stops);  // mutex held
  struct Denoised {
    std::string png;        // empty: it could not be denoised
    double worker_seconds;  // that it took
  };
  // In a thread of its own.
  Denoised denoised(const std::string& job, double exposure_stops, const std::stop_token& stop);

  coordinator::Farm& farm_;
  std::mutex mutex_;
  std::map<std::string, Shown> shown_;  // by job
};

}  // namespace gleaner::gateway

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

struct PreviewSettings {
  std::uint32_t longest_side = 0;  // to which pictures are shrunk; 0: they are not
  double least_pause = 0;          // s, between two that are drawn anew of what was sampled
};

class Previews {
 public:
  explicit Previews(coordinator::Farm& farm, const PreviewSettings& settings = {}) : farm_(farm), settings_(settings) {}
  // Nobody calls any more.
  ~Previews();
  Previews(const Previews&) = delete;
  Previews& operator=(const Previews&) = delete;

  // The bytes of a PNG; empty: there is nothing to show yet. Never waits for a worker: the first one of a job is as it
  // was sampled, and those after it are the last that was denoised. While a plan computes, the one before is shown
  // again. Without `denoise` it is what was sampled: new, unless the settings ask for pauses.
  std::string show(const std::string& job, double exposure_stops, bool denoise);

 private:
  using Clock = std::chrono::steady_clock;
  struct Shown {
    std::string sampled, denoised;  // the last ones
    Clock::time_point due{};        // when to denoise again
    Clock::time_point draw_due{};   // when to draw what was sampled again
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

  std::string png_of(const coordinator::Film& film, double exposure_stops) const;

  coordinator::Farm& farm_;
  const PreviewSettings settings_;
  std::mutex mutex_;
  std::map<std::string, Shown> shown_;  // by job
};

}  // namespace gleaner::gateway

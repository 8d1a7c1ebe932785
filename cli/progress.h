#pragma once
// How far a job is, on standard error: a bar on a terminal, plain lines elsewhere.

#include <chrono>
#include <string>

#include "coordinator/jobs/job.h"

namespace gleaner::cli {

class ProgressDisplay {
 public:
  explicit ProgressDisplay(bool quiet);
  ~ProgressDisplay();  // leaves the terminal's line clean
  void show(const coordinator::JobStatus& status);
  void clear();  // before other words are printed

 private:
  bool quiet_, terminal_, drawn_ = false;
  std::chrono::steady_clock::time_point last_{};
  coordinator::JobState last_state_ = coordinator::JobState::queued;
  int last_tenth_ = -1;
};

std::string format_rate(double items_per_second);  // "1.2 M items/s"
std::string format_duration(double seconds);       // "1 min 12 s"

}  // namespace gleaner::cli

#pragma once
// The farm at a glance, for a page that is shown every second: bounded, however many jobs and workers there are.

#include <cstddef>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "coordinator/jobs/event_log.h"
#include "coordinator/jobs/job.h"
#include "coordinator/schedule/scheduler.h"

namespace gleaner::coordinator {

// How many are shown at most.
struct OverviewLimits {
  std::size_t workers = 100, gone = 10;
  std::size_t jobs = 25;  // of those that run, of those that wait and of those that ended, each
  std::size_t events = 50;
};

// What a frame's picture says of its own noise.
struct FrameError {
  std::uint32_t frame = 1;  // its number
  double relative = 0;      // root of the mean squared error, over the picture's mean
  bool denoised = false;    // the expected error of a denoised picture; else the standard error of its samples
};

// A batch that a worker was given.
struct GivenBatch {
  std::string job, stage, kind;
  std::uint32_t frame = 1;  // its number
  std::uint64_t first = 0, items = 0;
  Seconds seconds = 0;  // since then
};

// A batch that was accepted.
struct AcceptedBatch {
  std::string stage, kind;
  std::uint64_t items = 0;
  Seconds seconds = 0;  // as the worker measured
};

// A worker that is not there any more.
struct GoneWorker {
  std::string name, device;
  double unix_seconds = 0;  // when it left
  bool lost = false;        // it had not been asked to leave
  std::string why;          // may be empty
};

struct FarmOverview {
  struct ShownWorker {
    WorkerStatus status;
    std::optional<GivenBatch> batch;    // the one that it was given first; none: it has none
    std::optional<AcceptedBatch> last;  // none: it has answered nothing yet
  };
  struct ShownJob {
    JobStatus status;                 // a brief one
    std::optional<FrameError> error;  // of the frame that was written last; none: it is not known
  };

  double unix_seconds = 0;  // when it was looked at
  FarmTotals totals;
  std::map<JobState, std::size_t> jobs_in;  // all of them
  std::size_t paused = 0;                   // of those that wait or run
  // Those that run, then those that wait, in the order of their turn, then those that ended, the latest first.
  std::vector<ShownJob> jobs;
  std::size_t workers_connected = 0, draining = 0, aside = 0;
  std::vector<ShownWorker> workers;  // first those that get no work, then those that joined last
  std::vector<GoneWorker> gone;      // the latest first
  std::vector<FarmEvent> events;     // likewise
};

}  // namespace gleaner::coordinator

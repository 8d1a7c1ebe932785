#pragma once
// Follows a job: `gleaner watch`, and `gleaner submit --wait`.

#include <string>

#include "coordinator/jobs/job.h"

namespace gleaner::cli {

struct WatchOptions {
  std::string coordinator, job, preview;
  bool denoise = true;  // the preview, where a worker can
  bool json = false, quiet = false;
  double give_up_seconds = 600;
};

// To the job's end; tells how it goes on standard error, or as JSON on standard output. Returns the last status.
coordinator::JobStatus follow_job(const WatchOptions& options);

}  // namespace gleaner::cli

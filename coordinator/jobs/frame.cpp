#include "coordinator/jobs/frame.h"

#include <algorithm>

#include "coordinator/jobs/running_job.h"

namespace gleaner::coordinator {

namespace {
constexpr Seconds rate_window = 5;  // throughput that people see is that of so long
}

void remember_progress(RunningStage& stage, Seconds now) {
  stage.history.emplace_back(now, stage.items_done);
  while (stage.history.size() > 2 && stage.history.front().first < now - rate_window) stage.history.pop_front();
}

StageStatus status_of(const RunningStage& stage, Seconds now) {
  StageStatus status{.name = stage.spec.name,
                     .kind = stage.spec.kind,
                     .frame = frame_at(stage.frame->job->request, stage.frame->place),
                     .items = stage.items,
                     .items_done = stage.items_done};
  if (stage.complete) {
    double seconds = stage.last_result - stage.first_lease;
    status.items_per_second = seconds > 0 ? static_cast<double>(stage.items) / seconds : 0;
    status.seconds_left = 0;
  } else if (!stage.history.empty()) {
    const auto& [since, before] = stage.history.front();
    double seconds = now - since;
    if (seconds > 0) status.items_per_second = static_cast<double>(stage.items_done - before) / seconds;
    if (status.items_per_second > 0)
      status.seconds_left = static_cast<double>(stage.items - stage.items_done) / status.items_per_second;
  }
  return status;
}

}  // namespace gleaner::coordinator

#pragma once
// A job inside the farm: its frames that run, that wait and that are over. Guarded by the farm's mutex unless said
// otherwise.

#include <cstdint>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "coordinator/jobs/frame.h"
#include "coordinator/jobs/frame_set.h"
#include "coordinator/jobs/overview.h"

namespace gleaner::coordinator {

constexpr std::size_t most_failures = 8;  // of a job's frames, whose reasons are told

struct Job : std::enable_shared_from_this<Job> {
  std::string id;
  JobRequest request;
  JobState state = JobState::queued;
  std::string message;
  std::uint64_t version = 1;
  Seconds accepted = 0, started = 0, ended = 0;
  std::uint64_t memory = 0;  // predicted bytes of a frame's plan
  double submitted_unix_seconds = 0;
  bool cancel = false;
  bool paused = false;  // nothing of it is handed out
  Seconds paused_since = 0;
  bool restored = false;  // from the journal

  std::map<std::uint64_t, std::shared_ptr<Frame>> frames;       // that run, by the place at which they began
  FrameSet written, failed;                                     // that are over
  std::uint64_t next = 0;                                       // frames before this place run or are over
  std::vector<std::pair<std::uint64_t, std::string>> failures;  // the first few of `failed`, and why

  // The base that the frames' states were last applied to, and its id.
  std::mutex base_mutex;
  std::shared_ptr<const scene::Scene> base;
  std::string base_blob;

  FrameProgress progress;                         // in frames
  std::vector<std::string> warnings;              // of the frames so far
  std::map<WorkerId, std::uint32_t> frames_with;  // frames written with a worker's help
  std::vector<StageStatus> last_stages;           // of the frame that ended last
  std::optional<FrameError> error;                // of the frame that was written last
  double worker_seconds = 0;                      // of accepted batches
  std::uint64_t rays = 0;

  // Of Farm::show() and denoise(): somebody waits for the frame's picture. Null: its files are written.
  struct Showing {
    SceneSummary shown;
    bool behind = false;          // after others that are shown
    std::optional<Film> given{};  // it is rendered, and only denoised
    std::optional<Film> film{};   // what is waited for, once it is there
    FrameReport report{};
  };
  std::unique_ptr<Showing> showing;

  std::uint64_t frames_over() const { return written.count() + failed.count(); }
};

// Brings the job's progress up to date with its frames'.
void update_progress(Job& job, Seconds now);
// `brief`: without what there may be much of: the numbers of written frames, the jobs that are waited for, and stages
// but the first few that run.
JobStatus status_of(const Job& job, Seconds now, bool brief = false);

}  // namespace gleaner::coordinator

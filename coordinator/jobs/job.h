#pragma once
// Jobs as people see them.

#include <cstdint>
#include <string>
#include <utility>
#include <vector>

#include "coordinator/jobs/session.h"
#include "coordinator/plan/plan.h"

namespace gleaner::coordinator {

struct FrameScene {
  std::string scene_blob;      // id; the store holds it
  std::string bvh_blob;        // id; empty: the embedded farm, none of whose workers needs one
  SceneSummary summary;        // of the scene; of a base at rest where there is a state
  std::string state_blob;      // id of the state that shows the scene as a base; empty: the scene as it is
  std::string earlier_blob{};  // as state_blob, of Pose::earlier
};
// Equal for frames of one scene.
inline std::string blobs_of(const FrameScene& scene) {
  return scene.state_blob.empty() ? scene.scene_blob : scene.scene_blob + "+" + scene.state_blob;
}

struct JobRequest {
  std::string scene_name;   // for people and the report
  std::string camera_name;  // for the report
  // One, or where the scene moves one a frame.
  std::vector<FrameScene> scenes;
  FrameSettings settings;
  std::uint32_t first_frame = 1, last_frame = 1;  // inclusive
  std::uint32_t frame_step = 1;                   // between their numbers
  std::vector<std::uint32_t> numbers;  // of the frames, ascending, in place of the above; empty: all of these
  // One a frame, the settings' way is then theirs; or none: all are seen by the settings' camera.
  std::vector<scene::Camera> cameras;
  double exposure_stops = 0;  // of the PNG
  double time_limit = 0;      // seconds from a frame's start after which it is finished with what there is; 0 = none
  std::string name;           // for people; may be empty
  std::string owner;          // who submitted it, by certificate or host; empty: unknown
  int priority = 0;           // higher ones first
  std::vector<std::string> after;  // jobs that must be done before this one begins
  // The submitter's word for this request: who submits it again gets the same job. Empty: none.
  std::string request_id;
  std::string content;  // with an id: digest of the request, so that another one under the same id is refused
};

inline constexpr std::uint64_t most_frames = 100000;  // of a job
inline constexpr int most_priority = 1000;            // and least: its negative
// Of the frame at this place.
inline const FrameScene& scene_of(const JobRequest& request, std::uint64_t place) {
  return request.scenes.size() == 1 ? request.scenes.front() : request.scenes[place];
}
inline std::uint64_t frames_of(const JobRequest& request) {
  if (!request.numbers.empty()) return request.numbers.size();
  return (std::uint64_t{request.last_frame} - request.first_frame) / request.frame_step + 1;
}

inline std::uint32_t frame_at(const JobRequest& request, std::uint64_t index) {
  if (!request.numbers.empty()) return request.numbers[index];
  return static_cast<std::uint32_t>(request.first_frame + index * request.frame_step);
}

enum class JobState { queued, running, done, failed, cancelled };
const char* job_state_name(JobState state);
inline bool ended(JobState state) { return state != JobState::queued && state != JobState::running; }

struct StageStatus {
  std::string name, kind;
  std::uint32_t frame = 1;  // its number
  std::uint64_t items = 0, items_done = 0;
  double items_per_second = 0;  // over the last few seconds
  double seconds_left = -1;     // negative = unknown
};

struct JobStatus {
  std::string id, name, owner;
  JobState state = JobState::queued;
  bool paused = false;
  int priority = 0;
  std::vector<std::string> after;
  std::string scene_name, method;
  std::uint32_t width = 0, height = 0;
  std::uint32_t frames = 1, frames_done = 0, frames_failed = 0;  // done: their files are written
  std::uint32_t frame_step = 1;                                  // between their numbers
  // Numbers of frames: [first, last] of those whose files are written, in order; those that run.
  std::vector<std::pair<std::uint32_t, std::uint32_t>> written;
  std::vector<std::uint32_t> running;
  std::vector<StageStatus> stages;  // of the frames that run, finished ones too
  double seconds = 0;               // since it was accepted; of an ended job: until it ended
  // Of a job that runs, by predicted work. That of all frames never falls, that of a frame not within the frame.
  double frame_progress = 0, progress = 0;            // 0 to 1: of the first frame that runs, of all frames
  double frame_seconds_left = -1, seconds_left = -1;  // negative = unknown
  double submitted_unix_seconds = 0;
  // What its accepted batches cost the workers, those of frames that failed included.
  double worker_seconds = 0;
  std::uint64_t rays = 0;
  std::string message;  // which frames failed, and why; of one that is done: what must be known of its pictures
  bool preview_available = false;
  double exposure_stops = 0;
  std::uint64_t version = 0;  // grows with every change
};

struct WorkerStatus {
  std::string id, address;
  DeviceDescription device;
  std::uint32_t leases = 0;
  bool draining = false;
  std::string aside;  // why it gets no work; empty: it does
  double connected_seconds = 0, silent_seconds = 0;
  std::map<std::string, double> items_per_second;  // by stage kind
};

// Since the farm was made.
struct FarmTotals {
  std::uint64_t batches_accepted = 0, batches_failed = 0, batches_expired = 0;
  std::uint64_t items_accepted = 0, frames_written = 0;
  std::uint64_t batches_read_back = 0;  // that waited for their turn on disk
  std::uint64_t batches_rechecked = 0, liars_found = 0;
  double result_lock_seconds = 0;  // for which results held the farm's lock
};

}  // namespace gleaner::coordinator

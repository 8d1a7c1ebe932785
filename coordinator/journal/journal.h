#pragma once
// What a coordinator must know again after it died: its jobs, and how far their frames were. Of records it knows where
// they lie, never their bytes.

#include <cstdint>
#include <map>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include "scene/model/blob.h"

namespace gleaner::coordinator {

using scene::Bytes;

struct JournalJob {
  std::string id;
  std::string state;                // a word of the farm's; "queued" until the job has ended
  std::string message;              // bytes of any kind
  double submitted = 0, ended = 0;  // Unix seconds; ended: 0 = it has not
  double worker_seconds = 0;        // of accepted batches
  std::uint64_t rays = 0;
  Bytes request;  // what lists show of it, as the farm encodes it
};

// A frame of a job that is over.
struct JournalFrame {
  std::string job;
  std::uint64_t frame = 0;  // its place among the job's frames, from 0
  std::string failure;      // why it failed, bytes of any kind; empty: it was written
};

// Records that a stage's batch of a frame made and that were accepted: items [first, first + count) of an artifact lie
// at [offset, offset + bytes) of the frame's file of that artifact.
struct JournalRange {
  std::string job;
  std::uint64_t frame = 0;  // as JournalFrame::frame
  std::string artifact;
  std::uint64_t first = 0, count = 0;
  std::uint64_t offset = 0, bytes = 0;
  std::string digest;  // SHA-256 of these bytes, 32 bytes
  Bytes facts{};       // of a solo stage
};

// What has happened since the last write; all of it is written, or nothing.
struct JournalChanges {
  std::map<std::string, JournalJob> jobs;  // by id; the request is not written again
  std::vector<std::string> forgotten;      // jobs
  std::set<std::string> retried;           // jobs of which no frame has failed any more; before `frames_over`
  std::vector<JournalFrame> frames_over;
  std::vector<JournalRange> ranges;
  // Frames and jobs whose ranges so far are needed no more; before `ranges`.
  std::set<std::pair<std::string, std::uint64_t>> dropped_frames;
  std::set<std::string> dropped_jobs;

  bool empty() const {
    return jobs.empty() && forgotten.empty() && retried.empty() && frames_over.empty() && ranges.empty() &&
           dropped_frames.empty() && dropped_jobs.empty();
  }
};

// Every call may throw Error::failed, naming the journal and the reason; nothing has changed then. Not thread-safe.
class Journal {
 public:
  virtual ~Journal() = default;
  virtual std::string name() const = 0;  // a file or an address, for messages
  // Counts the starts of coordinators on this journal; below 2^32.
  virtual std::uint64_t begin() = 0;
  virtual std::vector<JournalJob> jobs() = 0;  // in the order in which they were added
  // Scenes and cameras of a job's frames, which may be large.
  virtual Bytes frames(const std::string& job) = 0;
  virtual std::vector<JournalFrame> frames_over(const std::string& job) = 0;  // in the order of their places
  virtual std::vector<JournalRange> ranges(const std::string& job, std::uint64_t frame) = 0;
  // On disk when it returns.
  virtual void add(const JournalJob& job, const Bytes& frames) = 0;
  virtual void write(const JournalChanges& changes) = 0;
};

}  // namespace gleaner::coordinator

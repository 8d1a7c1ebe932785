#pragma once
// What a coordinator must know again after it died: its jobs, and how far their frames were. Of records it knows where
// they lie, never their bytes.

#include <cstdint>
#include <map>
#include <set>
#include <string>
#include <vector>

#include "scene/model/blob.h"

namespace gleaner::coordinator {

using scene::Bytes;

struct JournalJob {
  std::string id;
  std::string state;                // a word of the farm's; "queued" until the job has ended
  std::string message;              // bytes of any kind
  double submitted = 0, ended = 0;  // Unix seconds; ended: 0 = it has not
  std::uint32_t frames_done = 0;
  Bytes request;  // what lists show of it, as the farm encodes it
};

// Records that a stage's batch made and that were accepted: items [first, first + count) of an artifact lie at
// [offset, offset + bytes) of the artifact's file.
struct JournalRange {
  std::string job, artifact;
  std::uint64_t first = 0, count = 0;
  std::uint64_t offset = 0, bytes = 0;
  std::string digest;  // SHA-256 of these bytes, 32 bytes
  Bytes facts{};       // of a solo stage
};

// What has happened since the last write; all of it is written, or nothing.
struct JournalChanges {
  std::map<std::string, JournalJob> jobs;  // by id; the request is not written again
  std::vector<std::string> forgotten;      // jobs
  std::vector<JournalRange> ranges;
  std::set<std::string> frames_over;  // jobs whose ranges so far are needed no more; before `ranges`

  bool empty() const { return jobs.empty() && forgotten.empty() && ranges.empty() && frames_over.empty(); }
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
  virtual std::vector<JournalRange> ranges(const std::string& job) = 0;
  // On disk when it returns.
  virtual void add(const JournalJob& job, const Bytes& frames) = 0;
  virtual void write(const JournalChanges& changes) = 0;
};

}  // namespace gleaner::coordinator

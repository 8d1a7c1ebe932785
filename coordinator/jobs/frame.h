#pragma once
// One frame on its way: the stages that run, what came back, what it cost. Guarded by the farm's mutex unless said
// otherwise. The job that it belongs to is in running_job.h.

#include <algorithm>
#include <condition_variable>
#include <deque>
#include <map>
#include <memory>
#include <mutex>
#include <set>
#include <string>
#include <vector>

#include "coordinator/artifacts/artifact_data.h"
#include "coordinator/jobs/arrived_records.h"
#include "coordinator/jobs/job.h"
#include "coordinator/jobs/progress.h"
#include "coordinator/jobs/report.h"
#include "coordinator/journal/journal.h"
#include "coordinator/plan/plan.h"
#include "coordinator/schedule/scheduler.h"

namespace gleaner::coordinator {

struct Frame;
struct Job;
class RecordFile;

// How a retained artifact is made: kept for as long as its items, or those of what was made of it, may have to be
// computed again.
struct Recipe {
  ArtifactId id;
  StageSpec spec;
  std::shared_ptr<const StageWork> work;
  // Of each input; null: the coordinator has its bytes, and the work keeps them.
  std::vector<std::shared_ptr<const Recipe>> inputs;
};

// Of an item's number of records, which stand before the records of a counted stage's batch.
inline constexpr std::uint64_t count_bytes = 4;

// Of a counted output.
struct CountedBatch {
  Bytes counts, records;
};

// An accepted batch that another worker computes again, to compare the bytes.
struct Recheck {
  struct Answer {
    WorkerId worker = 0;
    std::string name, digest;
  };
  std::string stage;  // its name
  ItemRange items;
  std::string device_kind;      // devices of one kind make the same bytes
  std::vector<Answer> answers;  // the first one is what was accepted
};

// A stage that the scheduler knows.
struct RunningStage : std::enable_shared_from_this<RunningStage> {
  std::shared_ptr<Frame> frame;
  StageSpec spec;
  StageId id = 0;
  std::shared_ptr<const StageWork> work;
  std::shared_ptr<Bytes> records;  // items * record_bytes; null until it is allocated (after the first leases went out)
  bool failed_to_allocate = false;
  unsigned writers = 0;    // accepted batches that are being copied in
  ArrivedRecords arrived;  // of a streamed stage, which has no `records`
  bool complete = false, delivered = false;
  ArtifactId artifact;                               // what it makes
  std::shared_ptr<const Recipe> recipe;              // of a retained output, else null
  std::vector<std::shared_ptr<const Recipe>> reads;  // as Recipe::inputs
  std::vector<ItemRange> again;                      // the items that are to be run; empty: all
  bool reads_outputs = false;                        // collected ones of other stages
  bool computes_again = false;                       // what was lost of an output that another stage made
  std::vector<WorkerId> avoid;                       // whose answers are in dispute
  bool paused = false;                               // a retained input does not exist at the moment
  Seconds unavailable_since = -1;                    // of failures for want of an input, no batch accepted since
  std::map<std::uint64_t, CountedBatch> counted;     // collected: by first item, until the stage is whole
  std::shared_ptr<const CountIndex> index;           // collected and counted: when it is
  std::uint64_t record_count = 0;                    // when delivered
  Bytes facts;
  std::shared_ptr<RecordFile> file;  // of accepted records, for the next coordinator; null: they are not kept
  std::vector<JournalRange> held;    // the last coordinator accepted them, and they are being read back
  std::vector<ItemRange> missing;    // with them: the other items
  // Another frame's stage makes the same artifact at this moment: this one, which the scheduler does not know then,
  // gets it from there.
  std::shared_ptr<RunningStage> follows;
  std::vector<std::shared_ptr<RunningStage>> followers;
  std::unique_ptr<Recheck> recheck;  // then this stage is one batch of another one, once more
  std::uint64_t items = 0;           // to be run
  std::uint64_t items_done = 0;
  std::vector<ItemRange> copied;  // accepted and copied in, in any order
  Seconds first_lease = -1, last_result = -1;
  std::string last_failure;
  StageReport report;
  std::deque<std::pair<Seconds, std::uint64_t>> history;  // (when, items done) of the last few seconds

  // Predicted cost of an item, in samples of a path tracer.
  double work_per_item() const { return spec.items > 0 ? work_of(spec) / static_cast<double>(spec.items) : 1; }
  // The plan asked for it: it is no repetition of another stage's items.
  bool makes_output() const { return !computes_again && !recheck; }
  // Nothing that it reads was made by another stage.
  bool rests_on_no_stage() const {
    return std::all_of(reads.begin(), reads.end(), [](const auto& input) { return !input; }) && !reads_outputs;
  }
  bool streamed() const { return spec.output.placement == Placement::stream; }
  bool retained() const { return spec.output.placement == Placement::retain; }
  bool collected() const { return spec.output.placement == Placement::collect; }
};

StageStatus status_of(const RunningStage& stage, Seconds now);
void remember_progress(RunningStage& stage, Seconds now);

// Accepted items that the preview does not show yet. Their records lie in the stage's.
struct UndrawnItems {
  std::shared_ptr<RunningStage> stage;
  std::uint64_t first = 0, count = 0;
};

// A frame that is rendered, and the frames right behind it that show the same picture: what was made for the one is
// written for the others too.
struct Frame : std::enable_shared_from_this<Frame> {
  std::shared_ptr<Job> job;
  std::uint64_t place = 0;  // among the job's frames, of the next one to be written
  std::uint64_t left = 1;   // so many are still to be written, from `place` on
  FrameScene scene{};
  SceneLineage lineage;      // of that scene; the frame's thread
  FrameSettings settings;    // with the camera that sees this frame
  Seconds begun = 0;         // when the one at `place` was begun
  Seconds waited_from = 0;   // from when on its report counts seconds
  bool posted = false;       // its first stages are with the scheduler
  std::uint64_t memory = 0;  // predicted bytes of its plan

  // The plan's calls may take long: `plan_mutex`, taken before the farm's mutex where both are held, guards them. Who
  // is not the frame's thread must not wait for it.
  std::mutex plan_mutex;
  std::unique_ptr<Plan> plan;
  bool drawn = false;  // plan_mutex: there is a preview

  std::condition_variable events;  // with the farm's mutex: something below changed
  bool computing = false;          // the thread is in a call of the plan
  std::string failure;
  std::string full_disk;                              // it is whole, and waits for room: what could not be written
  std::vector<std::shared_ptr<RunningStage>> stages;  // in the order of their start
  std::deque<std::shared_ptr<RunningStage>> finished;
  std::vector<std::shared_ptr<RunningStage>> to_start;  // by the frame's thread: they followed another frame's
  std::deque<UndrawnItems> undrawn;
  // What stages read of the coordinator's, by the plan's ids. Workers find it until the plan releases it.
  std::map<ArtifactId, std::shared_ptr<const ArtifactData>> data;
  // Collected outputs of the frame: their layout, without the records, which are the plan's.
  std::map<ArtifactId, ArtifactData> outputs;

  std::vector<Skip> reused;  // stages that had been made before
  double work_asked = 0;     // of the stages that were posted
  double work_done = 0;      // of that
  double work_to_come = 0;   // of stages that the plan will still ask for, as predicted
  FrameProgress progress;
  std::map<ArtifactId, std::vector<JournalRange>> held;  // from the journal, whole and in order; the frame's thread
  bool said_unremembered = false;
  // Its accepted ranges that rest on no other stage's records, and who made them.
  std::vector<std::pair<JournalRange, WorkerId>> remembered;
  std::set<WorkerId> makers;                            // of its accepted batches
  std::vector<std::shared_ptr<RunningStage>> rechecks;  // that run; the frame waits for them
  Seconds all_but_rechecks = 0;                         // since when it has waited for nothing else
  bool distrusted = false;  // one of `makers` was found lying: the frame begins again, with what the others made

  FrameReport report;
};

}  // namespace gleaner::coordinator

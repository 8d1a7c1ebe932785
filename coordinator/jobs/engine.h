#pragma once
// Inside the farm: its state and the steps that its files share. Everything is guarded by `mutex` unless it says
// otherwise; a job's plan is guarded by the job's `plan_mutex`, which is taken first where both are held.

#include <condition_variable>
#include <deque>
#include <list>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <random>
#include <set>
#include <string>
#include <thread>
#include <vector>

#include "coordinator/jobs/farm.h"
#include "coordinator/jobs/frame.h"
#include "coordinator/jobs/kept_records.h"
#include "coordinator/journal/journal.h"

namespace gleaner::coordinator {

struct Worker {
  WorkerId id = 0;
  WorkerHello hello;
  std::string name;
  std::shared_ptr<WorkerSession> session;
  Seconds joined = 0, heard = 0;
  bool draining = false;
  unsigned wrong_copies = 0;              // of its parts that turned out to be other bytes
  std::string kind;                       // of its device
  std::string aside;                      // why it gets nothing any more; empty: it does
  std::set<std::string> rechecked_kinds;  // of stages of which its first batch was computed again
  unsigned waits = 0;                     // results of its that wait for the plan: it cannot be heard meanwhile
  std::set<Epoch> leases;
};

// An output that stays with the workers, for as long as somebody may read it.
struct RetainedArtifact {
  std::shared_ptr<const Recipe> recipe;
  std::set<Job*> frames;        // that have it
  unsigned readers = 0;         // stages that compute something again and read it
  std::vector<ItemRange> lost;  // while a stage makes it: what that stage had made, and nobody holds any more
  Bytes facts;
  bool untrusted = false;  // a liar may have had a part in it: no other frame gets it
};

struct Cancelled {};   // thrown on a job's thread
struct Distrusted {};  // likewise: the frame rests on what a liar made

// Devices of one kind make the same bytes of the same items.
std::string device_kind(const DeviceDescription& device);
std::string digest_of(const Bytes& bytes);

// Memory of a job's that may be large: destroyed where the farm's mutex is not held.
struct JobRemains {
  std::vector<std::shared_ptr<RunningStage>> stages;
  std::vector<std::shared_ptr<const Bytes>> records;
  std::vector<ArrivedRecords> arrived;
  std::vector<std::map<std::uint64_t, CountedBatch>> counted;
  std::map<ArtifactId, std::shared_ptr<const ArtifactData>> data;
  std::deque<UndrawnItems> undrawn;
  std::vector<scene::Camera> cameras;
  std::vector<FrameScene> scenes;
};

// The job's settings, with the camera that sees this frame; the way on which it lies was put there by submit().
FrameSettings settings_of(const JobRequest& request, std::uint32_t frame);

struct Farm::Impl : std::enable_shared_from_this<Farm::Impl> {
  Impl(FarmSettings farm_settings, BlobStore& store);

  Seconds now() const { return settings.clock(); }

  // Workers (workers.cpp; mutex held but by the clock's thread).
  void offer(Worker& worker);  // as much work as the scheduler has for it
  void offer_to_all();
  // Workers that have room and got nothing are offered work again: what happened may have made some for them. However
  // many events there are, it is done once in an interval.
  void offer_to_unserved_soon();
  void offer_to_unserved();
  void forget_lease(Epoch epoch);
  void revoke(const std::vector<Lease>& revoked);
  void lose(WorkerId id, const std::string& why);
  void watch_clock();
  void tick();

  // Jobs (job_queue.cpp).
  void changed(Job& job);                                  // mutex held
  std::shared_ptr<Job> find(const std::string& id) const;  // mutex held
  std::shared_ptr<Job> accept(const JobRequest& request);  // checks it
  void start_queued();                                     // mutex held
  bool has_memory_for(const Job& job) const;               // mutex held
  std::string why_queued(const Job& job) const;            // mutex held
  // Mutex held. The job has ended: it is shown so, its leases are revoked, the next one may start. What it held is
  // handed out, to be destroyed where the mutex is not held.
  JobRemains end_job(Job& job, JobState state, const std::string& message);
  void forget_ended();  // mutex held; those beyond the bounds

  // The journal (journal_jobs.cpp); without one they do nothing. journal_added() waits for it, and throws.
  void journal_added(const Job& job);
  void journal_changed(const Job& job, JobState state);  // mutex held
  void restore();                                        // the journal's jobs, when the farm is made
  std::shared_ptr<Job> restored(const JournalJob& entry, std::string& failure);

  // Accepted records in files (remembered.cpp); without a journal they do nothing.
  std::filesystem::path records_of(const std::string& job, std::uint32_t frame) const;
  void drop_left_records(const std::set<std::string>& waiting) const;  // of jobs that are over
  void recall(Job& job);                                // what of its frame was accepted, checked; on the job's thread
  void use_held(RunningStage& stage);                   // mutex held
  void feed_held(RunningStage& stage, Bytes* records);  // `records`: of a collected output of fixed stride
  // Appends the records to the stage's file; none: that failed.
  std::optional<JournalRange> store(RunningStage& stage, const Lease& lease, const Bytes& image, const Bytes& facts,
                                    const std::string& digest);
  void remember(RunningStage& stage, WorkerId maker, JournalRange range);  // mutex held
  void forget_records(const std::string& job, const std::filesystem::path& folder);
  void join_ended_threads();
  static void run(std::shared_ptr<Impl> self, std::shared_ptr<Job> job);  // the job's thread

  // Frames (frame_run.cpp, write_frame.cpp; on the job's thread).
  void run_frames(const std::shared_ptr<Job>& job);
  static bool same_picture(const Job& job, std::uint32_t a, std::uint32_t b);
  // Runs `call`, which asks the plan or makes one, with the plan to itself; then a cancelled job ends here.
  template <typename Call>
  auto compute(Job& job, const Call& call);
  void aim(Job& job, std::uint32_t frame);  // a plan for the frame
  // Of the scene as the frame's state shows it. Throws Error::bad_input where the state does not fit its base.
  SceneSummary summary_of(Job& job, std::uint32_t frame);
  FrameReport new_report(const Job& job, std::uint32_t frame) const;
  Film render(const std::shared_ptr<Job>& job, std::uint32_t frame);
  Film render_trusted(const std::shared_ptr<Job>& job, std::uint32_t frame);  // again where a liar had a part in it
  void warn(Job& job, std::uint32_t frame);  // mutex held; what the report's warnings say
  void reuse(Job& job, std::uint32_t frame, std::uint32_t rendered);
  // Draws accepted batches until a stage is whole. None: the time limit has ended the frame.
  std::optional<FinishedStage> await_stage(Job& job);
  // Hand records to the plan: those of a streamed stage, those that the preview does not show. False: there are none.
  // The lock is held before and after.
  bool stream(Job& job, std::unique_lock<std::mutex>& lock);
  bool draw(Job& job, std::unique_lock<std::mutex>& lock);
  // Hands the plan the next batch of a streamed stage, which has arrived.
  void take_next(Job& job, std::shared_ptr<RunningStage> stage, std::unique_lock<std::mutex>& lock);
  // Hands the plan what of streamed stages has arrived by now, in item order.
  void take_what_arrived(Job& job, std::unique_lock<std::mutex>& lock);
  // Offers the plan what came in of the stages that run. The lock is held before and after.
  bool conclude(Job& job, std::unique_lock<std::mutex>& lock);
  // Whatever the frame still has with scheduler and workers is taken back; its figures move into the report.
  void end_frame(Job& job);
  JobRemains withdraw(Job& job);  // mutex held; as end_frame()
  void write(Job& job, std::uint32_t frame, const Film& film, Seconds begun);

  // Stages (stages.cpp).
  // Hands a step's stages to the scheduler. The memory for their results is taken while the first batches run.
  // `work_to_come`: predicted, of stages after these.
  void post(const std::shared_ptr<Job>& job, const Step& step, double work_to_come);
  // What follows: mutex held. Null: the stage's records exist already, and were handed to the job.
  std::shared_ptr<RunningStage> schedule(const std::shared_ptr<Job>& job, const StageSpec& spec);
  void provide(Job& job, const ArtifactId& id, const std::string& blob, std::shared_ptr<const Bytes> bytes);
  void add_input(Job& job, RunningStage& stage, StageWork& work, const StageInput& input) const;
  bool find_kept(RunningStage& stage);
  void remember_output(const RunningStage& stage);
  void start(const std::shared_ptr<RunningStage>& stage);
  static void join_counted(RunningStage& stage);
  // The last of {all accepted, all copied in, memory there, retained parts whole} hands the stage to its job; of a
  // streamed stage that of {all accepted, all given to the plan}.
  void deliver_if_complete(const std::shared_ptr<RunningStage>& shared);

  // Retained outputs (retained.cpp; mutex held).
  bool retain_output(Job& job, RunningStage& stage);      // true: it exists already
  void release_retained(Job& job, const ArtifactId& id);  // the frame reads it no more
  void release_all_retained(Job& job);
  void release_if_unused(const ArtifactId& id);
  void place_near_inputs(const RunningStage& stage, ScheduledStage& scheduled);
  bool inputs_exist(const RunningStage& stage) const;
  void pause_if_inputs_lack(RunningStage& stage);
  // Computes again what is missing and needed, and pauses who waits for it.
  void settle_retained();
  std::vector<Gap> missing(const ArtifactId& id, bool being_made);
  void compute_again(Job& job, const ArtifactId& id, const std::vector<Gap>& gaps);
  void start_again(Job& job, const ArtifactId& id, std::vector<ItemRange> items, const Gap* special);
  void require_inputs(const RunningStage& stage);
  bool is_computed(const ArtifactId& id, const ItemRange& items) const;
  void end_again(const std::shared_ptr<RunningStage>& stage);
  static bool fits(const RunningStage& stage, const Lease& lease, const BatchOutput::Retained& part);
  void take_part(const RunningStage& stage, Worker& worker, const ItemRange& items, const BatchOutput::Retained& part);
  // A part whose lease is over: a second copy, or of no use.
  void take_late_part(Worker& worker, Verdict verdict, const BatchOutput::Retained& part);
  void made_part(const ArtifactId& id);
  void quarantine(WorkerId id, const std::string& why);
  void drop_copy(const ArtifactId& id, std::uint64_t first, const std::string& digest, WorkerId holder,
                 const std::string& who_says);
  void lose_parts(WorkerId worker);
  std::string name_of(WorkerId id) const;
  const Worker* worker_with(const std::string& token) const;
  const RunningStage* reader(const Worker& worker, Epoch epoch, const ArtifactId& id, ItemRange* own) const;

  // Batches that are computed again to find liars (recheck.cpp; mutex held but by the job's thread).
  bool wants_recheck(const RunningStage& stage, Worker& worker);
  void recheck(const std::shared_ptr<RunningStage>& stage, WorkerId maker, const Lease& lease, std::string digest);
  // False: there is nobody to ask.
  bool ask_another(Job& job, const RunningStage& like, std::unique_ptr<Recheck> what);
  void take_recheck(const std::shared_ptr<RunningStage>& stage, const Worker& worker, std::string digest);
  void end_recheck(const std::shared_ptr<RunningStage>& stage);
  void disagree(Job& job, const Recheck& recheck);
  void drop_hopeless_rechecks();  // a worker is gone
  std::set<WorkerId> witnesses(const Recheck& recheck) const;
  void distrust(WorkerId liar, const std::string& why);
  void await_rechecks(Job& job);  // the job's thread
  void start_over(Job& job);      // the job's thread; the frame, with what honest workers made of it

  // Results (results.cpp).
  // Mutex held. The stage of the worker's lease, and the lease; null: there is none such.
  std::shared_ptr<RunningStage> stage_of(WorkerId id, LeaseId lease_id, Epoch epoch, Lease& lease) const;
  Verdict result(WorkerId id, LeaseId lease_id, Epoch epoch, BatchOutput output, const BatchCost& cost);
  // Why the output is not what the lease asks for; empty: it is. Without the mutex: it reads all of it.
  static std::string misfit(const RunningStage& stage, const Lease& lease, const BatchOutput& output);
  // What of a batch needs its digest: the journal, and what is computed again. The lock is held before and after.
  void put_on_record(const std::shared_ptr<RunningStage>& stage, WorkerId id, const Lease& lease, const Bytes& image,
                     bool rechecked, std::unique_lock<std::mutex>& lock);
  // Mutex held. Puts an accepted batch where its stage's records go.
  void collect(const std::shared_ptr<RunningStage>& stage, const Lease& lease, const Bytes& records,
               std::unique_lock<std::mutex>& lock);
  void collect_counted(const std::shared_ptr<RunningStage>& stage, const Lease& lease, Bytes image);
  void keep(const std::shared_ptr<RunningStage>& stage, Worker& worker, const Lease& lease,
            const BatchOutput::Retained& part);
  void stream_in(RunningStage& stage, const Lease& lease, Bytes records, std::unique_lock<std::mutex>& lock);
  void account(RunningStage& stage, const Worker& worker, const Lease& lease, const BatchCost& cost,
               std::size_t bytes);  // mutex held
  void failed(WorkerId id, LeaseId lease_id, Epoch epoch, const std::string& message, bool input_unavailable);

  FarmSettings settings;
  BlobStore& blobs;

  mutable std::mutex mutex;
  mutable std::condition_variable job_changed;
  std::condition_variable records_ready;  // a stage has its memory; the plan has taken records in
  std::condition_variable timer_wakes;
  bool stopping = false;
  bool timer_rearm = false;     // what is due next may have changed much
  bool offers_due = false;      // to `unserved`
  std::set<WorkerId> unserved;  // they have room, and the scheduler had nothing for them
  Scheduler scheduler;
  std::map<WorkerId, Worker> workers;
  WorkerId last_worker = 0;
  FarmTotals totals;
  std::map<Epoch, Lease> leases;  // handed out and not yet answered
  std::map<StageId, std::shared_ptr<RunningStage>> active_stages;
  ArtifactRegistry registry;
  std::map<ArtifactId, RetainedArtifact> retained;
  std::map<std::string, WorkerId> tokens;
  std::set<WorkerId> liars;
  std::mt19937_64 random{std::random_device{}()};
  std::map<WorkerId, std::string> names_of_gone;  // the last few: they may still be in dispute
  KeptRecords kept{settings.kept_bytes};
  std::map<std::string, std::shared_ptr<Job>> jobs;
  std::list<std::shared_ptr<Job>> order;        // of submission
  std::deque<std::shared_ptr<Job>> queue;       // those that wait
  std::deque<std::shared_ptr<Job>> ended_jobs;  // the oldest end first
  std::size_t running = 0;
  std::uint64_t memory_taken = 0;  // predicted, by plans that are there
  std::map<const Job*, std::thread> threads;
  std::vector<std::thread> ended_threads;  // to be joined
  std::condition_variable thread_ended;
  std::set<std::string> kinds;  // of stages that ran so far
  std::thread timer;
};

}  // namespace gleaner::coordinator

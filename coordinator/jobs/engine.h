#pragma once
// Inside the farm: its state and the steps that its files share. Everything is guarded by `mutex` unless it says
// otherwise; a frame's plan is guarded by the frame's `plan_mutex`, which is taken first where both are held.

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
#include "coordinator/jobs/overview.h"
#include "coordinator/jobs/running_job.h"
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
  std::optional<AcceptedBatch> last_batch;
  Seconds idle_since = -1;  // it could work, and has had no lease since then; negative: it has one
};

// An output that stays with the workers, for as long as somebody may read it.
struct RetainedArtifact {
  std::shared_ptr<const Recipe> recipe;
  std::set<Frame*> frames;      // that have it
  unsigned readers = 0;         // stages that compute something again and read it
  std::vector<ItemRange> lost;  // while a stage makes it: what that stage had made, and nobody holds any more
  Bytes facts;
  bool untrusted = false;  // a liar may have had a part in it: no other frame gets it
};

struct Cancelled {};   // thrown on a frame's thread
struct Distrusted {};  // likewise: the frame rests on what a liar made

// Devices of one kind make the same bytes of the same items.
std::string device_kind(const DeviceDescription& device);
std::string digest_of(const Bytes& bytes);

// Memory of a frame's or a job's that may be large: destroyed where the farm's mutex is not held.
struct JobRemains {
  std::vector<std::shared_ptr<RunningStage>> stages;
  std::vector<std::shared_ptr<const Bytes>> records;
  std::vector<ArrivedRecords> arrived;
  std::vector<std::map<std::uint64_t, CountedBatch>> counted;
  std::map<ArtifactId, std::shared_ptr<const ArtifactData>> data;
  std::deque<UndrawnItems> undrawn;
  std::vector<scene::Camera> cameras;
  std::vector<FrameScene> scenes;
  std::vector<JobRemains> frames;
};

// The job's settings, with the camera that sees the frame at this place; the way on which it lies was put there by
// submit().
FrameSettings settings_of(const JobRequest& request, std::uint64_t place);
// Of the frame among those of its job that run: 0 is the earliest one.
unsigned rank_of(const Frame& frame);
// What the scheduler is told: a job's priority goes before that of a stage within its plan.
int with_priority(int of_stage, const JobRequest& request);

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
  void note_idle(Worker& worker);  // after its leases may have become none, or some
  WorkerStatus worker_status(const Worker& worker, Seconds time) const;

  // What a page shows (overview.cpp; mutex held).
  void add_workers(const OverviewLimits& limits, Seconds time, FarmOverview& overview) const;
  void add_jobs(const OverviewLimits& limits, Seconds time, FarmOverview& overview) const;
  std::optional<GivenBatch> batch_of(const Worker& worker, Seconds time) const;

  // Jobs (job_queue.cpp).
  void changed(Job& job);  // mutex held
  // Mutex held. What happened, for Farm::events().
  void tell(FarmEvent event);
  void tell_job(const Job& job, const std::string& what, const std::string& message = {});
  void tell_worker(const Worker& worker, const std::string& what, const std::string& message = {});
  std::shared_ptr<Job> find(const std::string& id) const;  // mutex held
  std::shared_ptr<Job> accept(const JobRequest& request);  // checks it
  void start_queued();                                     // mutex held
  // Mutex held. Where its priority puts it, behind those of the same.
  void put_in_queue(const std::shared_ptr<Job>& job);
  std::shared_ptr<Job> next_queued() const;            // mutex held; the first that may begin; null: none
  std::size_t active() const;                          // mutex held; jobs that run and are not paused
  std::shared_ptr<Job> awaited(const Job& job) const;  // mutex held; one that must be done first; null: none
  bool is_awaited(const std::string& id) const;        // mutex held; by a job that waits
  // The job of that request, if it was submitted before. Throws Error::usage where the id was another request's.
  std::shared_ptr<Job> submitted_before(const JobRequest& request) const;  // mutex held
  void check_jobs_of(const std::string& owner) const;                      // mutex held; throws LimitReached
  std::uint64_t posing_memory(const JobRequest& request);
  bool has_memory_for(const Job& job) const;     // mutex held
  std::string why_queued(const Job& job) const;  // mutex held
  // Mutex held. The job has ended: it is shown so, its leases are revoked, the next one may start. What it held is
  // handed out, to be destroyed where the mutex is not held.
  JobRemains end_job(Job& job, JobState state, const std::string& message);
  bool stop_frames(Job& job);  // mutex held; true: a plan of one computes, and may do so for long
  void forget_ended();         // mutex held; those beyond the bounds

  // Frames side by side (frames.cpp; mutex held). Each frame that runs has a thread, which alone calls its plan.
  // Begins the first of the job's frames that wait; false: none waits, or no thread can be started for it.
  bool begin_frame(const std::shared_ptr<Job>& job);
  void wait_again(const std::shared_ptr<Job>& job);  // in the queue: it runs no frame, and has some to come
  bool may_begin_another(const Job& job) const;      // beside those that run
  std::shared_ptr<Job> job_for_another_frame() const;
  bool further_frame_comes() const;  // one that was begun has no stage yet, or one may be begun
  // When workers will have been idle for so long that a further frame is begun; none: no frame may be.
  std::optional<Seconds> next_frame_due() const;
  void begin_another_frame();  // where it is due
  void rank_frames(Job& job);  // the earliest comes first
  // The frame at its place is written, or failed. False: it was the last one that shows its picture.
  bool frame_over(Frame& frame, const std::string& failure);
  std::string failures_of(const Job& job) const;
  static void run(std::shared_ptr<Impl> self, std::shared_ptr<Frame> frame);  // the frame's thread
  // The frame has ended: the job's next one begins, or the job ends.
  JobRemains frame_ended(const std::shared_ptr<Frame>& frame, const std::string& failure);

  // Where what becomes of the job is written; null: nowhere, as of frames that are only shown.
  JournalWriter* journal_of(const Job& job) const { return job.showing ? nullptr : settings.journal.get(); }
  // The journal (journal_jobs.cpp); without one they do nothing. journal_added() waits for it, and throws.
  void journal_added(const Job& job);
  void journal_changed(const Job& job, JobState state);  // mutex held
  Bytes journal_frames(const Job& job) const;            // of its request; throws without a journal
  void journal_retry(const Job& job);                    // waits for the journal, and throws
  void restore();                                        // the journal's jobs, when the farm is made
  std::shared_ptr<Job> restored(const JournalJob& entry, std::string& failure);

  // Accepted records in files (remembered.cpp); without a journal they do nothing.
  std::filesystem::path records_of(const Frame& frame) const;
  void drop_left_records(const std::set<std::string>& waiting) const;  // of jobs that are over
  void recall(Frame& frame);                            // what of it was accepted, checked; on its thread
  void use_held(RunningStage& stage);                   // mutex held
  void feed_held(RunningStage& stage, Bytes* records);  // `records`: of a collected output of fixed stride
  // Appends the records to the stage's file; none: that failed.
  std::optional<JournalRange> store(RunningStage& stage, const Lease& lease, const Bytes& image, const Bytes& facts,
                                    const std::string& digest);
  void remember(RunningStage& stage, WorkerId maker, JournalRange range);  // mutex held
  void forget_records(const Frame& frame, const std::string& failure);     // the frame at its place is over
  void forget_records(const Job& job);
  void join_ended_threads();

  // A frame (frame_run.cpp, write_frame.cpp; on its thread).
  void render_and_write(const std::shared_ptr<Frame>& frame);
  // Runs `call`, which asks the plan or makes one, with the plan to itself; then a cancelled job ends here.
  template <typename Call>
  auto compute(Frame& frame, const Call& call);
  // Workers that take batches (none that drains), and those of them that have the denoiser's library. Mutex held.
  struct Denoisers {
    std::size_t working = 0, able = 0;
  };
  Denoisers denoisers() const;
  // Of Farm::show() and Farm::denoise().
  std::optional<Picture> show(Farm& farm, JobRequest request, Job::Showing showing, const std::stop_token& stop);
  std::unique_ptr<Plan> plan_for(const Frame& frame, const SceneSummary& summary) const;
  void aim(Frame& frame);  // makes its plan
  // Of the scene as the frame's state shows it. Throws Error::bad_input where the state does not fit its base.
  SceneSummary summary_of(const Frame& frame);
  FrameReport new_report(const Frame& frame) const;
  Film render(const std::shared_ptr<Frame>& frame);
  Film render_trusted(const std::shared_ptr<Frame>& frame);  // again where a liar had a part in it
  void warn(Frame& frame);                                   // mutex held; what the report's warnings say
  void reuse(Frame& frame, std::uint32_t rendered);          // what was made for the frame of that number
  // Plan::allow(); none: there is no time limit.
  std::optional<double> allowed_work(const Frame& frame);
  // Draws accepted batches until a stage is whole. None: the time limit has ended the frame.
  std::optional<FinishedStage> await_stage(Frame& frame);
  // Hand records to the plan: those of a streamed stage, those that the preview does not show. False: there are none.
  // The lock is held before and after.
  bool stream(Frame& frame, std::unique_lock<std::mutex>& lock);
  bool draw(Frame& frame, std::unique_lock<std::mutex>& lock);
  // Hands the plan the next batch of a streamed stage, which has arrived.
  void take_next(Frame& frame, std::shared_ptr<RunningStage> stage, std::unique_lock<std::mutex>& lock);
  // Hands the plan what of streamed stages has arrived by now, in item order.
  void take_what_arrived(Frame& frame, std::unique_lock<std::mutex>& lock);
  // Offers the plan what came in of the stages that run. The lock is held before and after.
  bool conclude(Frame& frame, std::unique_lock<std::mutex>& lock);
  // Whatever the frame still has with scheduler and workers is taken back; its figures move into the report.
  void end_frame(Frame& frame);
  JobRemains withdraw(Frame& frame);           // mutex held; as end_frame()
  void write(Frame& frame, const Film& film);  // waits for room where the disk is full
  void write_files(Frame& frame, const Film& film);
  void give_picture(Frame& frame, Film film);  // to Farm::show()

  // Stages (stages.cpp).
  // Hands a step's stages to the scheduler. The memory for their results is taken while the first batches run.
  // `work_to_come`: predicted, of stages after these.
  void post(const std::shared_ptr<Frame>& frame, const Step& step, double work_to_come);
  // Without the mutex: takes the memory of a stage that was started, and reads back what was accepted before.
  void prepare(RunningStage& stage);
  // What follows: mutex held. Null: the stage's records exist already and were handed to the frame, or another frame's
  // stage is about to make them.
  std::shared_ptr<RunningStage> schedule(const std::shared_ptr<Frame>& frame, const StageSpec& spec);
  void provide(Frame& frame, const ArtifactId& id, const std::string& blob, std::shared_ptr<const Bytes> bytes);
  void add_input(Frame& frame, RunningStage& stage, StageWork& work, const StageInput& input) const;
  bool find_kept(RunningStage& stage);
  void remember_output(const RunningStage& stage);
  void start(const std::shared_ptr<RunningStage>& stage);
  void hand_over(const std::shared_ptr<RunningStage>& stage, const std::string& why);  // what existed already
  // Stages of several frames that make the same (followers.cpp): the first one runs, the others get what it made.
  bool follow(const std::shared_ptr<RunningStage>& stage);  // false: nobody makes it
  void deliver_to_followers(RunningStage& stage);
  void release_followers(RunningStage& stage);  // it will not be made: the first of them runs in its place
  void start_in_place(const std::shared_ptr<RunningStage>& stage);
  // Those of the frame that have followed a stage which is gone. False: there are none. The lock is held before and
  // after.
  bool start_what_follows_no_more(Frame& frame, std::unique_lock<std::mutex>& lock);
  static void join_counted(RunningStage& stage);
  // The last of {all accepted, all copied in, memory there, retained parts whole} hands the stage to its frame; of a
  // streamed stage that of {all accepted, all given to the plan}.
  void deliver_if_complete(const std::shared_ptr<RunningStage>& shared);

  // Retained outputs (retained.cpp; mutex held).
  bool retain_output(RunningStage& stage);                    // true: it exists already
  void release_retained(Frame& frame, const ArtifactId& id);  // the frame reads it no more
  void release_all_retained(Frame& frame);
  void release_if_unused(const ArtifactId& id);
  void place_near_inputs(const RunningStage& stage, ScheduledStage& scheduled);
  bool inputs_exist(const RunningStage& stage) const;
  void pause_if_inputs_lack(RunningStage& stage);
  void settle_pause(const RunningStage& stage);  // with the scheduler: for its inputs, or for its job
  // Computes again what is missing and needed, and pauses who waits for it.
  void settle_retained();
  std::vector<Gap> missing(const ArtifactId& id, bool being_made);
  void compute_again(Frame& frame, const ArtifactId& id, const std::vector<Gap>& gaps);
  void start_again(Frame& frame, const ArtifactId& id, std::vector<ItemRange> items, const Gap* special);
  void require_inputs(const RunningStage& stage);
  // What a repetition reads exists for as long as it runs, though the plan may have released it.
  void hold_inputs(const RunningStage& stage);
  void release_inputs(const RunningStage& stage);
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

  // Batches that are computed again to find liars (recheck.cpp; mutex held but by the frame's thread).
  bool wants_recheck(const RunningStage& stage, Worker& worker);
  void recheck(const std::shared_ptr<RunningStage>& stage, WorkerId maker, const Lease& lease, std::string digest);
  // False: there is nobody to ask.
  bool ask_another(Frame& frame, const RunningStage& like, std::unique_ptr<Recheck> what);
  // `part`: of a retained output, what the worker keeps of its answer.
  void take_recheck(const std::shared_ptr<RunningStage>& stage, Worker& worker, const std::string& digest,
                    const std::optional<BatchOutput::Retained>& part);
  void compare_answers(const std::shared_ptr<RunningStage>& stage, const Worker& worker, std::string digest);
  void end_recheck(const std::shared_ptr<RunningStage>& stage);
  void disagree(Frame& frame, const Recheck& recheck);
  void drop_hopeless_rechecks();  // a worker is gone
  std::set<WorkerId> witnesses(const Recheck& recheck) const;
  // Whether one of these has answered something, and may get work.
  bool likely_answered(const Recheck& recheck) const;
  void distrust(WorkerId liar, const std::string& why);
  void await_rechecks(Frame& frame);    // the frame's thread
  void give_up_rechecks(Frame& frame);  // those that nobody answers in time, of a frame that waits for nothing else
  void start_over(Frame& frame);        // the frame's thread; with what honest workers made of it

  // Results (results.cpp).
  // Mutex held. The stage of the worker's lease, and the lease; null: there is none such.
  std::shared_ptr<RunningStage> stage_of(WorkerId id, LeaseId lease_id, Epoch epoch, Lease& lease) const;
  Verdict result(WorkerId id, LeaseId lease_id, Epoch epoch, BatchOutput output, const BatchCost& cost);
  // Why the output is not what the lease asks for; empty: it is. Without the mutex: it reads all of it.
  static std::string misfit(const RunningStage& stage, const Lease& lease, const BatchOutput& output);
  // What of a batch needs its digest: the journal, and what is computed again. The lock is held before and after.
  // Returns where the batch lies in the stage's file, if it does.
  std::optional<std::uint64_t> put_on_record(const std::shared_ptr<RunningStage>& stage, WorkerId id,
                                             const Lease& lease, const BatchOutput& output, bool rechecked,
                                             std::unique_lock<std::mutex>& lock);
  // Mutex held. Puts an accepted batch where its stage's records go.
  void collect(const std::shared_ptr<RunningStage>& stage, const Lease& lease, const Bytes& records,
               std::unique_lock<std::mutex>& lock);
  void collect_counted(const std::shared_ptr<RunningStage>& stage, const Lease& lease, Bytes image);
  void keep(const std::shared_ptr<RunningStage>& stage, Worker& worker, const Lease& lease,
            const BatchOutput::Retained& part);
  void stream_in(RunningStage& stage, const Lease& lease, Bytes records, std::optional<std::uint64_t> on_file,
                 std::unique_lock<std::mutex>& lock);
  void account(RunningStage& stage, Worker& worker, const Lease& lease, const BatchCost& cost,
               std::size_t bytes);  // mutex held
  void failed(WorkerId id, LeaseId lease_id, Epoch epoch, const std::string& message, bool input_unavailable);

  FarmSettings settings;
  BlobStore& blobs;

  mutable std::mutex mutex;
  mutable std::condition_variable job_changed;
  mutable std::condition_variable event_told;
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
  std::deque<GoneWorker> gone_workers;            // the last few, the latest first
  EventLog event_log{settings.scheduler.incarnation};
  KeptRecords kept{settings.kept_bytes};
  std::map<std::string, std::shared_ptr<Job>> jobs;
  std::map<std::string, std::string> request_ids;  // to jobs
  std::mutex request_ids_mutex;                    // taken first: one request with an id is submitted at a time
  std::list<std::shared_ptr<Job>> order;           // of submission
  std::deque<std::shared_ptr<Job>> queue;          // those that wait
  std::deque<std::shared_ptr<Job>> ended_jobs;     // the oldest end first
  std::vector<std::shared_ptr<Job>> running;       // in the order of their start
  Seconds last_frame_begun = 0;
  Seconds costs_written = 0;  // when the journal was last told what running jobs have cost
  bool said_no_thread = false;
  std::uint64_t memory_taken = 0;  // predicted, by plans that are there
  std::map<const Frame*, std::thread> threads;
  std::vector<std::thread> ended_threads;  // to be joined
  std::condition_variable thread_ended;
  std::set<std::string> kinds;  // of stages that ran so far
  std::thread timer;
};

}  // namespace gleaner::coordinator

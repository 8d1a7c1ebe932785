#pragma once
// Inside the farm: its state and the steps that its files share. Everything is guarded by `mutex` unless it says
// otherwise; a job's plan is guarded by the job's `plan_mutex`, which is taken first where both are held.

#include <condition_variable>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <set>
#include <string>
#include <thread>
#include <vector>

#include "coordinator/jobs/farm.h"
#include "coordinator/jobs/frame.h"
#include "coordinator/jobs/kept_records.h"

namespace gleaner::coordinator {

struct Worker {
  WorkerId id = 0;
  WorkerHello hello;
  std::string name;
  std::shared_ptr<WorkerSession> session;
  Seconds joined = 0, heard = 0;
  bool draining = false;
  std::set<Epoch> leases;
};

struct Cancelled {};  // thrown on a job's thread

// The job's settings, with the camera that sees this frame; the way on which it lies was put there by submit().
FrameSettings settings_of(const JobRequest& request, std::uint32_t frame);

struct Farm::Impl {
  Impl(FarmSettings farm_settings, BlobStore& store);

  Seconds now() const { return settings.clock(); }

  // Workers (workers.cpp; mutex held but by the clock's thread).
  void pump();                // offers work to every worker that could hold more
  void pump(Worker& worker);  // to this one
  void forget_lease(Epoch epoch);
  void revoke(const std::vector<Lease>& revoked);
  void lose(WorkerId id, const std::string& why);
  void watch_clock();
  void tick();

  // Jobs (job_queue.cpp).
  void changed(Job& job);                                  // mutex held
  std::shared_ptr<Job> find(const std::string& id) const;  // mutex held
  void start_queued();                                     // mutex held
  void join_ended_threads();
  void run(const std::shared_ptr<Job>& job);

  // Frames (frame_run.cpp, write_frame.cpp; on the job's thread).
  void run_frames(const std::shared_ptr<Job>& job);
  static bool same_camera(const Job& job, std::uint32_t a, std::uint32_t b);
  void aim(Job& job, std::uint32_t frame);  // a plan for another frame of the job
  FrameReport new_report(const Job& job, std::uint32_t frame) const;
  Film render(const std::shared_ptr<Job>& job, std::uint32_t frame);
  void reuse(Job& job, std::uint32_t frame, std::uint32_t rendered);
  // Draws accepted batches until a stage is whole. None: the time limit has ended the frame.
  std::optional<FinishedStage> await_stage(Job& job);
  // Offers the plan what came in of the stages that run. The lock is held before and after.
  bool conclude(Job& job, std::unique_lock<std::mutex>& lock);
  // Whatever the frame still has with scheduler and workers is taken back; its figures move into the report.
  void end_frame(Job& job);
  void write(Job& job, std::uint32_t frame, const Film& film, Seconds begun);

  // Stages (stages.cpp).
  // Hands a step's stages to the scheduler. The memory for their results is taken while the first batches run.
  void post(const std::shared_ptr<Job>& job, const Step& step);
  // Names what a stage makes by what it makes it of: the same address, the same records.
  static std::string address_of(const StageWork& work, const StageSpec& spec);
  // Mutex held. Null: the stage's records are there already, and were handed to the job.
  std::shared_ptr<RunningStage> schedule(const std::shared_ptr<Job>& job, const StageSpec& spec);
  // Mutex held. The last of {all accepted, all copied in, memory there} hands the stage to its job.
  void deliver_if_complete(const std::shared_ptr<RunningStage>& shared);

  // Results (results.cpp).
  Verdict result(WorkerId id, LeaseId lease_id, Epoch epoch, Bytes records, const BatchCost& cost);
  void account(RunningStage& stage, const Worker& worker, const Lease& lease, const BatchCost& cost,
               std::size_t bytes);  // mutex held
  void failed(WorkerId id, LeaseId lease_id, Epoch epoch, const std::string& message);

  FarmSettings settings;
  BlobStore& blobs;

  mutable std::mutex mutex;
  mutable std::condition_variable job_changed;
  std::condition_variable records_ready;
  std::condition_variable timer_wakes, timer_stops;
  bool stopping = false;
  Scheduler scheduler;
  std::map<WorkerId, Worker> workers;
  WorkerId last_worker = 0;
  FarmTotals totals;
  std::map<Epoch, Lease> leases;  // handed out and not yet answered
  std::map<StageId, std::shared_ptr<RunningStage>> active_stages;
  KeptRecords kept{settings.kept_bytes};
  std::map<std::string, std::shared_ptr<Job>> jobs;
  std::vector<std::string> order;  // of submission
  std::thread timer;
};

}  // namespace gleaner::coordinator

#pragma once
// The farm's engine: jobs, their frames' plans and stages, the scheduler, the workers. It knows neither sockets nor
// gRPC: a gateway (or a test) brings workers as sessions and time as a clock. All calls may come from any thread.

#include <filesystem>
#include <functional>
#include <limits>
#include <memory>
#include <optional>
#include <stop_token>
#include <string>
#include <thread>
#include <vector>

#include "coordinator/artifacts/registry.h"
#include "coordinator/artifacts/relay.h"
#include "coordinator/blobs/store.h"
#include "coordinator/film/film.h"
#include "coordinator/jobs/event_log.h"
#include "coordinator/jobs/job.h"
#include "coordinator/jobs/overview.h"
#include "coordinator/jobs/report.h"
#include "coordinator/jobs/session.h"
#include "coordinator/plan/plan.h"
#include "coordinator/schedule/scheduler.h"
#include "scene/model/error.h"

namespace gleaner::coordinator {

class JournalWriter;

// Where a frame's files go; an empty path: that file is not wanted.
struct FramePaths {
  std::filesystem::path exr, png, report;
};

// Somebody asks for more than one may have.
struct LimitReached : Error {
  explicit LimitReached(std::string message) : Error(ErrorKind::failed, std::move(message)) {}
};

struct FarmSettings {
  SchedulerSettings scheduler;
  std::function<Seconds()> clock;  // never decreasing; empty: the steady clock
  std::function<std::unique_ptr<Plan>(const FrameSettings&, const SceneSummary&)> plan;  // empty: make_plan
  // Asked at submission in place of making a plan: throws Error::usage for what no plan takes, else returns the bytes
  // that the frame's plan is predicted to take. Empty: check_settings() and predicted_memory(), or nothing where `plan`
  // is given.
  std::function<std::uint64_t(const FrameSettings&, const SceneSummary&)> check;
  std::function<FramePaths(const std::string& job, std::uint32_t frame)> paths;  // folders are made
  std::function<std::thread(std::function<void()>)> start_thread;                // of a frame; empty: std::thread
  std::function<void(const std::string&)> log;                                   // one line each; empty: silence
  unsigned active_jobs = 2;  // jobs that run at the same time: the second fills the first one's tail
  // Frames of a job that run side by side, where workers idle that fewer cannot feed: at most, and never more than
  // there are workers.
  unsigned frames_at_once = 8;
  bool preview = true;                                     // accepted batches are drawn as they come
  std::uint64_t artifact_bytes = std::uint64_t{32} << 30;  // largest result of a stage
  std::uint64_t arrived_bytes = std::uint64_t{32} << 20;   // of a stage's records that wait for its plan
  std::uint64_t kept_bytes = std::uint64_t{512} << 20;     // of stages' records that later frames may use again
  std::uint64_t retained_bytes = std::uint64_t{8} << 30;  // the same of those that workers retain, all workers together
  // Predicted bytes of the plans that run at the same time: a job that needs more than all of it is refused, one that
  // needs more than what is free waits.
  std::uint64_t memory_bytes = std::numeric_limits<std::uint64_t>::max();
  Seconds silence = 30;  // a worker not heard of for so long is lost
  // Of accepted batches, the share that another worker of the same kind computes again, beside each worker's first
  // batch of each kind of stage (jobs/recheck.cpp).
  double recheck_share = 0;
  Seconds disk_patience = 0;      // for which a frame that is whole waits for room on a full disk, before it fails
  std::size_t jobs_an_owner = 0;  // that run or wait; 0: any number
  // Jobs that ended are listed, and their files are fetched, until there are more of them or they are older. Files
  // stay.
  std::size_t ended_jobs = 1000;
  Seconds ended_seconds = 30.0 * 24 * 3600;
  // Jobs are written to it, and those that it knows are there when the farm is made: what had ended is listed, what
  // had not goes on. Null: jobs end with the farm.
  std::shared_ptr<JournalWriter> journal{};
  std::filesystem::path records{};  // folder of accepted records, with a journal; empty: frames begin again
};

class Farm {
 public:
  // Throws Error::failed where the journal cannot be read.
  Farm(FarmSettings settings, BlobStore& blobs);
  ~Farm();  // end() with the grace of a plan's usual call
  Farm(const Farm&) = delete;
  Farm& operator=(const Farm&) = delete;

  // Stops all jobs and waits for their threads. False: a plan's call has not returned within `grace` seconds. Its
  // thread goes on without touching anything of the farm's owner, but the process should be ended by std::_Exit().
  bool end(Seconds grace);

  // Returns the job's id: of a request with an id that was submitted before, that job's. Throws Error::usage for
  // settings that no plan takes or that need more memory than there may be, Error::bad_input for a blob that is not
  // there, Error::failed where the journal cannot be written.
  std::string submit(const JobRequest& request);
  struct Picture {
    Film film;
    FrameReport report;
  };
  // Renders one frame for someone who waits for it. It goes before all jobs, is in no list, and leaves neither files
  // nor a word in the journal. `shown`: of the scene as the request's state shows it, with its lineage. None: `stop`
  // was requested. `behind`: after all other frames that are shown. Throws as submit(), and Error::failed where the
  // frame failed.
  std::optional<Picture> show(const JobRequest& request, const SceneSummary& shown, const std::stop_token& stop,
                              bool behind = false);
  // Whether a worker that takes batches has the denoiser's library.
  bool can_denoise() const;
  // A picture of a job that runs (R G B, and guides where it has them), denoised as show() renders: for someone who
  // waits for it. None: `stop` was requested, or the job does not run any more. Throws as show().
  std::optional<Picture> denoise(const std::string& job, Film film, const std::stop_token& stop);
  // The status after it; none: no such job. What has ended stays as it ended. A job whose plan computes has ended when
  // this returns: nobody waits for the plan.
  std::optional<JobStatus> cancel(const std::string& job);
  // Nothing more of a paused job is handed out, and it keeps no other from running; what its workers compute they
  // finish. The status after it; none: no such job. What has ended stays as it is.
  std::optional<JobStatus> pause(const std::string& job, bool paused);
  // A job that failed or was cancelled is queued again, for the frames that are not written. Throws Error::usage for
  // one that did not, Error::failed without a journal, Error::bad_input where its scene is gone.
  std::optional<JobStatus> retry(const std::string& job);
  std::optional<JobStatus> status(const std::string& job) const;
  std::vector<JobStatus> list() const;  // oldest first
  // Waits until the job's version is over `seen`, it ended, or `timeout` seconds went by.
  std::optional<JobStatus> wait(const std::string& job, std::uint64_t seen, Seconds timeout) const;
  // What happened after the event of that number, of the job where it is not empty. Waits up to `timeout` seconds for
  // something to happen; a farm that goes away ends the wait.
  std::vector<FarmEvent> events(std::uint64_t after, const std::string& job, Seconds timeout) const;
  std::uint64_t last_event() const;
  // The first of the frames that run, as far as its batches came in. None: no such job, nothing to show, or a plan that
  // computes at this moment (it is not waited for).
  std::optional<Film> preview(const std::string& job, bool guides = false);
  // One line for every stage that has items which nobody runs. None: no such job.
  std::optional<std::vector<std::string>> why(const std::string& job) const;
  // Files that the job's finished frames left.
  std::vector<std::filesystem::path> files(const std::string& job) const;

  struct Joined {
    WorkerId id = 0;
    std::string name;  // what the worker goes by
  };
  Joined join(const WorkerHello& hello, std::shared_ptr<WorkerSession> session);
  // The worker is gone; its leases go to others at once. Unknown workers are ignored, here and below.
  void leave(WorkerId worker);
  void drain(WorkerId worker);
  bool drain(const std::string& worker);  // by what it goes by; false: there is none such
  void heard(WorkerId worker);            // it lives
  std::vector<WorkerStatus> workers() const;
  FarmTotals totals() const;
  FarmOverview overview(const OverviewLimits& limits = {}) const;

  // How many bytes the result of this lease has (of a counted output: at most); none where the lease is not (or no
  // longer) this worker's.
  std::optional<std::uint64_t> expected_bytes(WorkerId worker, LeaseId lease, Epoch epoch) const;
  Verdict result(WorkerId worker, LeaseId lease, Epoch epoch, BatchOutput output, const BatchCost& cost);
  Verdict result(WorkerId worker, LeaseId lease, Epoch epoch, Bytes records, const BatchCost& cost) {
    return result(worker, lease, epoch, BatchOutput{std::move(records)}, cost);
  }
  // `input_unavailable`: what the batch reads could not be fetched; nobody's fault, and it is tried again.
  void failed(WorkerId worker, LeaseId lease, Epoch epoch, const std::string& message, bool input_unavailable = false);

  // Parts of retained outputs, as workers ask for them. A token names a worker's connection (WorkerHello).
  struct Located {
    enum Answer { here, unavailable, refused } answer = refused;
    struct Holder {
      std::string worker, address, ticket;
    };
    struct At {
      HeldPart part;
      std::vector<Holder> holders;  // others than the one who asks
      bool own = false;             // who asks holds it too
    };
    std::vector<At> parts;
  };
  // The parts that the lease reads of the artifact: refused where it is not the caller's, or does not read it.
  Located locate(const std::string& token, Epoch epoch, const ArtifactId& artifact);
  struct RelaySource {
    Located::Answer answer = Located::refused;
    WorkerId holder = 0;
    std::uint64_t part_bytes = 0;  // of the part's image
  };
  // Whom the coordinator asks for bytes of a part that the caller cannot fetch from `holder` itself.
  RelaySource relay_source(const std::string& token, Epoch epoch, const std::string& holder, const PartRange& range);
  bool ask_for_part(WorkerId holder, std::uint64_t request, const PartRange& range);  // false: the holder is gone
  void relayed(Epoch epoch, std::uint64_t bytes);  // so many have gone through the coordinator for this lease
  std::optional<WorkerId> worker_of(const std::string& token) const;
  // The holder says that it has no such part.
  void not_held(WorkerId holder, const ArtifactId& artifact, std::uint64_t first, const std::string& digest);
  // `reader` got bytes from `holder` that are not those of the digest, or none.
  void wrong_part(WorkerId reader, const ArtifactId& artifact, std::uint64_t first, const std::string& digest,
                  const std::string& holder);

 private:
  struct Impl;
  std::shared_ptr<Impl> impl_;  // shared with the jobs' threads
};

}  // namespace gleaner::coordinator

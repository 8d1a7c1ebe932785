#pragma once
// The scheduler: a pure state machine fed with events and a clock value. No threads, no sockets, no clock of its own.
// The same code runs in production and in the simulated farm.

#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

namespace gleaner::coordinator {

using Seconds = double;  // since any fixed origin, never decreasing
using WorkerId = std::uint64_t;
using StageId = std::uint64_t;
using LeaseId = std::uint64_t;
using Epoch = std::uint64_t;

struct ItemSpan {
  std::uint64_t first = 0, count = 0;
};

struct ScheduledStage {
  std::string kind;  // throughput is remembered per (worker, kind)
  std::uint64_t items = 0;
  std::uint32_t tile = 1;  // batches begin and end at multiples of it
  bool solo = false;
  bool at_once = false;             // the next worker that has room takes it, also beyond its share
  std::uint64_t most_items = 0;     // of a batch; 0: as many as its worker can do in time
  unsigned rank = 0;                // lower first, whatever the priority: what a higher one gets, lower ones left
  int priority = 0;                 // of one rank: higher first; equal: older first
  std::vector<WorkerId> preferred;  // solo: who holds most of its inputs
  // Where not all of [0, items) are to run: these, in order and apart from each other; each begins at a multiple of
  // `tile`.
  std::vector<ItemSpan> only{};
  std::vector<WorkerId> avoid{};  // these get none of it while others can
  // Split: what of its own items' inputs a worker holds. It gets items of its spans before others, as long as any wait
  // there.
  std::map<WorkerId, std::vector<ItemSpan>> near{};  // spans in order
  double near_bytes = 0;  // of an item's inputs, which a worker fetches that does not hold them
  bool adjoining =
      false;  // split: a worker's batches follow each other where they can; else the first items come first
};

// Items [first, first + count) of a stage, handed to a worker. `epoch` is unique for every handing out.
struct Lease {
  LeaseId id = 0;
  Epoch epoch = 0;
  StageId stage = 0;
  WorkerId worker = 0;
  std::uint64_t first = 0, count = 0;
  Seconds issued = 0, expires = 0;
  bool duplicate = false;  // a second copy of a slow lease
};

struct SchedulerSettings {
  Seconds target_batch = 0.5;              // how long a batch should take
  Seconds smallest_batch = 0.05;           // below it, overhead rules
  double good_news = 0.2, bad_news = 0.5;  // weights of a new throughput above or below the remembered one
  // What it takes to fetch the inputs of items that another worker holds: gigabit Ethernet. Such items are left to
  // their holder where it will be done with all of them sooner.
  Seconds fetch_latency = 0.1;
  double fetch_bytes_per_second = 1e8;
  double growth = 2.0;                     // a batch is at most so many times the worker's last one of the kind
  Seconds shortest_sample = 0.005;         // shorter measurements say nothing
  Seconds lease_floor = 10;                // a lease lasts at least so long
  double lease_factor = 8;                 // ... and so many times its expected duration
  unsigned in_flight = 2;                  // leases a worker may hold: one runs, one waits
  std::uint64_t first_batch_items = 4096;  // for a worker whose throughput is not known
  std::uint64_t fixed_batch_items = 0;     // tests: every batch of this size (rounded to tiles); 0 = adaptive
  unsigned strikes = 3;            // failures of one range on different workers before the stage fails; failures of
                                   // one worker in a row before it is quarantined
  Seconds solo_lease_floor = 300;  // as lease_floor, for solo stages: nobody can tell how long the first one takes
  // An idle worker begins a solo stage too once that has run so long, and far longer than expected: its worker may
  // never answer. The second one counts where that worker has answered nothing yet.
  Seconds solo_copy_after = 5, solo_copy_after_unproven = 1;
  // Another number at every start of the coordinator (below 2^32, e.g. the journal's count of starts): it leads all
  // lease ids and epochs, so that what was handed out before a restart is told from what is handed out now.
  std::uint64_t incarnation = 0;
};

enum class Verdict {
  accepted,       // write the records: this lease's items count now
  duplicate,      // the items were accepted before: drop
  stale,          // the epoch is not the lease's: drop
  unknown_lease,  // never handed out, or before a restart: drop
  wrong_worker,   // the lease is another worker's: drop
  stage_gone,     // the stage was cancelled or is complete: drop
};
const char* verdict_name(Verdict verdict);

struct ResultOutcome {
  Verdict verdict = Verdict::unknown_lease;
  bool stage_complete = false;
  std::vector<Lease> revoke;  // other leases on the same items: their work is no longer wanted
};

struct FailureOutcome {
  bool known = false;         // the lease was live
  bool stage_failed = false;  // the strikes are used up
};

struct WorkerProgress {
  std::uint64_t items = 0;
  Seconds seconds = 0;  // as the worker measured
  std::uint64_t batches = 0;
};

class Scheduler {
 public:
  explicit Scheduler(const SchedulerSettings& settings = {});
  ~Scheduler();

  // A stage of no items is complete at once. Throws Error for a tile of 0.
  StageId add_stage(const ScheduledStage& stage, Seconds now);
  // Forgets the stage: called for every stage, also for one that is complete or failed. Outstanding leases are returned
  // so that their workers can be told.
  std::vector<Lease> remove_stage(StageId stage);

  void set_rank(StageId stage, unsigned rank);
  // A paused stage hands out nothing; leases that are out may still finish.
  void pause(StageId stage);
  void resume(StageId stage);

  // One that is there already starts afresh: as if it had been lost before.
  void worker_joined(WorkerId worker, Seconds now);
  // The worker's leases go back to the pool at once, and what it was known to do is forgotten.
  void worker_lost(WorkerId worker, Seconds now);
  // Gets no new leases; those it holds may still finish.
  void worker_draining(WorkerId worker);

  // The next lease for the worker, or none: it holds enough, drains, is unknown, or nothing waits. Ask for the
  // worker of an event until none is given, and again for those that got none while they had room: soon after each
  // event (result, failure, loss, new stage, expire()), on large farms gathered, e.g. every 2 ms.
  // `duplicates`: where no items wait, a copy of a slow lease.
  std::optional<Lease> next_lease(WorkerId worker, Seconds now, bool duplicates = true);
  // A batch's result. `seconds` is the worker's own measure of the batch.
  ResultOutcome result(WorkerId worker, LeaseId lease, Epoch epoch, Seconds seconds, Seconds now);
  // The worker could not do it: the items go back, preferably to another worker. `blameless`: for no fault of the items
  // or of the worker, so that it is no strike against either.
  FailureOutcome failed(WorkerId worker, LeaseId lease, Epoch epoch, Seconds now, bool blameless = false);
  // Leases that ran out by `now`, and those that waited behind a batch that takes far longer than it should: their
  // items are in the pool again, their epochs are stale, their workers can be told.
  std::vector<Lease> expire(Seconds now);
  // When expire() has something to do next: a lease runs out, a worker that was quarantined may work again, a solo
  // stage gives up on its preferred workers. None = never. Call expire() then, though it may return no lease.
  std::optional<Seconds> next_expiry() const;

  bool complete(StageId stage) const;  // every item accepted
  std::uint64_t items_done(StageId stage) const;
  // Until when the worker gets nothing, after failures or leases that ran out; none: it is not quarantined.
  std::optional<Seconds> quarantined_until(WorkerId worker) const;
  double items_per_second(WorkerId worker, const std::string& kind) const;  // 0 = unknown
  bool proven(WorkerId worker) const;                                       // it has answered something since it joined
  std::map<WorkerId, WorkerProgress> progress(StageId stage) const;
  // One line for a person: why this stage has items that nobody runs, or whose batch is late; empty where all runs in
  // time.
  struct Names {
    std::function<std::string(WorkerId)> worker;
    std::function<std::string(StageId)> stage;
  };
  std::string why_waiting(StageId stage, Seconds now, const Names& names) const;
  std::string why_waiting(StageId stage, Seconds now) const;  // with numbers for names
  // Elements looked at or moved so far, each a step of O(log n) at most: what an event costs, counted instead of timed.
  std::uint64_t steps() const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace gleaner::coordinator
